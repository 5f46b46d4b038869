"""The text files of a map directory: JSON, labels.csv and trajectory.tum, within bounds.

What is wrong with one is a MapError of one line. A trajectory is in TUM format: `t x y z qx qy qz
qw` a line, seconds and metres. Trajectories that other programs wrote are read by `read_tum`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from specmap_cli.core.arrays import runs
from specmap_cli.core.errors import InputError, MapError
from specmap_cli.core.files import read_bytes
from specmap_cli.core.geometry import (
    quaternions_from_rpy,
    rotation_from_quaternion,
    rpy_from_quaternions,
    yaw_of,
)
from specmap_cli.core.records import NO_SUBMAP, Labels, Trajectory
from specmap_cli.core.settings import LimitsConfig
from specmap_cli.core.text import counted, csv_text, decimal, stamp_ns, stamp_text

LABELS_HEADER = "stamp,x,y,theta,submap"
_LOST, _FOUND = "# lost", "# found"
_LATEST_S = 9.2e9  # the year 2261: later stamps in nanoseconds overflow 64 bits
_DECIMAL = re.compile(r"[0-9]+(\.[0-9]*)?")  # seconds without a sign or an exponent
_FARTHEST = 1e8  # metres: twice around the earth, farther than any place in a map


def map_text(path: Path, limits: LimitsConfig | None = None) -> str:
    """The text of a file of a map."""
    most_mb = (LimitsConfig() if limits is None else limits).text_max_mb
    try:
        return read_bytes(path, most_mb, "limits.text_max_mb").decode("utf-8")
    except OSError as error:
        advice = "build the map again"
        raise MapError.of_system(error, "cannot be read", advice, where=path) from None
    except UnicodeDecodeError:
        raise MapError.damaged("not UTF-8 text", path) from None


def _numbers(words: Sequence[str], count: int) -> list[float]:
    """So many numbers that a place on earth, an angle or a quaternion has; ValueError otherwise."""
    numbers = [float(word) for word in words]
    # false for NaN as well
    if len(numbers) != count or not all(abs(number) <= _FARTHEST for number in numbers):
        raise ValueError(words)
    return numbers


def map_json(path: Path, limits: LimitsConfig) -> Any:
    """The contents of a JSON file."""
    try:
        return json.loads(map_text(path, limits))
    except json.JSONDecodeError as error:
        raise MapError.damaged(f"damaged JSON at line {error.lineno}: {error.msg}", path) from None
    except RecursionError:
        raise MapError.damaged("JSON nested too deeply", path) from None
    except ValueError:  # Python reads no integer of thousands of digits
        raise MapError.damaged("a number of too many digits", path) from None


def labels_text(labels: Labels) -> str:
    """CSV with a header; the last column is empty for a keyframe in no submap."""
    rows = ([stamp_text(stamp), *map(decimal, pose), submap] for stamp, pose, submap in labels)
    return csv_text(LABELS_HEADER.split(","), rows)


def read_labels(path: str | Path, limits: LimitsConfig | None = None) -> Labels:
    """labels.csv back. Raises MapError naming the line at fault."""
    path = Path(path)
    lines = map_text(path, limits).splitlines()
    if not lines or lines[0] != LABELS_HEADER:
        raise MapError.damaged(f"line 1 is not {LABELS_HEADER!r}", path)
    stamps, poses, submaps = [], [], []
    for number, line in enumerate(lines[1:], start=2):
        try:
            stamp, *pose, submap = line.split(",")
            stamps.append(np.int64(stamp_ns(stamp)))
            poses.append(_numbers(pose, 3))
            if submap and not submap.isdecimal():
                raise ValueError(submap)
            submaps.append(np.int64(int(submap) if submap else NO_SUBMAP))
        except (ValueError, OverflowError):
            raise MapError(
                f"line {number} is {line!r}", f"expected {LABELS_HEADER}", where=path
            ) from None
    return Labels(
        stamps_ns=np.array(stamps, dtype=np.int64),
        poses=np.array(poses, dtype=np.float64).reshape(-1, 3),
        submaps=np.array(submaps, dtype=np.int64),
    )


def trajectory_text(trajectory: Trajectory) -> str:
    """TUM lines in space; nine decimals of seconds and quaternions, six of metres.

    A line `# lost: ...` stands before scans whose poses are guesses, `# found` before those after
    them: readers of the format pass over lines that begin with #.
    """
    poses = trajectory.poses
    tilt = np.zeros_like(poses) if trajectory.tilt is None else trajectory.tilt
    places = np.column_stack([poses[:, :2], tilt[:, 0]])
    quaternions = quaternions_from_rpy(tilt[:, 1], tilt[:, 2], poses[:, 2])
    lost = np.zeros(0, dtype=np.bool_) if trajectory.lost is None else trajectory.lost
    remarks: dict[int, str] = {}
    for start, end in runs(lost) if lost.any() else ():
        if lost[start]:
            guesses = counted(end - start, "scan")
            remarks[start] = f"{_LOST}: the poses of the next {guesses} are guesses\n"
        elif start:
            remarks[start] = f"{_FOUND}\n"
    lines = []
    for row, (stamp, place, quaternion) in enumerate(
        zip(trajectory.stamps_ns.tolist(), places, quaternions, strict=True)
    ):
        lines.append(remarks.get(row, ""))
        position = " ".join(decimal(value) for value in place.tolist())
        rotation = " ".join(decimal(value, 9) for value in quaternion.tolist())
        lines.append(f"{stamp_text(stamp)} {position} {rotation}\n")
    return "".join(lines)


def read_trajectory(path: str | Path, limits: LimitsConfig | None = None) -> Trajectory:
    """The trajectory of a map back: its poses in space, and which of its scans were lost.

    Raises MapError naming the line at fault.
    """
    path = Path(path)
    lines = map_text(path, limits).splitlines()
    stamps: list[int] = []
    found: list[list[float]] = []
    lost: list[bool] = []
    is_lost = False
    for number, line in enumerate(lines, start=1):
        if line.startswith("#"):
            is_lost = line.startswith(_LOST) or (is_lost and not line.startswith(_FOUND))
            continue
        try:
            stamp, *words = line.split()
            stamps.append(int(np.int64(stamp_ns(stamp))))
            found.append(_numbers(words, 7))
            lost.append(is_lost)
        except (ValueError, OverflowError):
            raise MapError(
                f"line {number} is {line!r}",
                "expected t x y z qx qy qz qw: build the map again",
                where=path,
            ) from None
    rows = np.array(found, dtype=np.float64).reshape(-1, 7)
    roll, pitch, yaw = rpy_from_quaternions(rows[:, 3:]).T
    tilt = np.column_stack([rows[:, 2], roll, pitch])
    marks = np.array(lost, dtype=np.bool_)
    return Trajectory(
        stamps_ns=np.array(stamps, dtype=np.int64),
        poses=np.column_stack([rows[:, :2], yaw]),
        tilt=tilt if tilt.any() else None,
        lost=marks if marks.any() else None,
    )


def read_tum(path: str | Path) -> Trajectory:
    """A trajectory of any program, in the plane; comments and commas may stand anywhere.

    Raises InputError naming the line that is not `t x y z qx qy qz qw`.
    """
    rows = stamped_rows(path, 1, "TUM format has 8", "pose", "`t x y z qx qy qz qw`")
    stamps = [stamp for (stamp,), _ in rows]
    poses = [(x, y, yaw_of(rotation_from_quaternion(*q))) for _, (x, y, _, *q) in rows]
    return Trajectory(np.array(stamps, dtype=np.int64), np.array(poses, dtype=np.float64))


def stamped_rows(
    path: str | Path, stamps: int, columns: str, what: str, expected: str
) -> list[tuple[list[int], list[float]]]:
    """The stamps at the beginning of each line of eight words, and the numbers that follow them.

    Stamps are nanoseconds, of seconds in the file. Raises InputError naming the line at fault, or
    `what` a file without any should hold.
    """
    path, rows = Path(path), []
    try:
        with path.open(encoding="utf-8") as file:
            for number, line in enumerate(file, start=1):
                words = line.split("#", 1)[0].replace(",", " ").split()
                where = f"{path}:{number}"
                if words and len(words) != 8:
                    raise _malformed(where, f"{len(words)} columns, {columns}")
                if words:
                    times = [_stamp(where, word) for word in words[:stamps]]
                    rows.append((times, _finite(where, words[stamps:])))
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not UTF-8 text"
        raise InputError(f"cannot be read: {reason}", where=path) from None
    if not rows:
        raise InputError(f"holds no {what}", f"expected lines {expected}", mark=";", where=path)
    return rows


def _stamp(where: str, word: str) -> int:
    """Seconds in decimal to nanoseconds, without the rounding of floats."""
    (value,) = _finite(where, [word])
    if not abs(value) < _LATEST_S:
        raise _malformed(where, f"{word!r} is no time in seconds")
    return stamp_ns(word) if _DECIMAL.fullmatch(word) else round(value * 1e9)


def _finite(where: str, words: list[str]) -> list[float]:
    try:
        values = [float(word) for word in words]
    except ValueError:
        raise _malformed(where, f"{' '.join(words)!r} are not all numbers") from None
    if not np.isfinite(values).all():
        raise _malformed(where, f"{' '.join(words)!r} are not all finite")
    return values


def _malformed(where: str, found: str) -> InputError:
    return InputError(found, "mend or remove the line", mark=";", where=where)
