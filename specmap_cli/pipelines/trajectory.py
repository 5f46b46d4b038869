"""The trajectory as it grows: some 60 bytes a scan, nothing else of the scan is kept."""

from __future__ import annotations

import math
from array import array

import numpy as np

from specmap_cli.core.records import PosedScan, Trajectory

_NOWHERE = (math.nan, math.nan, math.nan)


class TrajectoryRecorder:
    """Collects the pose of every registered scan."""

    def __init__(self) -> None:
        self._stamps = array("q")
        self._poses = array("d")
        self._tilt = array("d")
        self._lost = array("b")
        self._blind = array("b")
        self._odometry = array("d")

    def __len__(self) -> int:
        return len(self._stamps)

    def append(self, scan: PosedScan) -> None:
        """Add one scan; z, roll and pitch are kept once a 3D pose has been seen."""
        self._stamps.append(scan.stamp_ns)
        self._poses.extend(scan.map_from_base)
        self._lost.append(scan.lost)
        self._blind.append(scan.blind)
        self._odometry.extend(scan.odom_from_base or _NOWHERE)
        if scan.map_from_base_3d is not None:
            self._tilt.extend([0.0] * (3 * (len(self) - 1) - len(self._tilt)))
            m = scan.map_from_base_3d
            roll = np.arctan2(m[2, 1], m[2, 2])
            pitch = np.arctan2(-m[2, 0], np.hypot(m[2, 1], m[2, 2]))
            self._tilt.extend((float(m[2, 3]), float(roll), float(pitch)))

    def trajectory(self) -> Trajectory:
        """What has been recorded so far, as arrays."""
        tilt = None
        if self._tilt:
            tilt = np.zeros((len(self), 3))
            tilt.reshape(-1)[: len(self._tilt)] = self._tilt
        return Trajectory(
            stamps_ns=np.array(self._stamps, dtype=np.int64),
            poses=np.array(self._poses, dtype=np.float64).reshape(-1, 3),
            tilt=tilt,
            lost=np.array(self._lost, dtype=np.bool_),
            blind=np.array(self._blind, dtype=np.bool_),
            odometry=np.array(self._odometry, dtype=np.float64).reshape(-1, 3),
        )
