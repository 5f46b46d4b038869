"""Wide openings in the line of a wall, made as narrow as doors before a map is divided.

An office that stands open to a corridor for two metres, or a cubicle, sees its neighbour too well
for the visibility graph to tell them apart. But a person sees the line of the wall go on across the
opening. So an opening between walls that lie in one row or column of the grid, along which the
walls of a finished map lie, is narrowed from both sides to the width of a door: to the graph, and
to all that follows, it is one. One row does: holes that noise leaves in others are no harm.
"""

from __future__ import annotations

import cv2
import numpy as np

from specmap_cli.grids.gridmap import BoolArray

_DOOR_M = 0.9  # what is left of a wide opening; and the least free space in front of a wall
_DEEP_M = 0.3  # from this space into a wall
_JAMB_M = 0.5  # the least length of a wall that points at an opening


def with_narrow_doors(
    free: BoolArray, small: BoolArray, resolution: float, widest_m: float
) -> tuple[BoolArray, BoolArray]:
    """Free space (H, W) with its `small` obstacles; and the same with wide openings narrowed.

    Openings up to `widest_m` are narrowed.
    """
    opened = free | small
    framed = np.pad(opened, 1)
    metres = widest_m, _DOOR_M, _DEEP_M, _JAMB_M
    lengths = [max(1, round(length / resolution)) for length in metres]
    jambs = _along_rows(framed, *lengths) | _along_rows(framed.T, *lengths).T
    return opened, opened & ~jambs[1:-1, 1:-1]


def _along_rows(free: BoolArray, widest: int, door: int, deep: int, jamb: int) -> BoolArray:
    """What narrows the openings (H, W) of walls along the rows; the edge of `free` is a wall.

    On one side of an opening a thin wall points at it, with open space on both faces. On the other
    side is a wall with open space on one face at least: a corner does, or a partition that ends
    where the line of the wall is. Half of the opening is open to both sides: beside a cupboard that
    stands at a wall the wall itself goes on, and nobody comes through.
    """
    cells = np.ascontiguousarray(free, dtype=np.uint8)
    across = np.ones((door // 2 * 2 + 1, 1), dtype=np.uint8)  # odd: it has a middle
    through = cv2.erode(cells, across)
    room = cv2.dilate(through, across)
    column, line = np.ones((deep + 1, 1), dtype=np.uint8), np.ones((1, jamb), dtype=np.uint8)
    one, other = ((cv2.dilate(room, column, anchor=(0, at)) > cells) for at in (0, deep))
    thin = (one & other).astype(np.uint8)
    before, after = (cv2.erode(thin, line, anchor=(at, 0)) > 0 for at in (jamb - 1, 0))
    # openings: the last cell of the wall before each, and the first of the wall after it
    steps = np.diff(cells.astype(np.int8), axis=1)
    row, start = np.nonzero(steps > 0)
    end = np.nonzero(steps < 0)[1] + 1
    width, ends, crossed = end - start - 1, one | other, through.cumsum(axis=1, dtype=np.int64)
    good = (before[row, start] & ends[row, end]) | (after[row, end] & ends[row, start])
    good &= 2 * (crossed[row, end] - crossed[row, start]) >= width
    good &= (width > door) & (width <= widest)
    row, start, end, cut = row[good], start[good], end[good], (width[good] - door) // 2
    # what is taken from both ends of an opening, to leave a door
    changes = np.zeros(free.shape, dtype=np.int8)
    for place, change in ((start, 1), (start + cut, -1), (end - cut - 1, 1), (end - 1, -1)):
        changes[row, place + 1] += change
    return np.asarray(changes.cumsum(axis=1) > 0)
