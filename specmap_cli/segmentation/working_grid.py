"""The grid that a map is divided on: cropped, in one orientation, in coarse cells.

One window and one orientation serve every copy of a map, wherever it lies and however it turns.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.grids.gridmap import BoolArray, cell_distances, window_of

_AROUND = np.ones((5, 5), dtype=np.uint8)  # wider than the rays of a laser far away, in cells


@dataclass(frozen=True, slots=True)
class Orientation:
    """The `window` of a grid that is looked at, and how many quarter turns it is turned by.

    So many empty rows and columns stand `before` what was turned.
    """

    window: tuple[slice, slice]
    turns: int
    before: tuple[int, int] = (0, 0)

    def apply(self, picture: NDArray[Any]) -> NDArray[Any]:
        """The window (h, w) of a picture (H, W), turned, with zeros before it."""
        rows, columns = self.before
        return np.pad(np.rot90(picture[self.window], self.turns), ((rows, 0), (columns, 0)))

    def undo(self, turned: NDArray[Any], picture: NDArray[Any]) -> NDArray[Any]:
        """A copy of `picture` (H, W) with `turned` (h, w) put back into the window."""
        whole = picture.copy()
        rows, columns = self.before
        whole[self.window] = np.rot90(turned[rows:, columns:], -self.turns)
        return whole

    def cells_in_grid(self, cells: NDArray[Any], shape: tuple[int, ...]) -> FloatArray:
        """Rows and columns (n, 2) in the grid of cells in the turned window of `shape` (h, w)."""
        cells = cells - np.array(self.before)
        shape = shape[0] - self.before[0], shape[1] - self.before[1]
        for _ in range(self.turns):
            height, width = shape
            cells = np.column_stack([cells[:, 1], height - 1 - cells[:, 0]])
            shape = (width, height)
        return np.asarray(cells + [side.start for side in self.window], dtype=np.float64)


def canonical(free: BoolArray, block: int = 1) -> Orientation:
    """The window of the free cells (H, W), turned by a multiple of 90 degrees.

    After the turn the free space is wider than it is high. Of the two such turns the one is taken
    by which its distribution is skewed to the upper right. Both are computed without rays that left
    through doors and windows, so that no single cell decides. For a symmetric map, the turn counts
    whose picture is smallest as bytes.
    """
    window = window_of(free)
    if window is None:
        return Orientation((slice(0, 0), slice(0, 0)), 0)
    shown = free[window]
    inner = cv2.erode(shown.astype(np.uint8), _AROUND, borderValue=0) > 0
    mass = inner if inner.any() else shown
    # second and third central moments along the rows and the columns, exact, times n^3
    spread, skew = [], []
    for counts in (mass.sum(axis=1).tolist(), mass.sum(axis=0).tolist()):
        total = sum(counts)
        first = sum(place * count for place, count in enumerate(counts))
        away = [total * place - first for place in range(len(counts))]
        spread.append(total * sum(n * far**2 for far, n in zip(away, counts, strict=True)))
        skew.append(sum(n * far**3 for far, n in zip(away, counts, strict=True)))
    (high, wide), (up, right) = spread, skew
    # a quarter turn counter-clockwise of the array: what was its columns, backwards, is its rows
    tall, leans = (high > wide, wide > high), (up + right, up - right, -up - right, right - up)
    pictures = [np.rot90(shown, turns) for turns in range(4)]
    keys = [
        (tall[turns % 2], -leans[turns], picture.shape, picture.tobytes())
        for turns, picture in enumerate(pictures)
    ]
    turns = keys.index(min(keys))
    middle = np.argwhere(np.rot90(mass, turns)).mean(axis=0).astype(int).tolist()
    return Orientation(window, turns, (-middle[0] % block, -middle[1] % block))


@dataclass(frozen=True, slots=True)
class WorkingGrid:
    """Coarse free space (h, w): cells of `step` x `step` fine ones, `cell_m` wide.

    `clearance` (h, w) is the distance, in coarse cells, from the centre of a free cell to that of
    the nearest one that is not.
    """

    clearance: FloatArray
    cell_m: float
    step: int

    @property
    def free(self) -> BoolArray:
        """Coarse cells of which every fine cell is free (h, w)."""
        return np.asarray(self.clearance > 0.0)


def working_grid(free: BoolArray, resolution: float, cell_m: float) -> WorkingGrid:
    """Reduce `free` (H, W) to cells of about `cell_m`: coarse cells are free when wholly free."""
    step = max(1, round(cell_m / resolution))
    height, width = (-(-side // step) for side in free.shape)
    framed = np.zeros((height + 2, width + 2), dtype=np.uint8)
    if step == 1:
        framed[1:-1, 1:-1] = free
    else:
        padded = np.zeros((height * step, width * step), dtype=bool)
        padded[: free.shape[0], : free.shape[1]] = free
        framed[1:-1, 1:-1] = padded.reshape(height, step, width, step).all(axis=(1, 3))
    pixels = cell_distances(framed)[1:-1, 1:-1]
    return WorkingGrid(pixels, step * resolution, step)
