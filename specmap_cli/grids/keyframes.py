"""Keyframes: which scans go on to mapping, and their store on disk.

Every scan is registered; only those taken after the robot moved or turned are kept, and these are
spooled to a temporary file, so that memory does not grow with the scans of a log: only the poses
(some 300 bytes a keyframe) stay in memory.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable, Sequence
from types import TracebackType

import numpy as np

from specmap_cli.core.config import GridConfig, KeyframeConfig
from specmap_cli.core.geometry import FloatArray, Pose2, wrap_angle
from specmap_cli.core.records import PlanarScan, PosedScan
from specmap_cli.grids.occupancy import OccupancyGrid


class KeyframeSelector:
    """Accepts a scan when the robot moved or turned enough since the last accepted one."""

    def __init__(self, config: KeyframeConfig) -> None:
        self.config = config
        self._last: Pose2 | None = None

    def accepts(self, scan: PosedScan) -> bool:
        """Whether `scan` is a keyframe; lost scans never are."""
        if scan.lost:
            return False
        if self._last is not None and not scan.restarted:
            step = self._last.inverse() @ scan.map_from_base
            moved = step.distance >= self.config.distance_m
            if not moved and abs(wrap_angle(step.theta)) < self.config.angle_rad:
                return False
        self._last = scan.map_from_base
        return True


def integrate_keyframes(
    store: KeyframeStore, numbers: Iterable[int], poses: FloatArray, config: GridConfig
) -> OccupancyGrid:
    """A grid of keyframes `numbers` of the store taken at `poses` (n, 3), grid frame from base."""
    grid = OccupancyGrid(config)
    for number, pose in zip(numbers, poses, strict=True):
        grid_from_base = Pose2(*pose.tolist())
        grid.integrate(store.scan(number), grid_from_base @ store.base_from_laser(number))
        grid.mark_free_disc(grid_from_base.x, grid_from_base.y, config.footprint_m)
    return grid


class KeyframeStore:
    """Keyframes by number 0, 1, ...: scans on disk, poses in memory. Close it, or use `with`."""

    def __init__(self) -> None:
        self._file = tempfile.TemporaryFile(prefix="specmap-")  # noqa: SIM115 (closed by close)
        self._spans: list[tuple[int, int, int]] = []  # offset, beams, number of the sensor
        self._sensors: list[tuple[float, bool, Pose2]] = []
        self._poses: list[Pose2] = []
        self._stamps: list[int] = []
        self._end = 0

    def append(self, scan: PosedScan) -> int:
        """Store one keyframe and return its number."""
        planar = scan.planar
        sensor = (planar.range_max, planar.full_circle, scan.base_from_laser)
        if sensor not in self._sensors:
            self._sensors.append(sensor)
        record = np.stack([planar.bearings, planar.ranges]).astype(np.float32)
        self._file.write(record.tobytes())
        self._file.flush()  # a process forked from this one must not write it again
        self._spans.append((self._end, record.shape[1], self._sensors.index(sensor)))
        self._end += record.nbytes
        self._poses.append(scan.map_from_base)
        self._stamps.append(scan.stamp_ns)
        return len(self._poses) - 1

    def __len__(self) -> int:
        return len(self._poses)

    @property
    def poses(self) -> FloatArray:
        """(n, 3) map_from_base as registered, metres and radians."""
        return np.array(self._poses, dtype=np.float64).reshape(-1, 3)

    @property
    def stamps_ns(self) -> list[int]:
        """Header stamp of each keyframe."""
        return self._stamps

    def poses_of(self, numbers: Sequence[int]) -> FloatArray:
        """(n, 3) map_from_base of some keyframes as registered."""
        return np.array([self._poses[number] for number in numbers]).reshape(-1, 3)

    def pose(self, number: int) -> Pose2:
        """map_from_base of one keyframe as registered."""
        return self._poses[number]

    def scan(self, number: int) -> PlanarScan:
        """The planar scan of one keyframe, read from disk."""
        offset, beams, sensor = self._spans[number]
        range_max, full_circle, _ = self._sensors[sensor]
        # without moving the place in the file, which forked processes share
        read = os.pread(self._file.fileno(), 8 * beams, offset)
        record = np.frombuffer(read, dtype=np.float32).astype(np.float64)
        bearings, ranges = record.reshape(2, beams)
        return PlanarScan(self._stamps[number], bearings, ranges, range_max, full_circle)

    def base_from_laser(self, number: int) -> Pose2:
        """Mounting of the laser of one keyframe."""
        return self._sensors[self._spans[number][2]][2]

    def points(self, number: int, max_range: float = np.inf) -> FloatArray:
        """Returns (N, 2) of one keyframe in the base frame."""
        return self.base_from_laser(number).apply(self.scan(number).hits(max_range))

    def close(self) -> None:
        """Delete the file."""
        self._file.close()

    def __enter__(self) -> KeyframeStore:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
