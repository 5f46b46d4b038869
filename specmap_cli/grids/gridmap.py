"""The grid map: an immutable trinary picture of free, occupied and unknown cells.

Segmentation, recognition and the matcher work on it, and a map file is read into it. Cell
(row, column) covers [x0 + column r, x0 + (column + 1) r) x [y0 + row r, y0 + (row + 1) r): row 0
is the lowest y. Below are what a laser would measure in it, and where labelled regions of it touch.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.arrays import Packed, Window
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import BoolArray as BoolArray
from specmap_cli.core.records import IntArray

FREE, OCCUPIED, UNKNOWN = 0, 1, 2
NO_OBSTACLE_M = 1e3  # the distance to an obstacle where there is none: beyond any laser's range
CellArray = NDArray[np.uint8]
LengthArray = NDArray[np.floating[Any]]  # of cells float32: exact enough, and half the memory
_Value = TypeVar("_Value", bound=np.generic)

_RAYS_AT_ONCE = 1 << 16  # bounds the memory: some 10 MB
_CELLS_AT_ONCE = 1 << 20  # bounds the memory: of a whole map it would be a hundred times as much
_NEARLY = 1e-3  # cells: more than OpenCV errs by, less than from one distance to the next
_BORDER = 1e-6  # cells a ray steps past a border, to stand in the next cell
_TINY = 1e-12  # takes the place of a direction of 0, so that its borders are far away
_DIAGONAL = math.sqrt(2.0)  # cells between two points, each half a diagonal off its cell's centre


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
        return self.under(points, self.cells, UNKNOWN)

    def under(self, points: NDArray[Any], values: NDArray[_Value], outside: Any) -> NDArray[_Value]:
        """(N,) what `values` (H, W) of cells are under points (N, 2), `outside` off the grid."""
        cells = self.cells_of(points)
        inside = self.inside(cells)
        found = np.full(len(cells), outside, dtype=values.dtype)
        found[inside] = values[tuple(cells[inside].T)]
        return found

    def window(self, rows: slice, columns: slice) -> GridMap:
        """The part of the map in some rows and columns, both with a start and an end on the grid.

        Its cells are a copy, so that it does not keep the whole grid in memory.
        """
        x, y = self.origin
        corner = (x + columns.start * self.resolution, y + rows.start * self.resolution)
        return GridMap(self.cells[rows, columns].copy(), self.resolution, corner)

    def cropped(self, shown: BoolArray | None = None, frame: int = 0) -> GridMap:
        """The part of the map round the cells `shown` (H, W), by default those that are known.

        A `frame` of so many cells stays round it. Where nothing is shown the map stays as it is.
        """
        window = window_of(np.asarray(self.cells != UNKNOWN) if shown is None else shown)
        if window is None:
            return self
        sides = zip(window, self.cells.shape, strict=True)
        return self.window(
            *(slice(max(one.start - frame, 0), min(one.stop + frame, side)) for one, side in sides)
        )

    def near(self, points: FloatArray, reach_m: float) -> GridMap:
        """The part of the map within `reach_m` of the box round some points (n, 2 or more)."""
        shape = self.cells.shape
        return self.window(*slices_near(points, reach_m, self.origin, self.resolution, shape))

    def obstacle_distance(self) -> LengthArray:
        """(H, W) metres from a cell's centre to the nearest occupied one's.

        NO_OBSTACLE_M everywhere when no cell is occupied.
        """
        if not self.occupied.any():
            return np.full(self.cells.shape, NO_OBSTACLE_M, dtype=np.float32)
        return self._metres(cell_distances((self.cells != OCCUPIED).astype(np.uint8)))

    def clearance(self) -> LengthArray:
        """(H, W) metres from each free cell's centre to the nearest cell that is not free."""
        return self._metres(clearance_of(self.free))

    def _metres(self, cells: LengthArray) -> LengthArray:
        """The lengths (H, W), in place: what is a tie in double precision stays one."""
        return np.multiply(cells, self.resolution, cells, dtype=np.float64, casting="same_kind")


@dataclass(frozen=True, slots=True)
class PackedGrid:
    """A grid to be kept among hundreds: its cells (H, W) are packed."""

    cells: Packed
    resolution: float
    origin: tuple[float, float]

    @classmethod
    def of(cls, grid: GridMap) -> PackedGrid:
        """Pack a grid; `grid` gives it back."""
        return cls(Packed.of(grid.cells), grid.resolution, grid.origin)

    @property
    def grid(self) -> GridMap:
        """The grid that was packed."""
        return GridMap(self.cells.array, self.resolution, self.origin)


def slices_near(
    points: FloatArray,
    reach_m: float,
    origin: tuple[float, float],
    resolution: float,
    shape: tuple[int, ...],
) -> tuple[slice, slice]:
    """Rows and columns of a grid that lie within `reach_m` of the box round points (n, 2 or more).

    The grid is of `shape` and begins at `origin`; of rows or columns off it nothing is left.
    """
    low, high = points[:, :2].min(axis=0) - reach_m, points[:, :2].max(axis=0) + reach_m
    corners = np.floor((np.array([low, high]) - origin) / resolution).astype(np.intp)
    (left, bottom), (right, top) = np.clip(corners, 0, shape[::-1]).tolist()
    return slice(bottom, top), slice(left, right)


def window_of(mask: BoolArray) -> tuple[slice, slice] | None:
    """Rows and columns of a mask (H, W) from the first to the last with a set cell; None: none."""
    rows, columns = (np.flatnonzero(mask.any(axis=axis)).tolist() for axis in (1, 0))
    return (slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)) if rows else None


def cell_distances(picture: CellArray) -> LengthArray:
    """(H, W) distance, in cells, from each cell's centre to the nearest zero cell's.

    OpenCV's last digits depend on its threads and on where in memory the picture lies. Squares of
    distances between cells are whole numbers: rounded to these, they are the same in every run.
    """
    pixels = cv2.distanceTransform(picture, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    squares = np.square(pixels, out=np.asarray(pixels, dtype=np.float32))
    return np.sqrt(np.rint(squares, out=squares), out=squares)


def clearance_of(free: BoolArray) -> LengthArray:
    """(H, W) distance, in cells, from each free cell's centre to that of the nearest one not free.

    What lies off the grid is not free.
    """
    return cell_distances(np.pad(free.astype(np.uint8), 1))[1:-1, 1:-1]


def exact(distances: LengthArray) -> FloatArray:
    """(H, W) distances in cells, as `cell_distances` gives them, in double precision."""
    squares = np.square(distances, dtype=np.float64)
    return np.asarray(np.sqrt(np.rint(squares, out=squares), out=squares))


def joined(
    cells: BoolArray, seeds: BoolArray | tuple[NDArray[np.intp], ...], connectivity: int = 4
) -> BoolArray:
    """(H, W) parts of `cells`, over sides or 8 neighbours, that hold `seeds`: a mask or indices."""
    count, parts = cv2.connectedComponents(cells.view(np.uint8), connectivity=connectivity)
    held = np.zeros(count, dtype=np.bool_)
    held[parts[seeds]] = True
    held[0] = False  # what is no cell
    return looked_up(held, parts)


def looked_up(table: NDArray[_Value], numbers: NDArray[Any]) -> NDArray[_Value]:
    """(H, W, ...) the entry in a table (n, ...) of each of the `numbers` (H, W), some rows at once.

    All at once they would be copied to eight bytes each.
    """
    found = np.empty(numbers.shape + table.shape[1:], dtype=table.dtype)
    for rows in bands_of(numbers.shape):
        found[rows] = table[numbers[rows]]
    return found


def within(picture: CellArray, reach: float) -> BoolArray:
    """(H, W) the cells no farther than `reach` cells from a zero of a picture (H, W).

    Distances are looked at some rows at once, with the rows that have a say in them.
    """
    found, beyond = np.empty(picture.shape, dtype=np.bool_), math.ceil(reach) + 1
    for rows in bands_of(picture.shape, beyond):
        low = max(rows.start - beyond, 0)
        some = np.ascontiguousarray(picture[low : rows.stop + beyond])
        away = cv2.distanceTransform(some, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        found[rows] = away[rows.start - low : rows.stop - low] <= reach + _NEARLY
    return found


def bands_of(shape: tuple[int, ...], least: int = 1) -> Iterator[slice]:
    """The rows of a grid of some shape, a band after the other, each of `least` rows or more."""
    rows = max(least, _CELLS_AT_ONCE // max(shape[1], 1), 1)
    return (slice(first, min(first + rows, shape[0])) for first in range(0, shape[0], rows))


def nearest_values(values: NDArray[Any]) -> tuple[NDArray[Any], NDArray[np.float32]]:
    """Each cell's value (H, W), or that of the nearest non-zero cell where it is zero; how far.

    The distance (H, W) to that cell is in cells.
    """
    zero = (values == 0).astype(np.uint8)
    away, source = cv2.distanceTransformWithLabels(
        zero, cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    of_source = np.zeros(int(source.max(initial=0)) + 1, dtype=values.dtype)
    of_source[source[zero == 0]] = values[zero == 0]
    return looked_up(of_source, source), np.asarray(away, dtype=np.float32)


_CROSS = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
Piece = tuple[Window, BoolArray]  # rows and columns of a grid (H, W), and which cells (h, w) there


def flood(passable: BoolArray, markers: NDArray[Any], rooms: Iterable[Piece] = ()) -> NDArray[Any]:
    """(H, W) the marker that reaches each cell first, zero where none does.

    The `markers` (H, W), zero where there is none, grow by a ring of `passable` cells (H, W) at a
    time, over their sides; those on other cells stay. The largest that reaches a cell has it. In
    each of the `rooms` they do so before they go on.
    """
    around = np.pad(markers, 1)
    inside = around[1:-1, 1:-1]
    for window, own in rooms:
        inside[window][own] = flood(passable[window] & own, inside[window] * own)[own]
    framed = np.pad(passable, 1)
    marked = framed & (around > 0)
    framed &= ~marked
    ring = np.flatnonzero(cv2.dilate(framed.view(np.uint8), _CROSS).view(np.bool_) & marked)
    found, wide = around.ravel(), framed.shape[1]
    empty = framed.view(np.uint8).ravel()  # 1 is empty, 2 is reached by the ring that grows
    while len(ring):
        grown_to = []
        for step in (-wide, -1, 1, wide):  # one ring's cells on one side are all different
            beside = ring + step
            open_ = empty[beside]
            reached = open_ > 0
            cells = beside[reached]
            found[cells] = np.maximum(found[cells], found[ring[reached]])
            first = cells[open_[reached] == 1]
            empty[first] = 2
            grown_to.append(first)
        ring = np.concatenate(grown_to)
        empty[ring] = 0
    return inside


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
    (height, width), flat = distance.shape, distance.reshape(-1)
    limit = max_range / grid.resolution
    ranges = np.full(len(angles), np.inf)
    for first in range(0, len(angles), _RAYS_AT_ONCE):
        part = slice(first, first + _RAYS_AT_ONCE)
        starts = (np.asarray(origins[part], dtype=np.float64) - grid.origin) / grid.resolution
        x, y = starts.T  # in cells
        dx, dy = (
            np.where(np.abs(side) < _TINY, _TINY, side)
            for side in (np.cos(angles[part]), np.sin(angles[part]))
        )
        alive, travelled = first + np.arange(len(x)), np.zeros(len(x))
        while len(alive):
            column, row = np.floor(x), np.floor(y)
            on = (column >= 0) & (row >= 0) & (column < width) & (row < height)
            on &= travelled <= limit
            index = np.where(on, row * width + column, 0).astype(np.intp)
            room = flat[index] / grid.resolution
            stopped = on & (room <= 0.0)
            ranges[alive[stopped]] = travelled[stopped] * grid.resolution
            border = np.minimum((column + (dx > 0) - x) / dx, (row + (dy > 0) - y) / dy)
            # neither the ray nor the obstacle need be at the centre of its cell
            step = np.maximum(room - _DIAGONAL, border + _BORDER)
            on &= ~stopped
            alive, step, dx, dy = alive[on], step[on], dx[on], dy[on]
            x, y = x[on] + dx * step, y[on] + dy * step
            travelled = travelled[on] + step
    return ranges


@dataclass(frozen=True, slots=True)
class Contacts:
    """Pairs of cells that share a side and have different labels, none of them -1.

    `labels` (m, 2) of each pair, the smaller one first; `one` and `other` (m, 2) rows and columns
    of its cells. Cells above each other come first, then cells side by side, each in row order.
    """

    labels: IntArray
    one: IntArray
    other: IntArray


def contacts(labels: NDArray[np.signedinteger[Any]]) -> Contacts:
    """All contacts between regions of `labels` (H, W), where -1 is no region."""
    one, other = [np.zeros((0, 2), dtype=np.int64)], [np.zeros((0, 2), dtype=np.int64)]
    for down, right in ((1, 0), (0, 1)):
        for rows in bands_of((len(labels) - down, labels.shape[1])):
            here = labels[rows, : labels.shape[1] - right]
            there = labels[rows.start + down : rows.stop + down, right:]
            cells: NDArray[np.int64] = np.argwhere((here != there) & (here >= 0) & (there >= 0))
            one.append(cells + (rows.start, 0))
            other.append(cells + (rows.start + down, right))
    first, second = np.concatenate(one), np.concatenate(other)
    pairs = np.column_stack([labels[tuple(first.T)], labels[tuple(second.T)]])
    return Contacts(np.sort(pairs, axis=1).astype(np.int64), first, second)
