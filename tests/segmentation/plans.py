"""Floor plans drawn in code, turned, and whether two divisions are one."""

import cv2
import numpy as np

from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, BoolArray, GridMap
from specmap_cli.segmentation.visibility import LabelArray


def same_parts(one: LabelArray, other: LabelArray) -> bool:
    """Equal labels up to their names, unlabelled cells included."""
    pairs = np.unique(np.stack([one.ravel(), other.ravel()]), axis=1)
    return (
        one.shape == other.shape
        and len(np.unique(pairs[0])) == pairs.shape[1] == len(np.unique(pairs[1]))
        and bool(((one < 0) == (other < 0)).all())
    )


def plan(width_m: float, height_m: float, *open_boxes: tuple[float, ...]) -> GridMap:
    """A solid block with boxes (x0, y0, x1, y1) carved out of it; 0.05 m a cell."""
    cells = np.full((round(height_m / 0.05), round(width_m / 0.05)), OCCUPIED, dtype=np.uint8)
    for x0, y0, x1, y1 in open_boxes:
        rows = slice(round(y0 / 0.05), round(y1 / 0.05))
        cells[rows, round(x0 / 0.05) : round(x1 / 0.05)] = FREE
    return GridMap(cells, 0.05)


def turned_by(degrees: float, grid: GridMap) -> GridMap:
    """A map turned about its middle, sampled anew; unknown where it was not."""
    height, width = grid.cells.shape
    side = int(np.hypot(height, width)) + 20
    move = np.array(cv2.getRotationMatrix2D((width / 2, height / 2), degrees, 1.0), np.float64)
    move[:, 2] += side / 2 - np.array([width / 2, height / 2])
    nearest, beyond = cv2.INTER_NEAREST, (float(UNKNOWN),)
    cells = cv2.warpAffine(grid.cells, move, (side, side), flags=nearest, borderValue=beyond)
    return GridMap(np.asarray(cells, dtype=np.uint8), grid.resolution)


def dumbbell() -> BoolArray:
    """Rooms of 30 x 30 and 30 x 40 cells, joined by a passage of 6 x 9."""
    free = np.zeros((40, 90), dtype=bool)
    free[5:35, 5:35] = free[5:35, 41:81] = free[15:24, 35:41] = True
    return free


def cluttered(seed: int) -> BoolArray:
    """A room of 56 x 66 cells with twelve boxes in it."""
    free = np.zeros((60, 70), dtype=bool)
    free[2:-2, 2:-2] = True
    rng = np.random.default_rng(seed)
    for row, column in rng.integers(4, 50, (12, 2)):
        free[row : row + rng.integers(1, 9), column : column + rng.integers(1, 9)] = False
    return free


# rooms of 5 x 4 and 4 x 4 m, a wall of 0.2 m, a door of 0.9 m
TWO_ROOMS = plan(9.8, 4.6, (0.3, 0.3, 5.3, 4.3), (5.5, 0.3, 9.5, 4.3), (5.3, 1.5, 5.5, 2.4))

# three rooms of different sizes on either side of a corridor
OFFICE = plan(
    *(15.0, 10.4, (0.3, 4.7, 14.6, 6.3)),
    *((0.3, 0.3, 4.3, 4.5), (4.5, 0.3, 9.3, 4.5), (9.5, 0.3, 14.6, 4.5)),
    *((0.3, 6.5, 5.3, 10.0), (5.5, 6.5, 9.0, 10.0), (9.2, 6.5, 14.6, 10.0)),
    *((x, 4.5, x + 0.9, 4.7) for x in (1.5, 6.0, 12.0)),
    *((x, 6.3, x + 0.9, 6.5) for x in (2.5, 7.0, 10.0)),
)
