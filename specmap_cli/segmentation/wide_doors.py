"""Wide openings in the line of a wall, made as narrow as doors before a map is divided.

An office that stands open to a corridor for two metres, or a cubicle, sees its neighbour too well
for the visibility graph to tell them apart. But a person sees the line of the wall go on across the
opening. So an opening between walls that lie in one row or column of the grid, along which the
walls of a finished map lie, is narrowed from both sides to the width of a door: to the graph, and
to all that follows, it is one. One row does: holes that noise leaves in others are no harm. What
stands in that line and is thin, such as a post between two doors, is a part of the wall and no
furniture.
"""

from __future__ import annotations

import cv2
import numpy as np

from specmap_cli.core.records import IntArray
from specmap_cli.grids.gridmap import BoolArray

_DOOR_M = 0.8  # what is left of a wide opening; beside a post, none is wider than two doors
_SPACE_M = 0.9  # the least free space in front of a wall; posts are thinner
_WALL_M = 0.5  # the least length of a wall beside an opening; twice this is too thick for one
_LINE_M = 6.0  # the longest row of openings and posts between two walls


def with_narrow_doors(
    free: BoolArray, small: BoolArray, resolution: float, widest_m: float
) -> tuple[BoolArray, BoolArray]:
    """Free space (H, W) with its `small` obstacles; and the same with wide openings narrowed.

    Posts in the line of a wall are not among the obstacles that are taken out. Openings up to
    `widest_m` are narrowed.
    """
    framed, pieces = np.pad(free | small, 1), np.pad(small, 1)
    metres = widest_m, _DOOR_M, _SPACE_M, _WALL_M, _LINE_M
    lengths = [max(1, round(length / resolution)) for length in metres]
    rows = _along_rows(framed, pieces, *lengths)
    columns = _along_rows(framed.T, pieces.T, *lengths)
    jambs, posts = ((one | other.T)[1:-1, 1:-1] for one, other in zip(rows, columns, strict=True))
    opened = free | (small & ~posts)
    return opened, opened & ~jambs


def _along_rows(
    free: BoolArray, small: BoolArray, widest: int, door: int, space: int, wall: int, line: int
) -> tuple[BoolArray, BoolArray]:
    """What narrows the openings (H, W) of walls along the rows, and the posts (H, W) in them.

    The edge of `free` is a wall. On one side of an opening a thin wall points at it, with open
    space on both faces. On the other side is a wall with open space on one face at least: a corner
    does, or a partition that ends where the line of the wall is. Half of the opening is open to
    both sides: beside a cupboard that stands at a wall the wall itself goes on, and nobody comes
    through. Posts divide an opening into several, none of which is wider than two doors.
    """
    cells, pieces = (np.ascontiguousarray(mask, dtype=np.uint8) for mask in (free, small))
    across = np.ones((space // 2 * 2 + 1, 1), dtype=np.uint8)  # odd: it has a middle
    through = cv2.erode(cells, across)
    room = cv2.dilate(through, across)
    column, jamb = np.ones((wall + 1, 1), dtype=np.uint8), np.ones((1, wall), dtype=np.uint8)
    one, other = ((cv2.dilate(room, column, anchor=(0, at)) > cells) for at in (0, wall))
    thin = (one & other).astype(np.uint8)
    before, after = (cv2.erode(thin, jamb, anchor=(at, 0)) > 0 for at in (wall - 1, 0))
    # from wall to wall, past what small things stand there
    row, start, end = _stretches(free)
    ends, crossed = one | other, through.cumsum(axis=1, dtype=np.int64)
    good = (before[row, start] & ends[row, end]) | (after[row, end] & ends[row, start])
    good &= 2 * (crossed[row, end] - crossed[row, start]) >= end - start - 1
    good &= end - start - 1 <= line
    row, start, end = row[good], start[good], end[good]
    # the openings between posts; one that is too wide spoils the line
    posts = pieces > cv2.morphologyEx(pieces, cv2.MORPH_OPEN, across)
    place, left, right = _stretches(_painted(free.shape, row, start, end) & ~posts)
    of = np.searchsorted(row * free.shape[1] + start, place * free.shape[1] + left, "right") - 1
    most = np.where(np.bincount(of, minlength=len(row)) > 1, min(widest, 2 * door), widest)
    good = np.ones(len(row), dtype=np.bool_)
    good[of[right - left - 1 > most[of]]] = False
    lines = _painted(free.shape, row[good], start[good], end[good])
    cut = np.maximum(right - left - 1 - door, 0) // 2  # from both ends, to leave a door
    doors = _painted(free.shape, place, left + cut, right - cut)
    return lines & ~posts & ~doors, lines & posts


def _stretches(mask: BoolArray) -> tuple[IntArray, IntArray, IntArray]:
    """(n,) row, cell before and cell after of each stretch of set cells in the rows of `mask`."""
    steps = np.diff(mask.astype(np.int8), axis=1)
    row, start = np.nonzero(steps > 0)
    return row, start, np.nonzero(steps < 0)[1] + 1


def _painted(shape: tuple[int, ...], row: IntArray, start: IntArray, end: IntArray) -> BoolArray:
    """(H, W) the cells of stretches that are told as `_stretches` tells them."""
    steps = np.zeros(shape, dtype=np.int8)
    steps[row, start + 1] = 1
    steps[row, end] = -1
    return np.asarray(steps.cumsum(axis=1) > 0)
