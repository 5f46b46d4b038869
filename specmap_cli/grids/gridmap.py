"""The grid map: an immutable trinary picture of free, occupied and unknown cells.

Segmentation, recognition and the matcher work on it, and a map file is read into it. Cell
(row, column) covers [x0 + column r, x0 + (column + 1) r) x [y0 + row r, y0 + (row + 1) r): row 0
is the lowest y.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import BoolArray as BoolArray

FREE, OCCUPIED, UNKNOWN = 0, 1, 2
NO_OBSTACLE_M = 1e3  # the distance to an obstacle where there is none: beyond any laser's range
CellArray = NDArray[np.uint8]


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

    def window(self, rows: slice, columns: slice) -> GridMap:
        """The part of the map in some rows and columns, both with a start and an end on the grid.

        Its cells are a copy, so that it does not keep the whole grid in memory.
        """
        x, y = self.origin
        left, low = int(columns.start), int(rows.start)
        corner = (x + left * self.resolution, y + low * self.resolution)
        return GridMap(self.cells[rows, columns].copy(), self.resolution, corner)

    def near(self, points: FloatArray, reach_m: float) -> GridMap:
        """The part of the map within `reach_m` of the box round some points (n, 2 or more)."""
        shape = self.cells.shape
        return self.window(*slices_near(points, reach_m, self.origin, self.resolution, shape))

    def obstacle_distance(self) -> FloatArray:
        """(H, W) metres from a cell's centre to the nearest occupied one's.

        NO_OBSTACLE_M everywhere when no cell is occupied.
        """
        if not self.occupied.any():
            return np.full(self.cells.shape, NO_OBSTACLE_M)
        return cell_distances((self.cells != OCCUPIED).astype(np.uint8)) * self.resolution

    def clearance(self) -> FloatArray:
        """(H, W) metres from each free cell's centre to the nearest cell that is not free."""
        padded = np.pad(self.free.astype(np.uint8), 1)
        return cell_distances(padded)[1:-1, 1:-1] * self.resolution


@dataclass(frozen=True, slots=True)
class PackedGrid:
    """A grid to be kept among hundreds: its cells (H, W) in a twentieth of their memory."""

    packed: bytes
    shape: tuple[int, int]
    resolution: float
    origin: tuple[float, float]

    @classmethod
    def of(cls, grid: GridMap) -> PackedGrid:
        """Pack a grid; `grid` gives it back."""
        height, width = grid.cells.shape
        packed = zlib.compress(grid.cells.tobytes(), level=1)
        return cls(packed, (height, width), grid.resolution, grid.origin)

    @property
    def grid(self) -> GridMap:
        """The grid that was packed."""
        cells = np.frombuffer(zlib.decompress(self.packed), dtype=np.uint8).reshape(self.shape)
        return GridMap(cells, self.resolution, self.origin)


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


def cell_distances(picture: CellArray) -> FloatArray:
    """(H, W) distance, in cells, from each cell's centre to the nearest zero cell's.

    OpenCV's last digits depend on its threads and on where in memory the picture lies. Squares of
    distances between cells are whole numbers: rounded to these, they are the same in every run.
    """
    pixels = cv2.distanceTransform(picture, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    squares = np.rint(np.square(pixels, dtype=np.float64))
    return np.asarray(np.sqrt(squares), dtype=np.float64)
