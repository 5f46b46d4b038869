"""Occupancy grids: integrating scans by hit and miss counts, casting virtual scans.

`OccupancyGrid` grows while scans come in; `GridMap` is the immutable trinary picture of it that
segmentation, recognition and the matcher work on, and that an existing map file is read into.
Cell (row, column) covers [x0 + column r, x0 + (column + 1) r) x [y0 + row r, y0 + (row + 1) r):
row 0 is the lowest y.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.config import GridConfig
from specmap_cli.geometry import FloatArray, Pose2
from specmap_cli.records import PlanarScan

FREE, OCCUPIED, UNKNOWN = 0, 1, 2
CellArray = NDArray[np.uint8]
BoolArray = NDArray[np.bool_]

_SUBPIXEL_BITS = 4
_GROWTH_CELLS = 128
_RAYS_AT_ONCE = 1 << 16
_BORDER = 1e-6  # cells a ray steps past a border, to stand in the next cell
_TINY = 1e-12


@dataclass(frozen=True, slots=True)
class GridMap:
    """A trinary grid: `cells` (H, W) FREE, OCCUPIED or UNKNOWN; `origin` its lower left corner."""

    cells: CellArray
    resolution: float
    origin: tuple[float, float] = (0.0, 0.0)

    @property
    def free(self) -> BoolArray:
        """Cells proved free (H, W)."""
        return np.asarray(self.cells == FREE)

    @property
    def occupied(self) -> BoolArray:
        """Cells with an obstacle (H, W)."""
        return np.asarray(self.cells == OCCUPIED)

    @property
    def free_area_m2(self) -> float:
        """Area of the free cells."""
        return float(np.count_nonzero(self.cells == FREE)) * self.resolution**2

    def cells_of(self, points: NDArray[Any]) -> NDArray[np.intp]:
        """(N, 2) row and column of the cell of each point (N, 2); may lie outside the grid."""
        column_row = np.floor((np.asarray(points) - self.origin) / self.resolution)
        return column_row[:, ::-1].astype(np.intp)

    def centres_of(self, cells: NDArray[Any]) -> FloatArray:
        """(N, 2) x and y of the centres of cells given by row and column (N, 2)."""
        return np.asarray(
            (np.asarray(cells)[:, ::-1] + 0.5) * self.resolution + self.origin, dtype=np.float64
        )

    def inside(self, cells: NDArray[Any]) -> BoolArray:
        """Which of the cells (N, 2) lie on the grid."""
        rows, columns = np.asarray(cells)[:, 0], np.asarray(cells)[:, 1]
        height, width = self.cells.shape
        return np.asarray((rows >= 0) & (columns >= 0) & (rows < height) & (columns < width))

    def values_at(self, points: NDArray[Any]) -> CellArray:
        """(N,) state of the cell under each point (N, 2); UNKNOWN outside."""
        cells = self.cells_of(points)
        inside = self.inside(cells)
        values = np.full(len(cells), UNKNOWN, dtype=np.uint8)
        values[inside] = self.cells[cells[inside, 0], cells[inside, 1]]
        return values

    def obstacle_distance(self) -> FloatArray:
        """(H, W) metres from each cell's centre to the nearest occupied one's; 1 km without any."""
        if not self.occupied.any():
            return np.full(self.cells.shape, 1e3)
        return cell_distances((self.cells != OCCUPIED).astype(np.uint8)) * self.resolution

    def clearance(self) -> FloatArray:
        """(H, W) metres from each free cell's centre to the nearest cell that is not free."""
        padded = np.pad(self.free.astype(np.uint8), 1)
        return cell_distances(padded)[1:-1, 1:-1] * self.resolution


def cell_distances(picture: CellArray) -> FloatArray:
    """(H, W) distance, in cells, from each cell's centre to the nearest zero cell's.

    OpenCV's last digits depend on its threads and on where in memory the picture lies. Squares of
    distances between cells are whole numbers: rounded to these, they are the same in every run.
    """
    pixels = cv2.distanceTransform(picture, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    squares = np.rint(np.square(pixels, dtype=np.float64))
    return np.asarray(np.sqrt(squares), dtype=np.float64)


class OccupancyGrid:
    """Hit and miss counts on a grid that grows with what is integrated.

    A cell is occupied when at least `occupied_share` of the scans that saw it ended in it, free
    when some beam passed through and it is not occupied, and unknown otherwise. A beam without a
    return proves nothing and carves nothing.
    """

    def __init__(self, config: GridConfig) -> None:
        self.config = config
        self.resolution = config.resolution_m
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
        """Count the robot's own footprint as passed through."""
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
        if rows == 0:
            new_low, new_high = low - _GROWTH_CELLS // 2, high + _GROWTH_CELLS // 2
        else:
            old_high = corner + (columns, rows)
            if (low >= corner).all() and (high <= old_high).all():
                return True
            new_low = np.where(low < corner, low - _GROWTH_CELLS, corner)
            new_high = np.where(high > old_high, high + _GROWTH_CELLS, old_high)
        size = new_high - new_low
        sides = size * self.resolution
        if max(sides) > self.config.max_extent_m or math.prod(sides) > self.config.max_area_m2:
            return False
        hits = np.zeros((int(size[1]), int(size[0])), dtype=np.int32)
        misses = np.zeros_like(hits)
        if rows:
            dx, dy = (corner - new_low).tolist()
            hits[dy : dy + rows, dx : dx + columns] = self._hits
            misses[dy : dy + rows, dx : dx + columns] = self._misses
        self._hits, self._misses = hits, misses
        self._corner = (int(new_low[0]), int(new_low[1]))
        return True


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


def cast_ranges(
    distance: NDArray[Any],
    grid: GridMap,
    origins: NDArray[Any],
    bearings: NDArray[Any],
    max_range: float,
) -> FloatArray:
    """Virtual scans: ranges (N, B) from origins (N, 2) along bearings (B,), +inf past `max_range`.

    `distance` is `grid.obstacle_distance()`; see `cast_rays`.
    """
    origins = np.asarray(origins, dtype=np.float64).reshape(-1, 2)
    starts = np.repeat(origins, len(bearings), axis=0)
    angles = np.tile(np.asarray(bearings, dtype=np.float64), len(origins))
    ranges = cast_rays(distance, grid, starts, angles, max_range)
    return ranges.reshape(len(origins), len(bearings))


def cast_rays(
    distance: NDArray[Any],
    grid: GridMap,
    origins: NDArray[Any],
    angles: NDArray[Any],
    max_range: float,
) -> FloatArray:
    """Ranges (N,) of single rays from origins (N, 2) along angles (N,), +inf past `max_range`.

    `distance` is `grid.obstacle_distance()`. A ray leaps by the free distance it stands in and
    walks from cell border to cell border near obstacles, so that its range is where it enters the
    first occupied cell it touches, exact to a thousandth of a millimetre. Rays that leave the grid
    return +inf.
    """
    ranges = np.full(len(angles), np.inf)
    for first in range(0, len(angles), _RAYS_AT_ONCE):
        part = slice(first, first + _RAYS_AT_ONCE)
        starts = (np.asarray(origins[part], dtype=np.float64) - grid.origin) / grid.resolution
        cells = _march(distance, grid.resolution, starts, angles[part], max_range / grid.resolution)
        ranges[part] = cells * grid.resolution
    return ranges


def _march(
    distance: NDArray[Any],
    resolution: float,
    starts: FloatArray,
    angles: NDArray[Any],
    limit: float,
) -> FloatArray:
    """`cast_rays` in cells: starts (N, 2) column and row; lengths (N,), +inf past `limit`."""
    height, width = distance.shape
    flat = distance.reshape(-1)
    lengths = np.full(len(angles), np.inf)
    alive = np.arange(len(angles))
    x, y = starts[:, 0].copy(), starts[:, 1].copy()
    dx, dy = _nonzero(np.cos(angles)), _nonzero(np.sin(angles))
    travelled = np.zeros(len(angles))
    while len(alive):
        column, row = np.floor(x), np.floor(y)
        on = (column >= 0) & (row >= 0) & (column < width) & (row < height) & (travelled <= limit)
        index = np.where(on, row * width + column, 0).astype(np.intp)
        room = flat[index] / resolution
        stopped = on & (room <= 0.0)
        lengths[alive[stopped]] = travelled[stopped]
        border = np.minimum((column + (dx > 0) - x) / dx, (row + (dy > 0) - y) / dy)
        # neither the ray nor the obstacle need be at the centre of its cell
        step = np.maximum(room - math.sqrt(2.0), border + _BORDER)
        on &= ~stopped
        alive, step, dx, dy = alive[on], step[on], dx[on], dy[on]
        x, y = x[on] + dx * step, y[on] + dy * step
        travelled = travelled[on] + step
    return lengths


def _nonzero(direction: FloatArray) -> FloatArray:
    """The same components with those next to zero replaced by a tiny one of a sure sign."""
    return np.where(np.abs(direction) < _TINY, _TINY, direction)
