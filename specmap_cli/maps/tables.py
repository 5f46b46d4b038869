"""labels.csv: the keyframes of a map with their submaps, as text and back."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from specmap_cli.core.errors import MapError
from specmap_cli.core.files import read_bytes
from specmap_cli.core.records import NO_SUBMAP, Labels
from specmap_cli.core.settings import LimitsConfig
from specmap_cli.core.tables import csv_text
from specmap_cli.core.text import decimal, stamp_ns, stamp_text

LABELS_HEADER = "stamp,x,y,theta,submap"
_FARTHEST = 1e8  # metres: twice around the earth, farther than any place in a map


def labels_text(labels: Labels) -> str:
    """CSV with a header; the last column is empty for a keyframe in no submap."""
    keyframes = zip(
        labels.stamps_ns.tolist(), labels.poses.tolist(), labels.submaps.tolist(), strict=True
    )
    rows = (
        [stamp_text(stamp), *map(decimal, pose), submap if submap != NO_SUBMAP else None]
        for stamp, pose, submap in keyframes
    )
    return csv_text(LABELS_HEADER.split(","), rows)


def read_text(path: Path, limits: LimitsConfig | None = None) -> str:
    """A text file of a map; OSError as in `read_bytes`, UnicodeDecodeError for no UTF-8."""
    most_mb = (LimitsConfig() if limits is None else limits).text_max_mb
    return read_bytes(path, most_mb, "limits.text_max_mb").decode("utf-8")


def read_labels(path: str | Path, limits: LimitsConfig | None = None) -> Labels:
    """labels.csv back. Raises MapError naming the line at fault."""
    path = Path(path)
    try:
        lines = read_text(path, limits).splitlines()
    except OSError as error:
        raise MapError.of_system(error, "cannot read the keyframes", where=path) from None
    except UnicodeDecodeError:
        raise MapError("not a text file", "build the map again", where=path) from None
    if not lines or lines[0] != LABELS_HEADER:
        raise MapError(f"line 1 is not {LABELS_HEADER!r}", "build the map again", where=path)
    stamps, poses, submaps = [], [], []
    for number, line in enumerate(lines[1:], start=2):
        try:
            stamp, x, y, theta, submap = line.split(",")
            stamps.append(np.int64(stamp_ns(stamp)))
            poses.append(_pose(x, y, theta))
            submaps.append(_submap(submap))
        except (ValueError, OverflowError):
            raise MapError(
                f"line {number} is {line!r}", f"expected {LABELS_HEADER}", where=path
            ) from None
    return Labels(
        stamps_ns=np.array(stamps, dtype=np.int64),
        poses=np.array(poses, dtype=np.float64).reshape(-1, 3),
        submaps=np.array(submaps, dtype=np.int64),
    )


def _pose(*words: str) -> tuple[float, ...]:
    """Numbers that a pose on earth has; ValueError otherwise."""
    pose = tuple(float(word) for word in words)
    if not all(abs(value) <= _FARTHEST for value in pose):  # false for NaN as well
        raise ValueError(words)
    return pose


def _submap(word: str) -> np.int64:
    """An id of 0 or more; NO_SUBMAP for an empty word; ValueError or OverflowError otherwise."""
    if word and not word.isdecimal():
        raise ValueError(word)
    return np.int64(int(word) if word else NO_SUBMAP)
