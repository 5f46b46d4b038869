"""What is kept of a submap's grid for matching it against others: walls, free space, fields."""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.sampling import evenly
from specmap_cli.grids.gridmap import OCCUPIED, UNKNOWN, GridMap
from specmap_cli.grids.matching import ScoreField

COARSE_M = 0.2
FIELD_SIGMA_M = 0.15
WIDE_SIGMA_M = 0.3
KNOWN_MARGIN_M = 0.15
_MOST_POINTS = 1200

ImageArray = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Place:
    """One submap's grid prepared for matching, in the grid's frame.

    `walls` (N, 2) points of the occupied cells; `direction` of its walls in [0, pi / 2) rad;
    `wall_distance` and `depth` (H, W) metres to the nearest wall and to the nearest cell that is
    not free, `known` (H, W), of cells of `resolution` from `origin`; `coarse_walls` and
    `coarse_free` (N, 2) points 0.2 m apart; `target` and `obstacles` the coarse images that
    other places' walls and free space are correlated with, from `coarse_origin`.
    """

    walls: FloatArray
    direction: float
    field: ScoreField
    wide: ScoreField
    wall_distance: ImageArray
    depth: ImageArray
    known: NDArray[np.bool_]
    resolution: float
    origin: tuple[float, float]
    coarse_walls: FloatArray
    coarse_free: FloatArray
    target: ImageArray
    obstacles: ImageArray
    coarse_origin: tuple[float, float]


def prepare(grid: GridMap) -> Place | None:
    """The grid prepared for matching; None when it shows too little of a wall."""
    grid = cropped(grid)
    occupied = np.argwhere(grid.occupied)
    if len(occupied) < 10:
        return None
    kept = evenly(occupied, _MOST_POINTS)
    margin = np.uint8(max(1, round(KNOWN_MARGIN_M / grid.resolution)))
    seen = (grid.cells != UNKNOWN).astype(np.uint8)
    known = cv2.dilate(seen, np.ones((2 * margin + 1, 2 * margin + 1), dtype=np.uint8))
    walls, free, target = _coarse(grid)
    return Place(
        walls=grid.centres_of(kept),
        direction=wall_direction(grid),
        field=ScoreField.from_grid(grid, FIELD_SIGMA_M),
        wide=ScoreField.from_grid(grid, WIDE_SIGMA_M),
        wall_distance=_distance((grid.cells != OCCUPIED), grid.resolution),
        depth=_distance(grid.free, grid.resolution),
        known=np.asarray(known > 0),
        resolution=grid.resolution,
        origin=grid.origin,
        coarse_walls=_coarse_points(walls, grid.origin),
        coarse_free=_coarse_points(free, grid.origin),
        target=target,
        obstacles=walls.astype(np.float32),
        coarse_origin=grid.origin,
    )


class Places:
    """Grids prepared for matching by id, the `most` last used of them at a time."""

    def __init__(self, most: int) -> None:
        self.most = most
        self._prepared: OrderedDict[int, Place | None] = OrderedDict()

    def of(self, id_: int, grid: GridMap) -> Place | None:
        """The prepared grid of one id, which is always the same."""
        if id_ not in self._prepared:
            self._prepared[id_] = prepare(grid)
            if len(self._prepared) > self.most:
                self._prepared.popitem(last=False)
        self._prepared.move_to_end(id_)
        return self._prepared[id_]


def wall_direction(grid: GridMap) -> float:
    """The direction of the walls, modulo a right angle, in [0, pi / 2) rad.

    From the gradient of the blurred picture of the obstacles: four times its angle is the same for
    a wall, its back and the walls across.
    """
    picture = cv2.GaussianBlur(grid.occupied.astype(np.float32), (0, 0), 2.0)
    dx = cv2.Sobel(picture, cv2.CV_32F, 1, 0)
    dy = cv2.Sobel(picture, cv2.CV_32F, 0, 1)
    gradient = dx + 1j * dy
    square = gradient * gradient
    total = complex((square * square / (np.abs(square) + 1e-9)).sum(dtype=np.complex128))
    return (math.atan2(total.imag, total.real) / 4.0) % (math.pi / 2.0)


def cropped(grid: GridMap) -> GridMap:
    """The grid cut down to its known cells."""
    seen = grid.cells != UNKNOWN
    rows, columns = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
    if not len(rows):
        return grid
    r, c = int(rows[0]), int(columns[0])
    origin = (grid.origin[0] + c * grid.resolution, grid.origin[1] + r * grid.resolution)
    cells = grid.cells[r : int(rows[-1]) + 1, c : int(columns[-1]) + 1].copy()
    return GridMap(cells, grid.resolution, origin)


def _distance(inside: NDArray[np.bool_], resolution: float) -> ImageArray:
    """(H, W) metres from each cell inside to the nearest outside; 1 km when there is none."""
    if inside.all():
        return np.full(inside.shape, 1e3, dtype=np.float32)
    cells = cv2.distanceTransform(inside.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5)
    return np.asarray(cells * np.float32(resolution), dtype=np.float32)


def _coarse(grid: GridMap) -> tuple[NDArray[np.bool_], NDArray[np.bool_], ImageArray]:
    """Walls and free space on cells of 0.2 m, and the image that walls of others should fall on:
    1 on a wall, -0.5 in free space.
    """
    factor = max(1, round(COARSE_M / grid.resolution))
    height, width = grid.cells.shape
    padded = np.pad(
        grid.cells, ((0, -height % factor), (0, -width % factor)), constant_values=UNKNOWN
    )
    blocks = padded.reshape(padded.shape[0] // factor, factor, -1, factor)
    walls = (blocks == OCCUPIED).any(axis=(1, 3))
    free = (blocks == 0).mean(axis=(1, 3)) > 0.5
    free &= ~walls
    near = cv2.GaussianBlur(walls.astype(np.float32), (3, 3), 1.0)
    near /= max(float(near.max()), 1e-6)
    target = np.where(walls, np.maximum(near, 0.6), near) - 0.5 * free
    return walls, free, target.astype(np.float32)


def _coarse_points(picture: NDArray[np.bool_], origin: tuple[float, float]) -> FloatArray:
    """(N, 2) x and y of the centres of coarse cells."""
    rows, columns = np.nonzero(picture)
    centres = (np.column_stack([columns, rows]) + 0.5) * COARSE_M
    return np.asarray(centres + np.asarray(origin), dtype=np.float64)
