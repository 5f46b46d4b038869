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
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, CellArray, GridMap

_Cell = tuple[int, int]  # column and row

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
        # counts as OpenCV adds them up fastest; whole numbers up to 16 million are exact
        self._misses: NDArray[np.float32] = np.zeros((0, 0), dtype=np.float32)

    def integrate(self, scan: PlanarScan, grid_from_laser: Pose2) -> None:
        """Add one scan taken at `grid_from_laser`: each cell counts once a scan at the most."""
        beams = np.flatnonzero(np.isfinite(scan.ranges) & (scan.ranges > 0.0))
        if not len(beams):
            return
        ranges = scan.ranges[beams]
        x, y = self._ends(scan.bearings[beams], ranges, grid_from_laser)
        start = grid_from_laser.x / self.resolution, grid_from_laser.y / self.resolution
        low = math.floor(min(x.min(), start[0])) - 1, math.floor(min(y.min(), start[1])) - 1
        high = math.floor(max(x.max(), start[0])) + 2, math.floor(max(y.max(), start[1])) + 2
        if not self._cover(low, high):
            self.refused += 1
            return
        x, y, start = x - low[0], y - low[1], (start[0] - low[0], start[1] - low[1])
        passed = np.zeros((high[1] - low[1], high[0] - low[0]), dtype=np.uint8)
        _carve(passed, start, x, y, self._surfaces(beams, x, y))
        hit = ranges <= self.config.max_range_m
        columns, rows = x[hit].astype(np.intp), y[hit].astype(np.intp)
        passed[rows, columns] = 0
        window = self._window(low, high)
        cv2.accumulate(passed, self._misses[window])
        hits = self._hits[window]
        hits[rows, columns] += 1  # once for a cell that several beams hit

    def mark_free_disc(self, x: float, y: float, radius: float) -> None:
        """Count the robot's own footprint, `radius` metres round (x, y), as passed through.

        Nothing is counted where the grid may not grow to hold it.
        """
        column, row, reach = x / self.resolution, y / self.resolution, radius / self.resolution
        low = math.floor(column - reach), math.floor(row - reach)
        high = math.floor(column + reach) + 1, math.floor(row + reach) + 1
        if not self._cover(low, high):
            return
        columns = np.arange(low[0], high[0]) + 0.5 - column
        rows = np.arange(low[1], high[1]) + 0.5 - row
        disc = (rows * rows)[:, None] + columns * columns <= reach * reach
        self._misses[self._window(low, high)] += disc

    def snapshot(self) -> GridMap:
        """The trinary grid as it stands."""
        seen = self._hits + self._misses
        cells = np.full(seen.shape, UNKNOWN, dtype=np.uint8)
        cells[seen > 0] = FREE
        cells[(self._hits > 0) & (self._hits >= self.config.occupied_share * seen)] = OCCUPIED
        origin = (self._corner[0] * self.resolution, self._corner[1] * self.resolution)
        return GridMap(cells, self.resolution, origin)

    def _ends(
        self, bearings: FloatArray, ranges: FloatArray, grid_from_laser: Pose2
    ) -> tuple[FloatArray, FloatArray]:
        """Where the beams end, in cells: (N,) columns and (N,) rows with their fractions."""
        bearings = bearings + grid_from_laser.theta
        ranges = np.minimum(ranges, self.config.max_range_m)
        x = (np.cos(bearings) * ranges + grid_from_laser.x) / self.resolution
        y = (np.sin(bearings) * ranges + grid_from_laser.y) / self.resolution
        return x, y

    def _surfaces(self, beams: NDArray[np.intp], x: FloatArray, y: FloatArray) -> NDArray[np.intp]:
        """Numbers of the ends at which another surface begins than that of the beam before."""
        gap = self.config.surface_gap_m / self.resolution
        same = beams[1:] - beams[:-1] == 1
        same &= (x[1:] - x[:-1]) ** 2 + (y[1:] - y[:-1]) ** 2 <= gap * gap
        return np.concatenate([[0], np.flatnonzero(~same) + 1])

    def _window(self, low: _Cell, high: _Cell) -> tuple[slice, slice]:
        column, row = self._corner
        return slice(low[1] - row, high[1] - row), slice(low[0] - column, high[0] - column)

    def _cover(self, low: _Cell, high: _Cell) -> bool:
        """Grow to hold cells low..high; False when that would pass the size limit."""
        rows, columns = self._hits.shape
        corner = self._corner
        if not rows:
            return self._grow_within(
                np.array(low), np.array(high), np.full((2, 2), _GROWTH_CELLS // 2)
            )
        end = corner[0] + columns, corner[1] + rows
        if low[0] >= corner[0] and low[1] >= corner[1] and high[0] <= end[0] and high[1] <= end[1]:
            return True
        outside = np.array([np.less(low, corner), np.greater(high, end)])
        return self._grow_within(
            np.minimum(low, corner), np.maximum(high, end), outside * _GROWTH_CELLS
        )

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
        misses = np.zeros((height, width), dtype=np.float32)
        rows, columns = self._hits.shape
        if rows:
            dx, dy = (np.array(self._corner) - low).tolist()
            hits[dy : dy + rows, dx : dx + columns] = self._hits
            misses[dy : dy + rows, dx : dx + columns] = self._misses
        self._hits, self._misses = hits, misses
        self._corner = (int(low[0]), int(low[1]))


def _carve(
    picture: CellArray,
    start: tuple[float, float],
    x: FloatArray,
    y: FloatArray,
    surfaces: NDArray[np.intp],
) -> None:
    """Set 1 where a beam passed: along it, and between two that met one surface.

    The star goes from the laser along each surface and back; the beams come in ascending order.
    """
    scale = 1 << _SUBPIXEL_BITS
    # the laser before the first end of each surface
    places = np.arange(len(x)) + np.cumsum(np.bincount(surfaces, minlength=len(x)))
    star = np.empty((len(x) + len(surfaces), 2))
    star[:] = start
    star[places, 0], star[places, 1] = x, y
    # cv2 counts pixel centres at whole numbers, the grid counts cell corners there
    fixed = np.round((star - 0.5) * scale).astype(np.int32)
    cv2.fillPoly(picture, [fixed], 1, cv2.LINE_8, _SUBPIXEL_BITS)
