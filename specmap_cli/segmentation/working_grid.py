"""The grid that a map is divided on: cropped, upright, in coarse cells.

One window and one orientation serve every copy of a map, wherever it lies and however it turns: the
walls of the building run along its rows and columns.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.grids.gridmap import (
    FREE,
    OCCUPIED,
    UNKNOWN,
    BoolArray,
    CellArray,
    GridMap,
    window_of,
)

_AROUND = np.ones((5, 5), dtype=np.uint8)  # wider than the rays of a laser far away, in cells
_FRAME = 3  # coarse cells round the free space: walls stand there
_STEPS_DEGREES = (1.0, 0.1)  # between the directions that are looked at, first and last
_SLIGHT_DEGREES = 1.5  # walls that lean no more are as good as upright: cells stay as they are
_LARGEST = 20_000  # cells a side; a larger map stays as it lies: OpenCV counts to 32,767

_Value = TypeVar("_Value", bound=np.generic)


@dataclass(frozen=True, slots=True)
class UprightMap:
    """A map as it is divided, and the way back.

    `grid` has coarse cells of `step` x `step` fine ones, and nodes stand in blocks of `block` x
    `block` of these. The `window` of the map was turned by so many quarter `turns`, so many rows
    and columns put `before` it, and what came of it, of `shape` in coarse cells, was turned by
    `tilt` (2, 3), an affine transform of OpenCV; None: not.
    """

    grid: GridMap
    block: int
    window: tuple[slice, slice]
    turns: int
    before: tuple[int, int]
    step: int
    shape: tuple[int, int]
    tilt: FloatArray | None

    def cells_in(self, fine: GridMap, values: NDArray[_Value], elsewhere: int) -> NDArray[_Value]:
        """(H, W) the `values` (h, w) of the coarse cells on those of the `fine` map."""
        if self.tilt is not None:
            back, size = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP, self.shape[::-1]
            turned = cv2.warpAffine(
                values.astype(np.float32), self.tilt, size, flags=back, borderValue=(elsewhere,)
            )
            values = turned.astype(values.dtype)
        rows, columns = self.before
        high, wide = fine.cells[self.window].shape[:: -1 if self.turns % 2 else 1]
        spread = np.repeat(np.repeat(values, self.step, axis=0), self.step, axis=1)
        spread = spread[rows : rows + high, columns : columns + wide]
        whole = np.full(fine.cells.shape, elsewhere, dtype=values.dtype)
        whole[self.window] = np.rot90(spread, -self.turns)
        return whole

    def places(self, fine: GridMap, cells: NDArray[Any]) -> FloatArray:
        """x and y (n, 2) in the map of rows and columns (n, 2) of coarse cells."""
        upright = np.asarray(cells, dtype=np.float64)
        if self.tilt is not None:
            back = cv2.invertAffineTransform(self.tilt)
            upright = (upright[:, ::-1] @ back[:, :2].T + back[:, 2])[:, ::-1]
        found = (upright + 0.5) * self.step - 0.5 - np.array(self.before)
        height, width = fine.cells[self.window].shape[:: -1 if self.turns % 2 else 1]
        for _ in range(self.turns):
            found = np.column_stack([found[:, 1], height - 1 - found[:, 0]])
            height, width = width, height
        return fine.centres_of(found + [side.start for side in self.window])


def upright_map(fine: GridMap, cell_m: float, node_step_m: float) -> UprightMap:
    """The window of the free cells of a map, upright, in cells of about `cell_m`.

    First it is turned by a multiple of 90 degrees. After that the free space is wider than it is
    high. Of the two such turns the one is taken by which its distribution is skewed to the upper
    right. Both are computed without rays that left through doors and windows, so that no single
    cell decides. For a symmetric map, the turn counts whose picture is smallest as bytes. Then it
    is turned by less than 45 degrees, so that most of its walls lie along rows and columns. The
    middle of its free space is the corner of a block of about `node_step_m`.
    """
    step = max(1, round(cell_m / fine.resolution))
    block = max(1, round(node_step_m / (step * fine.resolution)))
    window = window_of(fine.free)
    if window is None:
        nothing = slice(0, 0), slice(0, 0)
        return UprightMap(fine.window(*nothing), block, nothing, 0, (0, 0), 1, (0, 0), None)
    shown = fine.free[window]
    inner = cv2.erode(shown.astype(np.uint8), _AROUND, borderValue=0) > 0
    mass = inner if inner.any() else shown
    frame = _FRAME * step
    around = tuple(slice(side.start, side.stop + 2 * frame) for side in window)
    framed = np.pad(fine.cells, frame, constant_values=UNKNOWN)[around]
    pictures = {turns: np.rot90(framed, turns) for turns in _turns(mass)}
    turns = min(pictures, key=lambda one: (pictures[one].shape, pictures[one].tobytes()))
    along = (np.rot90(mass, turns).sum(axis=axis) for axis in (1, 0))
    middle = frame + np.array([n @ np.arange(len(n)) // n.sum() for n in along])
    low = (-middle % (step * block)).tolist()
    # what is solid up to the frame goes on beyond it, and is no furniture
    cells = np.pad(pictures[turns], ((low[0], 0), (low[1], 0)), constant_values=OCCUPIED)
    coarse = reduced(cells, step)
    tilted, tilt = _along_walls(coarse, (middle + low) // step, block)
    grid = GridMap(tilted, step * fine.resolution)
    before, shape = (low[0] + frame, low[1] + frame), (coarse.shape[0], coarse.shape[1])
    return UprightMap(grid, block, window, turns, before, step, shape, tilt)


def _turns(mass: BoolArray) -> list[int]:
    """The quarter turns that make a mass (H, W) wide and lean up and right, by exact moments."""
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
    ways = [(tall[turns % 2], -leans[turns]) for turns in range(4)]
    return [turns for turns in range(4) if ways[turns] == min(ways)]


def reduced(cells: CellArray, step: int) -> CellArray:
    """Cells of `step` x `step` of some (H, W): occupied where one is, free where half of them are.

    The rest is unknown. So no wall is lost, and no gap between two rays counts.
    """
    if step == 1:
        return cells
    height, width = cells.shape
    whole = ((0, -height % step), (0, -width % step))
    blocks = np.pad(cells, whole, constant_values=UNKNOWN)
    blocks = blocks.reshape(-(-height // step), step, -(-width // step), step)
    free = 2 * np.count_nonzero(blocks == FREE, axis=(1, 3)) >= step**2
    occupied = (blocks == OCCUPIED).any(axis=(1, 3))
    return np.where(occupied, OCCUPIED, np.where(free, FREE, UNKNOWN)).astype(np.uint8)


def _along_walls(
    cells: CellArray, corner: NDArray[np.intp], block: int
) -> tuple[CellArray, FloatArray | None]:
    """Cells (h, w), turned about `corner` so that walls lie along rows; the transform, or None."""
    around = np.ones((2 * _FRAME + 1, 2 * _FRAME + 1), dtype=np.uint8)
    beside = cv2.dilate((cells == FREE).astype(np.uint8), around) > 0  # no depths of solid blocks
    angle = wall_angle(np.argwhere(beside & (cells == OCCUPIED)))
    if abs(angle) <= _SLIGHT_DEGREES or max(cells.shape) > _LARGEST:
        return cells, None
    rows, columns = corner.tolist()
    tilt = np.asarray(cv2.getRotationMatrix2D((columns, rows), angle, 1.0), dtype=np.float64)
    ends = np.argwhere(cells == FREE)[:, ::-1] @ tilt[:, :2].T + tilt[:, 2]
    low, high = ends.min(axis=0) - _FRAME, ends.max(axis=0) + _FRAME + 1
    low = corner[::-1] - block * np.ceil((corner[::-1] - low) / block)
    tilt[:, 2] -= low
    size = np.ceil(high - low).astype(int).tolist()
    turned = cv2.warpAffine(cells, tilt, size, flags=cv2.INTER_NEAREST, borderValue=(OCCUPIED,))
    return np.asarray(turned, dtype=np.uint8), tilt


def wall_angle(walls: NDArray[np.intp]) -> float:
    """Degrees in [-45, 45) to turn a picture by, so that `walls` (n, 2) are in the fewest lines.

    The sum of the squares of what each row and column holds is the largest; of equals the least
    turn.
    """
    best, most = 0.0, -1
    for step, reach in zip(_STEPS_DEGREES, (45.0, _STEPS_DEGREES[0]), strict=True):
        for degrees in sorted(best + np.arange(-reach, reach, step), key=abs):
            cosine, sine = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
            held = 0
            for way in ((cosine, -sine), (sine, cosine)):  # rows and columns after the turn
                line = np.floor(walls @ np.array(way)).astype(np.intp)
                held += int((np.bincount(line - line.min(initial=0)) ** 2).sum())
            if held > most:
                best, most = float(degrees), held
    return (best + 45.0) % 90.0 - 45.0
