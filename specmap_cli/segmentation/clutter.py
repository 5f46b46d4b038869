"""The working grid of a segmentation: free space without isolated obstacles, in coarse cells."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.settings import SegmentationConfig
from specmap_cli.grids.gridmap import BoolArray, cell_distances

# Solid furniture is thicker than this across: walls are thinner than tables.
FURNITURE_THICK_M = 0.4
_SLACK = 1e-9  # sizes that are equal on paper stay equal in floating point
_SLIT_M = 0.15  # free space narrower than this, in a wall or between two pieces of one, is noise
_SOLID = 0.5  # share of its rectangle: furniture fills three quarters, corners of walls a third


def furniture(free: BoolArray, resolution: float, config: SegmentationConfig) -> BoolArray:
    """(H, W) the isolated obstacles that are no walls; `free` is (H, W), cells of `resolution`.

    A row of pieces with no more than slits between them is a wall when it is longer than any
    furniture: of a railing or a window front a laser sees dashes, here longer, there shorter than a
    chair. What is solid by itself stays furniture, whatever stands beside it.
    """
    sizes = np.array([config.obstacle_m, config.furniture_m, FURNITURE_THICK_M])
    largest, bulky, thick = (sizes / resolution).tolist()
    pieces = small_obstacles(free, largest)
    linked = _linked(pieces, resolution)
    rows = linked & ~small_obstacles(~linked, max(largest, bulky))
    return np.asarray(small_obstacles(free, largest, bulky, thick) & ~(pieces & rows))


def without_slits(free: BoolArray, resolution: float) -> BoolArray:
    """The free cells (H, W) that a free square as wide as a slit covers."""
    square = _slit_square(resolution)
    side = len(square)
    opened = cv2.morphologyEx(np.pad(free, side).astype(np.uint8), cv2.MORPH_OPEN, square)
    return np.asarray(opened[side:-side, side:-side] > 0)


def _linked(pieces: BoolArray, resolution: float) -> BoolArray:
    """Pieces (H, W) with the slits between them."""
    if not pieces.any():
        return pieces
    closed = cv2.morphologyEx(pieces.astype(np.uint8), cv2.MORPH_CLOSE, _slit_square(resolution))
    return np.asarray(closed > 0)


def _slit_square(resolution: float) -> NDArray[np.uint8]:
    """Ones (n, n), as wide as a slit; n is odd, so that it has a middle."""
    side = 2 * max(0, round(0.5 * (_SLIT_M / resolution - 1.0))) + 1
    return np.ones((side, side), dtype=np.uint8)


def small_obstacles(
    free: BoolArray, largest_cells: float, bulky_cells: float = 0.0, thick_cells: float = 0.0
) -> BoolArray:
    """(H, W) the isolated pieces of what is not free, up to a size; `free` is (H, W).

    A piece is small when no side of its bounding box is longer than `largest_cells`. Cells that
    touch by a side or a corner are one piece, and the outside of the grid is not free. Chairs,
    table legs and cells that no beam happened to cross are small pieces; walls are not. A piece up
    to `bulky_cells` is small, too, when it is solid and `thick_cells` across: tables and cupboards
    are, and pieces of a wall are thin or go round corners.
    """
    blocked = np.pad(~free, 1, constant_values=True).astype(np.uint8)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(blocked, connectivity=8)
    sides = np.maximum(stats[:, cv2.CC_STAT_WIDTH], stats[:, cv2.CC_STAT_HEIGHT])
    small = sides <= largest_cells + _SLACK
    outside = 0, int(labels[0, 0])  # free space, and what the outside is part of
    for piece in np.flatnonzero(~small & (sides <= bulky_cells + _SLACK)).tolist():
        small[piece] = piece not in outside and _is_solid(labels, stats[piece], piece, thick_cells)
    small[list(outside)] = False
    return np.asarray(small[labels[1:-1, 1:-1]])


def _is_solid(labels: NDArray[Any], about: NDArray[Any], piece: int, thick_cells: float) -> bool:
    """Whether a piece fills the narrowest rectangle around it, and that is thick enough.

    `about` are its `connectedComponentsWithStats`. Noise at its edges, or a hole in it, changes its
    area little.
    """
    x, y, width, height, area = about.tolist()
    rows, columns = np.nonzero(labels[y : y + height, x : x + width] == piece)
    _, sides, _ = cv2.minAreaRect(np.column_stack([columns, rows]).astype(np.float32))
    short, long = sorted(side + 1.0 for side in sides)  # from middle to middle of its cells
    return bool(short >= thick_cells - _SLACK and area >= _SOLID * short * long)


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

    def fine_cells(self, cells: NDArray[Any]) -> FloatArray:
        """Rows and columns (n, 2), fractional, of the middles of coarse cells on the fine grid."""
        return np.asarray((cells + 0.5) * self.step - 0.5, dtype=np.float64)

    def refine(self, values: NDArray[Any], shape: tuple[int, ...]) -> NDArray[Any]:
        """Coarse `values` (h, w) on the fine grid of `shape` (H, W)."""
        fine = np.repeat(np.repeat(values, self.step, axis=0), self.step, axis=1)
        return fine[: shape[0], : shape[1]]


def coarse_step(resolution: float, cell_m: float) -> int:
    """How many cells of a grid a coarse cell of about `cell_m` is wide."""
    return max(1, round(cell_m / resolution))


def working_grid(free: BoolArray, resolution: float, cell_m: float) -> WorkingGrid:
    """Reduce `free` (H, W) to cells of about `cell_m`: coarse cells are free when wholly free."""
    step = coarse_step(resolution, cell_m)
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
