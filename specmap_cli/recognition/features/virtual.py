"""Virtual full-circle scans: what a laser that sees all round would have seen.

From the scans of the last metres when localising, from a submap's own grid when training. A room
seen from all sides is recognised from headings, and on paths, that were never driven.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import PlanarScan, PosedScan
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.grids.ray_casting import cast_ranges

_SPACING_M = 0.2
_SPACING_RAD = 0.3


def circle(beams: int) -> FloatArray:
    """(beams,) bearings of a full circle, ascending from -pi."""
    return np.asarray(-math.pi + 2.0 * math.pi / beams * np.arange(beams), dtype=np.float64)


class RecentScans:
    """The scans of the last `window_m` metres, thinned to one every 0.2 m or 0.3 rad.

    `filled` is the path they cover as a share of the window.
    """

    def __init__(self, window_m: float, beams: int, max_range: float) -> None:
        self.window_m = window_m
        self.beams = beams
        self.max_range = max_range
        self._kept: deque[tuple[float, Pose2, FloatArray]] = deque()
        self._travelled = 0.0
        self._started = 0.0
        self._last: Pose2 | None = None

    @property
    def filled(self) -> float:
        """Share of the window that has been driven, in [0, 1]."""
        return min(1.0, (self._travelled - self._started) / self.window_m)

    def clear(self) -> None:
        """Forget all scans: the next pose has nothing to do with the last one."""
        self._kept.clear()
        self._started = self._travelled
        self._last = None

    def add(self, scan: PosedScan) -> None:
        """Take in one registered scan."""
        self.add_points(scan.planar.hits(self.max_range), scan.map_from_base, scan.base_from_laser)

    def add_points(self, points: FloatArray, map_from_base: Pose2, base_from_laser: Pose2) -> None:
        """Take in the returns (N, 2) of one scan, in the laser's frame."""
        if self._last is not None:
            self._travelled += (self._last.inverse() @ map_from_base).distance
        self._last = map_from_base
        if self._kept:
            step = self._kept[-1][1].inverse() @ map_from_base
            if step.distance < _SPACING_M and abs(step.theta) < _SPACING_RAD:
                return
        placed = (map_from_base @ base_from_laser).apply(points)
        self._kept.append((self._travelled, map_from_base, placed))
        while self._kept[0][0] < self._travelled - self.window_m:
            self._kept.popleft()

    def scan(self, stamp_ns: int, map_from_laser: Pose2) -> PlanarScan:
        """The virtual scan seen from `map_from_laser`: the nearest return at each bearing."""
        placed = [points for _, _, points in self._kept]
        points = np.vstack(placed) if placed else np.zeros((0, 2))
        seen = map_from_laser.inverse().apply(points)
        return nearest_returns(seen, self.beams, self.max_range, stamp_ns)


def nearest_returns(
    points: NDArray[Any], beams: int, max_range: float, stamp_ns: int = 0
) -> PlanarScan:
    """A full-circle scan of points (N, 2) in the laser's frame: the nearest one per bearing."""
    ranges = np.sqrt(points[:, 0] ** 2 + points[:, 1] ** 2)
    beam = np.floor((np.arctan2(points[:, 1], points[:, 0]) / (2 * math.pi) + 0.5) * beams + 0.5)
    nearest = np.full(beams, np.inf)
    seen = (ranges > 0.05) & (ranges < max_range)
    np.minimum.at(nearest, beam[seen].astype(np.intp) % beams, ranges[seen])
    return PlanarScan(stamp_ns, circle(beams), nearest, max_range, True)


def cast_circles(
    grid: GridMap, origins: NDArray[Any], beams: int, max_range: float
) -> list[PlanarScan]:
    """Full-circle scans cast in a grid from origins (N, 2) of its frame."""
    bearings = circle(beams)
    ranges = cast_ranges(grid.obstacle_distance(), grid, origins, bearings, max_range)
    return [PlanarScan(0, bearings, row, max_range, True) for row in ranges]
