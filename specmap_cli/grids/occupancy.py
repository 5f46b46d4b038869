"""The occupancy grid: scans integrated by hit and miss counts, on a grid that grows with them.

What scans prove, their fans and the robot's footprints, is computed of many scans at once: one scan
has some hundreds of beams, and calls on arrays that short cost more than their arithmetic.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import PlanarScan
from specmap_cli.core.settings import GridConfig
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap, slices_near, window_of

Cell = Sequence[int]  # column and row
_Indices = NDArray[np.intp]

_OCCUPIED_SHARE = 0.25  # hits / (hits + misses) of a wall
_FREE, _OCCUPIED, _UNKNOWN = (np.uint8(state) for state in (FREE, OCCUPIED, UNKNOWN))
_MOST = 60_000  # scans counted of a cell: what comes after them changes no share
_RENEWED_BY = 8  # looks of a newer recording after which a cell is as it was seen last
_GROWTH_CELLS = 128  # added on a side that grows: some 6 m at once, so that it seldom does

SURFACE_GAP_M = 0.3  # returns this close bound one surface
SUBPIXEL_BITS = 4  # OpenCV draws on a lattice of 1/16 cell, finer than a laser's noise


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
        self._hits, self._misses = (np.zeros((0, 0), dtype=np.uint16) for _ in range(2))

    def integrate(
        self, scans: Sequence[PlanarScan], grid_from_laser: FloatArray, grid_from_base: FloatArray
    ) -> None:
        """Add scans taken at `grid_from_laser` (n, 3) by a robot at `grid_from_base` (n, 3).

        A cell counts once a scan at the most. What the robot covered counts as passed through,
        where the grid may grow to hold it. Some dozens of scans at once are quickest.
        """
        # what the robot covers: discs in boxes of cells, columns and rows, from `low` to `high`
        # (n, 2); `inside` (n, s, s) says of rows and columns from `low` on whether the cell's
        # centre is covered
        reach = self.config.footprint_m / self.resolution
        centre = grid_from_base[:, :2] / self.resolution
        low = np.floor(centre - reach).astype(np.intp)
        high = np.floor(centre + reach).astype(np.intp) + 1
        off = low[:, None, :] + np.arange(int(2.0 * reach) + 2)[:, None] + 0.5 - centre[:, None, :]
        squares = off * off
        inside = squares[:, :, None, 1] + squares[:, None, :, 0] <= reach * reach
        stood = []
        fans = fans_of(scans, grid_from_laser, self.config)
        for fan, first, end in zip(fans, low.tolist(), high.tolist(), strict=True):
            if fan is not None and not self._cover(fan.low, fan.high):
                self.refused += 1
            elif fan is not None:
                (left, bottom), (right, top) = fan.low, fan.high
                passed = np.zeros((top - bottom, right - left), dtype=np.uint16)
                cv2.fillPoly(passed, [fan.star], 1, cv2.LINE_8, SUBPIXEL_BITS)
                passed[fan.rows, fan.columns] = 0
                window = self._window(fan.low, fan.high)
                misses = self._misses[window]
                cv2.add(misses, passed, misses)  # which stops at the most
                rows, columns = fan.rows + window[0].start, fan.columns + window[1].start
                # once for a cell that several beams hit
                cells = rows * self._hits.shape[1] + columns
                self._hits.reshape(-1)[cells] += self._hits.reshape(-1)[cells] < _MOST
            stood.append(self._cover(first, end))
        disc, rows, columns = np.nonzero(inside & np.array(stood)[:, None, None])
        rows, columns = rows + low[disc, 1] - self._corner[1], columns + low[disc, 0]
        cells = rows * self._hits.shape[1] + columns - self._corner[0]
        cells = cells[self._misses.reshape(-1)[cells] < _MOST]
        np.add.at(self._misses.reshape(-1), cells, 1)  # each as often as it is stood on

    def snapshot(self, window: tuple[slice, slice] | None = None) -> GridMap:
        """The trinary grid as it stands, or a window of it: some of the rows and columns."""
        rows, columns = window or (slice(0, self._hits.shape[0]), slice(0, self._hits.shape[1]))
        hits, misses = self._hits[rows, columns], self._misses[rows, columns]
        cells = np.where(misses > 0, _FREE, _UNKNOWN)
        hit = np.nonzero(hits)
        seen = hits[hit] + misses[hit].astype(np.float64)
        occupied = hits[hit] >= _OCCUPIED_SHARE * seen
        cells[hit] = np.where(occupied, _OCCUPIED, _FREE)
        x, y = self._corner[0] * self.resolution, self._corner[1] * self.resolution
        corner = (x + columns.start * self.resolution, y + rows.start * self.resolution)
        return GridMap(cells, self.resolution, corner)

    def near(self, points: FloatArray, reach_m: float) -> GridMap:
        """The part of `snapshot` within `reach_m` of the box round points (n, 2 or more)."""
        origin = self._corner[0] * self.resolution, self._corner[1] * self.resolution
        shape = self._hits.shape
        return self.snapshot(slices_near(points, reach_m, origin, self.resolution, shape))

    def include(self, other: OccupancyGrid, *, renewing: bool = False) -> None:
        """Add the counts of another grid of the same cells, if this one may grow to hold it.

        A building changes: with `renewing`, cells at which the other one looked `_RENEWED_BY` times
        or more are as it saw them, unless it hit a cell beside them and leaves open whether they
        are walls: seen from afar a wall is hit here and there.
        """
        self.refused += other.refused
        if not other._hits.size:
            return
        if not self._cover(*other._box):
            self.refused += 1
            return
        window = self._window(*other._box)
        if renewing:
            looks = other._hits + other._misses.astype(np.int64)
            beside = cv2.dilate(other._hits, np.ones((3, 3), dtype=np.uint8)) > 0
            known = looks >= _RENEWED_BY
            known &= ~beside | (other._hits >= _OCCUPIED_SHARE * looks)
            self._hits[window][known] = self._misses[window][known] = 0
        for counts, more in ((self._hits, other._hits), (self._misses, other._misses)):
            counts[window] = cv2.add(counts[window], more)  # which stops at the most

    def without(self, part: OccupancyGrid) -> OccupancyGrid:
        """What was counted besides `part`, a grid of some of the same scans; it may be smaller.

        A grid next to its largest size may have refused what the part took: none counts below 0.
        """
        rest = OccupancyGrid(self.config)
        if not self._hits.size:
            return rest
        rest._corner = self._corner
        rest._hits, rest._misses = self._hits.copy(), self._misses.copy()
        here, there = rest._shared(part), part._shared(rest)
        for counts, taken in ((rest._hits, part._hits), (rest._misses, part._misses)):
            counts[here] -= np.minimum(counts[here], taken[there])
        window = window_of((rest._hits > 0) | (rest._misses > 0))
        rows, columns = window or (slice(0, 0), slice(0, 0))
        rest._hits = rest._hits[rows, columns].copy()
        rest._misses = rest._misses[rows, columns].copy()
        rest._corner = self._corner[0] + columns.start, self._corner[1] + rows.start
        return rest

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

    def _window(self, low: Cell, high: Cell) -> tuple[slice, slice]:
        column, row = self._corner
        return slice(low[1] - row, high[1] - row), slice(low[0] - column, high[0] - column)

    def _cover(self, low: Cell, high: Cell) -> bool:
        """Grow to hold cells low..high; False when that would pass the size limit."""
        corner, end = self._box
        if low[0] >= corner[0] and low[1] >= corner[1] and high[0] <= end[0] and high[1] <= end[1]:
            return True
        rows, columns = self._hits.shape
        first, last = np.array(low), np.array(high)
        spare = np.full((2, 2), _GROWTH_CELLS // 2)  # cells below and above, if the limits allow
        if rows:
            spare = np.array([first < corner, last > end]) * _GROWTH_CELLS
            first, last = np.minimum(first, corner), np.maximum(last, end)
        for below, above in (spare, np.zeros_like(spare)):
            width, height = (last + above - first + below).tolist()
            sides = (width * self.resolution, height * self.resolution)
            large = max(sides) > self.config.max_extent_m
            if not large and math.prod(sides) <= self.config.max_area_m2:
                first = first - below
                break
        else:
            return False
        dx, dy = (np.array(corner) - first).tolist()

        def grown(counts: NDArray[np.uint16]) -> NDArray[np.uint16]:
            larger = np.zeros((height, width), dtype=np.uint16)
            larger[dy : dy + rows, dx : dx + columns] = counts
            return larger

        self._hits = grown(self._hits)
        self._misses = grown(self._misses)
        self._corner = (int(first[0]), int(first[1]))
        return True


class Fan(NamedTuple):
    """What one scan proves about cells `low` to `high`, the latter not among them.

    `star` (k, 2) are the corners of what its beams passed through, in 1/16 cells from the centre of
    cell `low`: from the laser along each surface and back. `columns` and `rows` (m,) are the cells
    of its returns, counted from `low`.
    """

    low: Cell
    high: Cell
    star: NDArray[np.int32]
    columns: _Indices
    rows: _Indices


def fans_of(
    scans: Sequence[PlanarScan], grid_from_laser: FloatArray, config: GridConfig
) -> list[Fan | None]:
    """The fan of each scan, taken at `grid_from_laser` (n, 3); None where nothing came back."""
    ranges = np.concatenate([scan.ranges for scan in scans])
    returned = np.isfinite(ranges) & (ranges > 0.0)
    before = np.cumsum([0, *(len(scan.ranges) for scan in scans)])
    beams = np.flatnonzero(returned)
    bounds = np.searchsorted(beams, before)
    some = np.flatnonzero(np.diff(bounds))  # below, arrays have a row for each of these scans
    fans: list[Fan | None] = [None] * len(scans)
    if not len(some):
        return fans
    bearings = np.concatenate([scan.bearings for scan in scans])[beams]
    ranges, first, counts = ranges[beams], bounds[some], np.diff(bounds)[some]
    hit = ranges <= config.max_range_m
    # where beams end, in cells: columns and rows with their fractions
    lasers = np.repeat(grid_from_laser[some].T, counts, axis=1)
    bearings, ranges = bearings + lasers[2], np.minimum(ranges, config.max_range_m)
    x = (np.cos(bearings) * ranges + lasers[0]) / config.resolution_m
    y = (np.sin(bearings) * ranges + lasers[1]) / config.resolution_m
    # the box of cells round each scan's ends and its laser, with a spare cell on each side
    laser = grid_from_laser[some, :2] / config.resolution_m
    lowest, highest = (
        np.stack([extreme.reduceat(side, first) for side in (x, y)], axis=1)
        for extreme in (np.minimum, np.maximum)
    )
    low = np.floor(np.minimum(lowest, laser)).astype(np.intp) - 1
    high = np.floor(np.maximum(highest, laser)).astype(np.intp) + 2
    x -= np.repeat(low[:, 0], counts)
    y -= np.repeat(low[:, 1], counts)
    star, starts = _stars(beams, x, y, laser - low, first, SURFACE_GAP_M / config.resolution_m)
    returns = np.concatenate([[0], np.cumsum(np.add.reduceat(hit, first, dtype=np.intp))])
    columns, rows = x[hit].astype(np.intp), y[hit].astype(np.intp)
    for number, one, other, (begin, end), (some_hit, last_hit) in zip(
        some.tolist(),
        low.tolist(),
        high.tolist(),
        pairwise([*starts.tolist(), len(star)]),
        pairwise(returns.tolist()),
        strict=True,
    ):
        own = slice(some_hit, last_hit)
        fans[number] = Fan(one, other, star[begin:end], columns[own], rows[own])
    return fans


def _stars(
    beams: _Indices, x: FloatArray, y: FloatArray, laser: FloatArray, first: _Indices, gap: float
) -> tuple[NDArray[np.int32], _Indices]:
    """The stars of all scans and where each begins: at the laser before each new surface's ends."""
    begins = np.empty(len(x), dtype=np.bool_)
    begins[1:] = np.diff(beams) != 1
    begins[1:] |= np.diff(x) ** 2 + np.diff(y) ** 2 > gap * gap
    begins[first] = True
    opens = np.flatnonzero(begins)
    scan = np.searchsorted(first, opens, side="right") - 1
    star = np.empty((len(x) + len(opens), 2))
    lasers = opens + np.arange(len(opens))
    ends = np.ones(len(star), dtype=np.bool_)
    ends[lasers] = False
    star[ends], star[lasers] = np.column_stack([x, y]), laser[scan]
    # as OpenCV counts places, in cells from a corner: 1/16 from the middle of a cell
    corners = np.round((star - 0.5) * (1 << SUBPIXEL_BITS)).astype(np.int32)
    return corners, lasers[np.searchsorted(opens, first)]
