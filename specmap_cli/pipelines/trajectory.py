"""The trajectory as it grows: some 60 bytes a scan, nothing else of the scan is kept."""

from __future__ import annotations

from array import array

import numpy as np

from specmap_cli.core.records import PosedScan, Trajectory


class TrajectoryRecorder:
    """Collects the pose of every registered scan."""

    def __init__(self) -> None:
        self._stamps = array("q")
        self._poses = array("d")
        self._tilt = array("d")

    def __len__(self) -> int:
        return len(self._stamps)

    def append(self, scan: PosedScan) -> None:
        """Add one scan; z, roll and pitch are kept once a 3D pose has been seen."""
        self._stamps.append(scan.stamp_ns)
        self._poses.extend(scan.map_from_base)
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
            np.array(self._stamps, dtype=np.int64),
            np.array(self._poses, dtype=np.float64).reshape(-1, 3),
            tilt,
        )
