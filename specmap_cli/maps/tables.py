"""trajectory.tum and labels.csv: text tables of poses."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from specmap_cli.core.errors import MapError
from specmap_cli.core.geometry import quaternions_from_rpy
from specmap_cli.core.records import NO_SUBMAP, Labels, Trajectory
from specmap_cli.core.text import decimal, stamp_ns, stamp_text

LABELS_HEADER = "stamp,x,y,theta,submap"


def trajectory_text(trajectory: Trajectory) -> str:
    """TUM lines: t x y z qx qy qz qw; nine decimals of seconds and quaternions, six of metres."""
    poses = trajectory.poses
    tilt = np.zeros_like(poses) if trajectory.tilt is None else trajectory.tilt
    places = np.column_stack([poses[:, :2], tilt[:, 0]])
    quaternions = quaternions_from_rpy(tilt[:, 1], tilt[:, 2], poses[:, 2])
    lines = []
    for stamp, place, quaternion in zip(
        trajectory.stamps_ns.tolist(), places.tolist(), quaternions.tolist(), strict=True
    ):
        position = " ".join(decimal(value) for value in place)
        rotation = " ".join(decimal(value, 9) for value in quaternion)
        lines.append(f"{stamp_text(stamp)} {position} {rotation}\n")
    return "".join(lines)


def labels_text(labels: Labels) -> str:
    """CSV with a header; the last column is empty for a keyframe in no submap."""
    rows = [LABELS_HEADER]
    for stamp, pose, submap in zip(
        labels.stamps_ns.tolist(), labels.poses.tolist(), labels.submaps.tolist(), strict=True
    ):
        cells = [stamp_text(stamp), *(decimal(value) for value in pose)]
        rows.append(",".join([*cells, str(submap) if submap != NO_SUBMAP else ""]))
    return "\n".join(rows) + "\n"


def read_labels(path: Path) -> Labels:
    """labels.csv back. Raises MapError naming the line at fault."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise MapError(f"{path}: cannot read the keyframes: {error.strerror}") from None
    except UnicodeDecodeError:
        raise MapError(f"{path}: not a text file: build the map again") from None
    if not lines or lines[0] != LABELS_HEADER:
        raise MapError(f"{path}: line 1 is not {LABELS_HEADER!r}: build the map again")
    stamps, poses, submaps = [], [], []
    for number, line in enumerate(lines[1:], start=2):
        try:
            stamp, x, y, theta, submap = line.split(",")
            stamps.append(stamp_ns(stamp))
            poses.append((float(x), float(y), float(theta)))
            submaps.append(int(submap) if submap else NO_SUBMAP)
        except ValueError:
            raise MapError(f"{path}: line {number} is {line!r}: expected {LABELS_HEADER}") from None
    return Labels(
        np.array(stamps, dtype=np.int64),
        np.array(poses, dtype=np.float64).reshape(-1, 3),
        np.array(submaps, dtype=np.int64),
    )
