"""The occupancy grid: scans integrated by hit and miss counts, on a grid that grows with them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import PlanarScan
from specmap_cli.core.settings import GridConfig
from specmap_cli.grids.evidence import SUBPIXEL_BITS, Cell, Fan, fans_of, footprints_of
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap, slices_near

_OCCUPIED_SHARE = 0.25  # hits / (hits + misses) of a wall
_FREE, _OCCUPIED, _UNKNOWN = (np.uint8(state) for state in (FREE, OCCUPIED, UNKNOWN))
_ONCE = np.float32(1.0)
_GROWTH_CELLS = 128  # added on a side that grows: some 6 m at once, so that it seldom does


class OccupancyGrid:
    """Hit and miss counts on a grid that grows with what is integrated.

    A cell is occupied when at least `_OCCUPIED_SHARE` of the scans that saw it ended in it, free
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

    def integrate(
        self, scans: Sequence[PlanarScan], grid_from_laser: FloatArray, grid_from_base: FloatArray
    ) -> None:
        """Add scans taken at `grid_from_laser` (n, 3) by a robot at `grid_from_base` (n, 3).

        A cell counts once a scan at the most. What the robot covered counts as passed through,
        where the grid may grow to hold it. Some dozens of scans at once are quickest.
        """
        discs = footprints_of(grid_from_base, self.config.footprint_m, self.resolution)
        stood = []
        for number, fan in enumerate(fans_of(scans, grid_from_laser, self.config)):
            self._add(fan)
            stood.append(self._cover(discs.low[number], discs.high[number]))
        self._pass_through(*discs.cells(stood))

    def snapshot(self) -> GridMap:
        """The trinary grid as it stands."""
        return self._picture(slice(0, self._hits.shape[0]), slice(0, self._hits.shape[1]))

    def near(self, points: FloatArray, reach_m: float) -> GridMap:
        """The part of `snapshot` within `reach_m` of the box round points (n, 2 or more)."""
        shape = self._hits.shape
        return self._picture(*slices_near(points, reach_m, self._origin, self.resolution, shape))

    def include(self, other: OccupancyGrid) -> None:
        """Add the counts of another grid of the same cells, if this one may grow to hold it."""
        if not other._hits.size:
            return
        if not self._cover(*other._box):
            self.refused += 1
            return
        window = self._window(*other._box)
        self._hits[window] += other._hits
        self._misses[window] += other._misses

    def without(self, part: OccupancyGrid) -> OccupancyGrid:
        """What was counted besides `part`, a grid of some of the same scans; it may be smaller.

        A grid next to its largest size may have refused what the part took: none counts below 0.
        """
        rest = OccupancyGrid(self.config)
        if not self._hits.size:
            return rest
        rest._corner, rest._hits, rest._misses = (
            self._corner,
            self._hits.copy(),
            self._misses.copy(),
        )
        here, there = rest._shared(part), part._shared(rest)
        for counts, taken in ((rest._hits, part._hits), (rest._misses, part._misses)):
            counts[here] = np.maximum(counts[here] - taken[there], 0)
        rest._crop()
        return rest

    def _add(self, fan: Fan | None) -> None:
        """Count what one scan proves, if it proves anything and the grid may grow to hold it."""
        if fan is None:
            return
        if not self._cover(fan.low, fan.high):
            self.refused += 1
            return
        (left, bottom), (right, top) = fan.low, fan.high
        passed = np.zeros((top - bottom, right - left), dtype=np.uint8)
        cv2.fillPoly(passed, [fan.star], 1, cv2.LINE_8, SUBPIXEL_BITS)
        passed[fan.rows, fan.columns] = 0
        rows, columns = self._window(fan.low, fan.high)
        cv2.accumulate(passed, self._misses[rows, columns])
        cells = self._flat(fan.rows + rows.start, fan.columns + columns.start)
        self._hits.reshape(-1)[cells] += 1  # once for a cell that several beams hit

    def _pass_through(self, columns: NDArray[np.intp], rows: NDArray[np.intp]) -> None:
        """Count cells (m,), which the grid holds, as passed through, each as often as it comes."""
        column, row = self._corner
        np.add.at(self._misses.reshape(-1), self._flat(rows - row, columns - column), _ONCE)

    def _flat(self, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> NDArray[np.intp]:
        """Numbers (m,) of the elements in some rows and columns (m,), row after row."""
        return np.asarray(rows * self._hits.shape[1] + columns)

    def _picture(self, rows: slice, columns: slice) -> GridMap:
        """The trinary grid in some rows and columns."""
        hits, misses = self._hits[rows, columns], self._misses[rows, columns]
        cells = np.where(misses > 0, _FREE, _UNKNOWN)
        hit = np.nonzero(hits)
        seen = hits[hit] + misses[hit].astype(np.float64)
        occupied = hits[hit] >= _OCCUPIED_SHARE * seen
        cells[hit] = np.where(occupied, _OCCUPIED, _FREE)
        x, y = self._origin
        left, low = int(columns.start), int(rows.start)
        corner = (x + left * self.resolution, y + low * self.resolution)
        return GridMap(cells, self.resolution, corner)

    @property
    def _origin(self) -> tuple[float, float]:
        """Metres from the frame's origin to the corner of the first element."""
        return self._corner[0] * self.resolution, self._corner[1] * self.resolution

    @property
    def _box(self) -> tuple[Cell, Cell]:
        """The cells that the grid covers, the second not among them."""
        (column, row), (rows, columns) = self._corner, self._hits.shape
        return self._corner, (column + columns, row + rows)

    def _shared(self, other: OccupancyGrid) -> tuple[slice, slice]:
        """Rows and columns of this grid that the other covers as well."""
        (low, high), (first, end) = self._box, other._box
        low = max(low[0], first[0]), max(low[1], first[1])
        high = max(low[0], min(high[0], end[0])), max(low[1], min(high[1], end[1]))
        return self._window(low, high)

    def _crop(self) -> None:
        """Give up the rows and columns at the sides in which nothing was counted."""
        seen = (self._hits > 0) | (self._misses > 0)
        rows, columns = (np.flatnonzero(seen.any(axis=axis)).tolist() for axis in (1, 0))
        if not rows:
            self._hits, self._misses = self._hits[:0, :0], self._misses[:0, :0]
            return
        window = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
        self._hits, self._misses = self._hits[window].copy(), self._misses[window].copy()
        self._corner = self._corner[0] + columns[0], self._corner[1] + rows[0]

    def _window(self, low: Cell, high: Cell) -> tuple[slice, slice]:
        column, row = self._corner
        return slice(low[1] - row, high[1] - row), slice(low[0] - column, high[0] - column)

    def _cover(self, low: Cell, high: Cell) -> bool:
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
