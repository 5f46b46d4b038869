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

from specmap_cli.core.geometry import FloatArray, Pose2, moved
from specmap_cli.core.records import PlanarScan, PosedScan
from specmap_cli.grids.gridmap import GridMap, cast_ranges

WINDOW_M = 10.0  # path whose scans make a virtual scan
VIRTUAL_BEAMS = 360  # bearings of a virtual scan
VIRTUAL_RANGE_M = 20.0  # farther returns are not in a virtual scan
_VIRTUAL_SPACING_M = 0.2  # motion between the scans in a virtual scan
_VIRTUAL_SPACING_RAD = 0.3  # turn between the scans in a virtual scan
_RANGE_DECIMALS = 6  # of metres: far below the noise of a laser, far above that of a sum
_NEAREST_M = 0.05  # a return this near to the virtual laser has no bearing to speak of


def all_round(ranges: FloatArray, range_max: float, stamp_ns: int = 0) -> PlanarScan:
    """The full-circle scan of ranges (B,) at the bearings of `circle(B)`, to the micrometre.

    The poses behind them differ in their last bits from processor to processor.
    """
    return PlanarScan(
        stamp_ns=stamp_ns,
        bearings=circle(len(ranges)),
        ranges=np.round(ranges, _RANGE_DECIMALS),
        range_max=range_max,
        full_circle=True,
    )


def circle(beams: int) -> FloatArray:
    """(beams,) bearings of a full circle, ascending from -pi."""
    return np.asarray(-math.pi + 2.0 * math.pi / beams * np.arange(beams), dtype=np.float64)


class RecentScans:
    """The scans of a window of the path, thinned, from which a virtual scan is put together.

    The window is the last `WINDOW_M`. `filled` is the path that the scans cover as a share
    of it.
    """

    def __init__(self) -> None:
        self._kept: deque[tuple[float, Pose2, FloatArray]] = deque()
        self._travelled = 0.0
        self._started = 0.0
        self._last: Pose2 | None = None

    @property
    def filled(self) -> float:
        """Share of the window that has been driven, in [0, 1]."""
        return min(1.0, (self._travelled - self._started) / WINDOW_M)

    def clear(self) -> None:
        """Forget all scans: the next pose has nothing to do with the last one."""
        self._kept.clear()
        self._started = self._travelled
        self._last = None

    def add(self, scan: PosedScan) -> None:
        """Take in one registered scan."""
        points = scan.planar.hits(VIRTUAL_RANGE_M)
        self.add_points(points, scan.map_from_base, scan.base_from_laser)

    def add_points(self, points: FloatArray, map_from_base: Pose2, base_from_laser: Pose2) -> None:
        """Take in the returns (N, 2) of one scan, in the laser's frame."""
        if self.moves_on(map_from_base):
            self.keep(points, map_from_base, base_from_laser)

    def moves_on(self, map_from_base: Pose2) -> bool:
        """Drive on to a pose; whether its scan, too, is to be kept: most are not."""
        if self._last is not None:
            self._travelled += (self._last.inverse() @ map_from_base).distance
        self._last = map_from_base
        before = self._kept[-1][1] if self._kept else None
        spacing = _VIRTUAL_SPACING_M, _VIRTUAL_SPACING_RAD
        return moved(before, map_from_base, *spacing)

    def keep(self, points: FloatArray, map_from_base: Pose2, base_from_laser: Pose2) -> None:
        """Keep the returns (N, 2) of the scan at the pose that was driven to, in its own frame."""
        placed = (map_from_base @ base_from_laser).apply(points)
        self._kept.append((self._travelled, map_from_base, placed))
        while self._kept[0][0] < self._travelled - WINDOW_M:
            self._kept.popleft()

    def scan(self, stamp_ns: int, map_from_laser: Pose2, share: float = 1.0) -> PlanarScan:
        """The virtual scan seen from `map_from_laser`: the nearest return at each bearing.

        Of the window its last `share` in (0, 1] counts, up to the last scan that was kept.
        """
        since = self._kept[-1][0] - share * WINDOW_M if self._kept else 0.0
        placed = [points for travelled, _, points in self._kept if travelled >= since]
        points = np.vstack(placed) if placed else np.zeros((0, 2))
        seen = map_from_laser.inverse().apply(points)
        beams, reach = VIRTUAL_BEAMS, VIRTUAL_RANGE_M
        return nearest_returns(seen, beams, reach, stamp_ns)


def nearest_returns(
    points: NDArray[Any], beams: int, max_range: float, stamp_ns: int = 0
) -> PlanarScan:
    """A full-circle scan of points (N, 2) in the laser's frame: the nearest one per bearing."""
    ranges = np.sqrt(points[:, 0] ** 2 + points[:, 1] ** 2)
    beam = np.floor((np.arctan2(points[:, 1], points[:, 0]) / (2 * math.pi) + 0.5) * beams + 0.5)
    nearest = np.full(beams, np.inf)
    seen = (ranges > _NEAREST_M) & (ranges < max_range)
    np.minimum.at(nearest, beam[seen].astype(np.intp) % beams, ranges[seen])
    return all_round(nearest, max_range, stamp_ns)


def cast_circles(
    grid: GridMap, origins: NDArray[Any], beams: int, max_range: float
) -> list[PlanarScan]:
    """Full-circle scans cast in a grid from origins (N, 2) of its frame."""
    ranges = cast_ranges(grid.obstacle_distance(), grid, origins, circle(beams), max_range)
    return [all_round(row, max_range) for row in ranges]
