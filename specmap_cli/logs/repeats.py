"""A laser that hangs: its driver repeats one scan while the robot drives on.

The noise of a laser makes two scans with the same readings unlikely even where nothing moves.
"""

from __future__ import annotations

import math

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2, moved
from specmap_cli.core.records import Sweep

# Odometry of a robot that stands still may tremble by this. Where it does, what repeats the scan
# before says nothing new either.
_STILL_M, _STILL_RAD = 0.02, math.radians(1.0)


class Repeats:
    """Finds scans that repeat the one before them although odometry says that the robot moved."""

    def __init__(self) -> None:
        self._ranges: FloatArray = np.zeros(0)
        self._from: Pose2 | None = None  # where odometry had the robot at the first of those alike

    def stale(self, sweep: Sweep) -> bool:
        """Whether a scan is one that hangs; call for successive scans. Blank ones never are."""
        ranges, pose = sweep.planar.ranges, sweep.odom_from_base
        alike = np.array_equal(ranges, self._ranges, equal_nan=True)
        if not alike or not np.isfinite(ranges).any():
            self._ranges, self._from = ranges, pose
            return False
        if pose is None or self._from is None:
            return False
        return moved(self._from, pose, _STILL_M, _STILL_RAD)
