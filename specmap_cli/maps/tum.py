"""Trajectories in TUM format as text and back: `t x y z qx qy qz qw` a line, seconds and metres."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from specmap_cli.core.arrays import runs
from specmap_cli.core.errors import MapError
from specmap_cli.core.geometry import quaternions_from_rpy, rpy_from_quaternions
from specmap_cli.core.records import Trajectory
from specmap_cli.core.settings import LimitsConfig
from specmap_cli.core.text import counted, decimal, stamp_ns, stamp_text
from specmap_cli.maps.tables import read_text

_LOST, _FOUND = "# lost", "# found"
_COLUMNS = 8
_FARTHEST = 1e8  # metres, and more than any part of a quaternion


def trajectory_text(trajectory: Trajectory) -> str:
    """TUM lines in space; nine decimals of seconds and quaternions, six of metres.

    A line `# lost: ...` stands before scans whose poses are guesses, `# found` before those after
    them: readers of the format pass over lines that begin with #.
    """
    poses = trajectory.poses
    tilt = np.zeros_like(poses) if trajectory.tilt is None else trajectory.tilt
    places = np.column_stack([poses[:, :2], tilt[:, 0]])
    quaternions = quaternions_from_rpy(tilt[:, 1], tilt[:, 2], poses[:, 2])
    lines, remarks = [], _remarks(trajectory)
    for row, (stamp, place, quaternion) in enumerate(
        zip(trajectory.stamps_ns.tolist(), places.tolist(), quaternions.tolist(), strict=True)
    ):
        lines.append(remarks.get(row, ""))
        position = " ".join(decimal(value) for value in place)
        rotation = " ".join(decimal(value, 9) for value in quaternion)
        lines.append(f"{stamp_text(stamp)} {position} {rotation}\n")
    return "".join(lines)


def _remarks(trajectory: Trajectory) -> dict[int, str]:
    """The lines before some rows of a trajectory that tell of lost scans."""
    lost = trajectory.lost
    if lost is None or not lost.any():
        return {}
    return {
        start: f"{_LOST}: the poses of the next {counted(end - start, 'scan')} are guesses\n"
        if lost[start]
        else f"{_FOUND}\n"
        for start, end in runs(lost)
        if start or lost[start]
    }


def planar_trajectory_text(trajectory: Trajectory) -> str:
    """TUM lines of true poses in the plane, their stamps in whole microseconds.

    Metres have nine decimals; z, qx and qy are a bare 0.
    """
    half = 0.5 * trajectory.poses[:, 2]
    columns = np.column_stack([trajectory.poses[:, :2], np.sin(half), np.cos(half)])
    lines = []
    for stamp, row in zip(trajectory.stamps_ns.tolist(), columns.tolist(), strict=True):
        x, y, qz, qw = (decimal(value, 9) for value in row)
        seconds = stamp_text(stamp)[:-3]
        lines.append(f"{seconds} {x} {y} 0 0 0 {qz} {qw}\n")
    return "".join(lines)


def read_trajectory(path: str | Path, limits: LimitsConfig | None = None) -> Trajectory:
    """The trajectory of a map back: its poses in space, and which of its scans were lost.

    Raises MapError naming the line at fault.
    """
    path = Path(path)
    try:
        lines = read_text(path, limits).splitlines()
    except OSError as error:
        raise MapError.of_system(error, "cannot read the trajectory", where=path) from None
    except UnicodeDecodeError:
        raise MapError("not a text file", "build the map again", where=path) from None
    stamps: list[int] = []
    rows: list[list[float]] = []
    lost: list[bool] = []
    is_lost = False
    for number, line in enumerate(lines, start=1):
        if line.startswith("#"):
            is_lost = line.startswith(_LOST) or (is_lost and not line.startswith(_FOUND))
            continue
        try:
            stamp, *words = line.split()
            stamps.append(int(np.int64(stamp_ns(stamp))))
            rows.append(_row(words))
            lost.append(is_lost)
        except (ValueError, OverflowError):
            raise MapError(
                f"line {number} is {line!r}",
                "expected t x y z qx qy qz qw: build the map again",
                where=path,
            ) from None
    return _trajectory(stamps, np.array(rows, dtype=np.float64).reshape(-1, 7), lost)


def _row(words: list[str]) -> list[float]:
    """Position and quaternion; ValueError for anything else."""
    row = [float(word) for word in words]
    if len(row) != _COLUMNS - 1 or not all(abs(value) <= _FARTHEST for value in row):
        raise ValueError(words)
    return row


def _trajectory(stamps: list[int], rows: np.ndarray, lost: list[bool]) -> Trajectory:
    roll, pitch, yaw = rpy_from_quaternions(rows[:, 3:]).T
    tilt = np.column_stack([rows[:, 2], roll, pitch])
    marks = np.array(lost, dtype=np.bool_)
    return Trajectory(
        stamps_ns=np.array(stamps, dtype=np.int64),
        poses=np.column_stack([rows[:, :2], yaw]),
        tilt=tilt if tilt.any() else None,
        lost=marks if marks.any() else None,
    )
