"""The occupancy grid: scans integrated by hit and miss counts, on a grid that grows with them."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import PlanarScan
from specmap_cli.core.settings import GridConfig
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, BoolArray, CellArray, GridMap

_SUBPIXEL_BITS = 4  # OpenCV draws on a lattice of 1/16 cell, finer than a laser's noise
_GROWTH_CELLS = 128  # added on a side that grows: some 6 m at once, so that it seldom does


class OccupancyGrid:
    """Hit and miss counts on a grid that grows with what is integrated.

    A cell is occupied when at least `occupied_share` of the scans that saw it ended in it, free
    when some beam passed through and it is not occupied, and unknown otherwise. A beam without a
    return proves nothing and carves nothing. A scan for which the grid would grow past
    `max_extent_m` or `max_area_m2` is left out and counted in `refused`.
    """

    def __init__(self, config: GridConfig) -> None:
        self.config = config
        self.resolution = config.resolution_m
        self.refused = 0
        self._corner = (0, 0)  # cell coordinates (column, row) of element [0, 0]
        self._hits: NDArray[np.int32] = np.zeros((0, 0), dtype=np.int32)
        self._misses: NDArray[np.int32] = np.zeros((0, 0), dtype=np.int32)

    def integrate(self, scan: PlanarScan, grid_from_laser: Pose2) -> None:
        """Add one scan taken at `grid_from_laser`: each cell counts once a scan at the most."""
        returned = np.isfinite(scan.ranges) & (scan.ranges > 0.0)
        if not returned.any():
            return
        ranges = np.where(returned, np.minimum(scan.ranges, self.config.max_range_m), 0.0)
        bearings = scan.bearings + grid_from_laser.theta
        ends = np.column_stack([np.cos(bearings), np.sin(bearings)]) * ranges[:, None]
        ends += (grid_from_laser.x, grid_from_laser.y)
        cells = ends / self.resolution
        start = np.array([grid_from_laser.x, grid_from_laser.y]) / self.resolution
        seen = cells[returned]
        low = np.floor(np.minimum(seen.min(axis=0), start)).astype(int) - 1
        high = np.floor(np.maximum(seen.max(axis=0), start)).astype(int) + 2
        if not self._cover(low, high):
            self.refused += 1
            return
        width, height = (high - low).tolist()
        passed = _carved(cells - low, start - low, returned, width, height, self.config)
        hit = returned & (scan.ranges <= self.config.max_range_m)
        columns, rows = np.floor(cells[hit] - low).astype(np.intp).T
        passed[rows, columns] = 0
        window = self._window(low, high)
        self._misses[window] += passed
        hits = self._hits[window]
        hits[rows, columns] += 1  # once for a cell that several beams hit

    def mark_free_disc(self, x: float, y: float, radius: float) -> None:
        """Count the robot's own footprint, `radius` metres round (x, y), as passed through.

        Nothing is counted where the grid may not grow to hold it.
        """
        centre = np.array([x, y]) / self.resolution
        reach = radius / self.resolution
        low = np.floor(centre - reach).astype(int)
        high = np.floor(centre + reach).astype(int) + 1
        if not self._cover(low, high):
            return
        columns = np.arange(low[0], high[0]) + 0.5 - centre[0]
        rows = np.arange(low[1], high[1]) + 0.5 - centre[1]
        self._misses[self._window(low, high)] += (
            rows[:, None] ** 2 + columns[None, :] ** 2 <= reach**2
        )

    def snapshot(self) -> GridMap:
        """The trinary grid as it stands."""
        seen = self._hits + self._misses
        cells = np.full(seen.shape, UNKNOWN, dtype=np.uint8)
        cells[seen > 0] = FREE
        cells[(self._hits > 0) & (self._hits >= self.config.occupied_share * seen)] = OCCUPIED
        origin = (self._corner[0] * self.resolution, self._corner[1] * self.resolution)
        return GridMap(cells, self.resolution, origin)

    def _window(self, low: NDArray[Any], high: NDArray[Any]) -> tuple[slice, slice]:
        column, row = self._corner
        return (
            slice(int(low[1]) - row, int(high[1]) - row),
            slice(int(low[0]) - column, int(high[0]) - column),
        )

    def _cover(self, low: NDArray[Any], high: NDArray[Any]) -> bool:
        """Grow to hold cells low..high; False when that would pass the size limit."""
        rows, columns = self._hits.shape
        corner = np.array(self._corner)
        if not rows:
            return self._grow_within(low, high, np.full((2, 2), _GROWTH_CELLS // 2))
        end = corner + (columns, rows)
        outside = np.array([low < corner, high > end])
        if not outside.any():
            return True
        low, high = np.minimum(low, corner), np.maximum(high, end)
        return self._grow_within(low, high, outside * _GROWTH_CELLS)

    def _grow_within(self, low: NDArray[Any], high: NDArray[Any], spare: NDArray[np.intp]) -> bool:
        """Cover cells low..high, with `spare` (2, 2) cells below and above if the limits allow."""
        for margin in (spare, np.zeros_like(spare)):
            first, end = low - margin[0], high + margin[1]
            sides = (end - first) * self.resolution
            large = max(sides) > self.config.max_extent_m
            if not large and math.prod(sides) <= self.config.max_area_m2:
                self._grow(first, end)
                return True
        return False

    def _grow(self, low: NDArray[Any], high: NDArray[Any]) -> None:
        """Make the grid cover cells low..high, which hold all it covers now."""
        width, height = (high - low).tolist()
        hits = np.zeros((height, width), dtype=np.int32)
        misses = np.zeros_like(hits)
        rows, columns = self._hits.shape
        if rows:
            dx, dy = (np.array(self._corner) - low).tolist()
            hits[dy : dy + rows, dx : dx + columns] = self._hits
            misses[dy : dy + rows, dx : dx + columns] = self._misses
        self._hits, self._misses = hits, misses
        self._corner = (int(low[0]), int(low[1]))


def _carved(
    ends: FloatArray,
    start: FloatArray,
    returned: BoolArray,
    width: int,
    height: int,
    config: GridConfig,
) -> CellArray:
    """(height, width) 1 where a beam passed: along it, and between two that met one surface."""
    picture = np.zeros((height, width), dtype=np.uint8)
    scale = 1 << _SUBPIXEL_BITS
    # cv2 counts pixel centres at whole numbers, the grid counts cell corners there
    fixed = np.round((ends - 0.5) * scale).astype(np.int32)
    centre = np.round((start[None] - 0.5) * scale).astype(np.int32)
    same = returned[1:] & returned[:-1]
    same &= np.hypot(*(ends[1:] - ends[:-1]).T) * config.resolution_m <= config.surface_gap_m
    # a star: from the laser along each surface and back; the beams come in ascending order
    returns = fixed[returned]
    starts = np.flatnonzero(np.concatenate([[True], ~same])[returned])
    star = np.insert(returns, starts, centre, axis=0)
    cv2.fillPoly(picture, [star], 1, cv2.LINE_8, _SUBPIXEL_BITS)
    return picture
