"""Virtual scans: what a laser would have seen that sees all round, or from beside where it was.

Full circles come from the scans of the last metres when localising, from a submap's own grid when
training. A room seen from all sides is recognised from headings, and on paths, that were never
driven. Scans from beside the way come from the outlines that the scans around it show.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray, Pose2, moved
from specmap_cli.core.records import PlanarScan
from specmap_cli.grids.gridmap import GridMap, cast_rays
from specmap_cli.recognition.features.shape import leaps

WINDOW_M = 10.0  # path whose scans make a virtual scan
VIRTUAL_BEAMS = 360  # bearings of a virtual scan
VIRTUAL_RANGE_M = 20.0  # farther returns are not in a virtual scan
_VIRTUAL_SPACING_M = 0.2  # motion between the scans in a virtual scan
_VIRTUAL_SPACING_RAD = 0.3  # turn between the scans in a virtual scan
_RANGE_DECIMALS = 6  # of metres: far below the noise of a laser, far above that of a sum
_NEAREST_M = 0.05  # a return this near to the virtual laser has no bearing to speak of
_TURN = 2.0 * math.pi


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
    """The scans of the last `WINDOW_M` of the path, thinned: a virtual scan is made of them."""

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

    def add(
        self, map_from_base: Pose2, base_from_laser: Pose2, scan: Callable[[], PlanarScan]
    ) -> bool:
        """Drive on to a pose; whether the scan from there, asked for then, is kept: few are."""
        if self._last is not None:
            self._travelled += (self._last.inverse() @ map_from_base).distance
        self._last = map_from_base
        before = self._kept[-1][1] if self._kept else None
        if not moved(before, map_from_base, _VIRTUAL_SPACING_M, _VIRTUAL_SPACING_RAD):
            return False
        placed = (map_from_base @ base_from_laser).apply(scan().hits(VIRTUAL_RANGE_M))
        self._kept.append((self._travelled, map_from_base, placed))
        while self._kept[0][0] < self._travelled - WINDOW_M:
            self._kept.popleft()
        return True

    def scan(self, stamp_ns: int, map_from_laser: Pose2, share: float = 1.0) -> PlanarScan:
        """The virtual scan seen from `map_from_laser`: the nearest return at each bearing.

        Of the window its last `share` in (0, 1] counts, up to the last scan that was kept.
        """
        since = self._kept[-1][0] - share * WINDOW_M if self._kept else 0.0
        placed = [points for travelled, _, points in self._kept if travelled >= since]
        points = np.vstack(placed) if placed else np.zeros((0, 2))
        seen = map_from_laser.inverse().apply(points)
        return nearest_returns(seen, VIRTUAL_BEAMS, VIRTUAL_RANGE_M, stamp_ns)


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
    starts, angles = np.repeat(origins, beams, axis=0), np.tile(circle(beams), len(origins))
    ranges = cast_rays(grid.obstacle_distance(), grid, starts, angles, max_range)
    return [all_round(row, max_range) for row in ranges.reshape(-1, beams)]


def outline(scan: PlanarScan, map_from_laser: Pose2, reach_m: float) -> FloatArray:
    """(k, 4) the lines x, y, x, y in the map between neighbouring returns of one surface.

    Returns farther than `reach_m` are left out.
    """
    ranges, bearings = scan.ranges, scan.bearings
    near = np.isfinite(ranges) & (ranges <= reach_m)
    r = np.where(near, ranges, 0.0)
    points = np.column_stack([r * np.cos(bearings), r * np.sin(bearings)])
    steps = np.hypot(*np.diff(points, axis=0).T)
    joined = near[1:] & near[:-1] & ~leaps(steps, r[1:], r[:-1])
    placed = map_from_laser.apply(points)
    return np.hstack([placed[:-1][joined], placed[1:][joined]])


def seen_from(
    lines: NDArray[Any], map_from_laser: Pose2, bearings: NDArray[Any], reach_m: float
) -> FloatArray:
    """(B,) ranges at bearings (B,), ascending, of the nearest of the lines (k, 4) in the map.

    +inf where there is none within `reach_m`.
    """
    laser = map_from_laser.inverse()
    starts, ends = laser.apply(lines[:, :2]), laser.apply(lines[:, 2:])
    # from and to which bearing each line is seen, three times, a turn apart: so a line behind the
    # laser is found on either side of where its bearings begin
    a = np.arctan2(starts[:, 1], starts[:, 0])
    turn = np.arctan2(ends[:, 1], ends[:, 0]) - a
    b = a + turn - _TURN * np.round(turn / _TURN)
    shifts = np.array([0.0, _TURN, -_TURN])[:, None]
    first = np.searchsorted(bearings, (np.minimum(a, b) + shifts).ravel())
    last = np.searchsorted(bearings, (np.maximum(a, b) + shifts).ravel(), side="right")
    beams = np.maximum(last - first, 0)
    line = np.repeat(np.arange(len(beams)), beams)
    beam = np.arange(len(line)) - np.repeat(np.cumsum(beams) - beams, beams) + first[line]
    line %= len(lines)
    # how far along its bearing each beam crosses its line
    start, along = starts[line], (ends - starts)[line]
    crossed = start[:, 0] * along[:, 1] - start[:, 1] * along[:, 0]
    facing = np.cos(bearings[beam]) * along[:, 1] - np.sin(bearings[beam]) * along[:, 0]
    hits = np.full(len(beam), np.inf)
    np.divide(crossed, facing, out=hits, where=facing != 0.0)
    ranges = np.full(len(bearings), np.inf)
    seen = (hits > _NEAREST_M) & (hits < reach_m)
    np.minimum.at(ranges, beam[seen], hits[seen])
    return np.round(ranges, _RANGE_DECIMALS)
