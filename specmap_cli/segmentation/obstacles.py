"""What stands in a map before it is divided: furniture, and walls that go on across wide openings.

An isolated obstacle up to a size is taken out of the free space. Furniture at a wall is no isolated
obstacle, but thicker than a wall and smaller than what is outside of the building: its cells take
the label of the room it stands in.

An office that stands open to a corridor for two metres, or a cubicle, sees its neighbour too well
for the visibility graph to tell them apart. But a person sees the line of the wall go on across the
opening. So an opening between walls that lie in one row or column of the grid, along which the
walls of a finished map lie, is narrowed from both sides to the width of a door: to the graph, and
to all that follows, it is one. One row does: holes that noise leaves in others are no harm.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.records import IntArray
from specmap_cli.core.settings import SegmentationConfig
from specmap_cli.grids.gridmap import UNKNOWN, BoolArray, GridMap, looked_up, within
from specmap_cli.segmentation.visibility import LabelArray

# Solid furniture is thicker than this across: walls are thinner than tables.
FURNITURE_THICK_M = 0.4
_SLACK = 1e-9  # sizes that are equal on paper stay equal in floating point
_SLIT_M = 0.15  # free space narrower than this between two pieces of a wall is noise
_SOLID = 0.5  # share of its rectangle: furniture fills three quarters, corners of walls a third

_LONGEST_M = 4.0  # a row of cupboards; larger is what was never seen, and thick walls
_REACH_M = 0.2  # from a piece to the labelled cells of its room

_DOOR_M = 0.8  # what is left of a wide opening; beside a post, none is wider than two doors
_SPACE_M = 0.9  # the least free space in front of a wall; posts are thinner
_WALL_M = 0.5  # the least length of a wall beside an opening; twice this is too thick for one
_ROWS = 256  # looked at in one go: bounds the memory
_LINE_M = 6.0  # the longest row of openings and posts between two walls


def furniture(free: BoolArray, resolution: float, config: SegmentationConfig) -> BoolArray:
    """(H, W) the isolated obstacles that are no walls; `free` is (H, W), cells of `resolution`.

    A row of pieces with no more than slits between them is a wall when it is longer than any
    furniture: of a railing or a window front a laser sees dashes, here longer, there shorter than a
    chair. What is solid by itself stays furniture, whatever stands beside it.
    """
    sizes = np.array([config.obstacle_m, config.furniture_m, FURNITURE_THICK_M])
    largest, bulky, thick = (sizes / resolution).tolist()
    pieces = small_obstacles(free, largest)
    found = small_obstacles(free, largest, bulky, thick)
    if not pieces.any():
        return found
    side = 2 * max(0, round(0.5 * (_SLIT_M / resolution - 1.0))) + 1  # odd: it has a middle
    square = np.ones((side, side), dtype=np.uint8)
    linked = cv2.morphologyEx(pieces.astype(np.uint8), cv2.MORPH_CLOSE, square) > 0
    rows = linked & ~small_obstacles(~linked, max(largest, bulky))
    return np.asarray(found & ~(pieces & rows))


def small_obstacles(
    free: BoolArray, largest_cells: float, bulky_cells: float = 0.0, thick_cells: float = 0.0
) -> BoolArray:
    """(H, W) the isolated pieces of what is not free, up to a size; `free` is (H, W).

    A piece is small when no side of its bounding box is longer than `largest_cells`. Cells that
    touch by a side or a corner are one piece, and the outside of the grid is not free. Chairs,
    table legs and cells that no beam happened to cross are small pieces; walls are not. A piece up
    to `bulky_cells` is small, too, when it is solid and `thick_cells` across: tables and cupboards
    are, and pieces of a wall are thin or go round corners. Solid is what fills the narrowest
    rectangle around it: noise at its edges, or a hole in it, changes its area little.
    """
    blocked = np.pad(~free, 1, constant_values=True).astype(np.uint8)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(blocked, connectivity=8)
    sides = np.maximum(stats[:, cv2.CC_STAT_WIDTH], stats[:, cv2.CC_STAT_HEIGHT])
    small = sides <= largest_cells + _SLACK
    outside = 0, int(labels[0, 0])  # free space, and what the outside is part of
    for piece in np.flatnonzero(~small & (sides <= bulky_cells + _SLACK)).tolist():
        if piece in outside:
            continue
        x, y, width, height, area = stats[piece].tolist()
        rows, columns = np.nonzero(labels[y : y + height, x : x + width] == piece)
        _, about, _ = cv2.minAreaRect(np.column_stack([columns, rows]).astype(np.float32))
        short, long = sorted(side + 1.0 for side in about)  # from middle to middle of its cells
        small[piece] = short >= thick_cells - _SLACK and area >= _SOLID * short * long
    small[list(outside)] = False
    return np.asarray(small[labels[1:-1, 1:-1]])


def pieces_at_walls(grid: GridMap, thick_m: float) -> NDArray[np.int32]:
    """The number (H, W) of each piece at a wall that is `thick_m` or more, 0 where there is none.

    What is outside of the building is none: what is unknown and large, and all at the map's edge.
    """
    nowhere = np.zeros(grid.cells.shape, dtype=np.int32)
    radius = (round(thick_m / grid.resolution) - 1) // 2
    if radius < 1:  # of so few cells it could be a wall
        return nowhere
    framed = np.pad(grid.cells, 1, constant_values=UNKNOWN) == UNKNOWN
    piece, large = _pieces(framed, grid.resolution)
    large[piece[0, 0]] = True  # joined to what is beyond the map
    outside = (looked_up(large, piece) & framed)[1:-1, 1:-1]
    del piece, framed
    # cells that a disc covers which is so wide and fits in
    blocked = np.pad(~grid.free & ~outside, radius + 1)
    away = within(blocked.view(np.uint8), radius)  # from the middle of such a disc
    if away.all():
        return nowhere
    covered = within(away.view(np.uint8), radius)
    thick = covered[radius + 1 : -radius - 1, radius + 1 : -radius - 1]
    del blocked, outside, away
    pieces, large = _pieces(thick, grid.resolution)
    for edge in (pieces[0], pieces[-1], pieces[:, 0], pieces[:, -1]):
        large[edge] = True
    pieces[looked_up(large, pieces) | ~thick] = 0
    return pieces


def fill_cupboards(labels: LabelArray, pieces: NDArray[np.int32], resolution: float) -> LabelArray:
    """`labels` (H, W) with those of the `pieces` (H, W) at walls, which had none.

    A piece takes the label that more than half of the labelled cells around it have.
    """
    if not pieces.any():
        return labels
    # exact: there are fewer than 16 million
    kind = np.uint16 if pieces.max() < 1 << 16 else np.float32
    grown: NDArray[Any] = pieces.astype(kind)
    for _ in range(round(_REACH_M / resolution)):
        np.copyto(grown, cv2.dilate(grown, np.ones((3, 3), np.uint8)), where=pieces == 0)
    ring = (grown > 0) & (labels >= 0)
    around, own = grown[ring].astype(np.intp), labels[ring]
    votes = np.zeros((int(pieces.max()) + 1, int(labels.max(initial=0)) + 1), dtype=np.int64)
    np.add.at(votes, (around, own), 1)
    sure = 2 * votes.max(axis=1) > votes.sum(axis=1)
    best = np.where(sure, votes.argmax(axis=1), -1).astype(np.int16)
    return np.where((pieces > 0) & (labels < 0), looked_up(best, pieces), labels)


def _pieces(mask: BoolArray, resolution: float) -> tuple[NDArray[np.int32], BoolArray]:
    """The number (H, W) of each piece of a mask, over edges, 0 outside; which (k,) are long."""
    _, piece, stats, _ = cv2.connectedComponentsWithStats(mask.view(np.uint8), connectivity=4)
    longest = stats[:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]].max(axis=1)
    return np.asarray(piece, dtype=np.int32), np.asarray(longest * resolution > _LONGEST_M)


def with_narrow_doors(
    free: BoolArray, small: BoolArray, resolution: float, widest_m: float
) -> tuple[BoolArray, BoolArray]:
    """Free space (H, W) with its `small` obstacles; and the same with wide openings narrowed.

    What stands in the line of a wall and is thin, such as a post between two doors, is a part of
    the wall and no furniture. Openings up to `widest_m` are narrowed.
    """
    framed, pieces = np.pad(free | small, 1), np.pad(small, 1)
    metres = widest_m, _DOOR_M, _SPACE_M, _WALL_M, _LINE_M
    lengths = [max(1, round(length / resolution)) for length in metres]
    jambs, posts = np.zeros_like(framed), np.zeros_like(framed)
    reach = sum(lengths[2:4]) + 1  # rows that have a say in what a row is
    rows, columns = (framed, pieces, jambs, posts), (framed.T, pieces.T, jambs.T, posts.T)
    for cells, things, *found in (rows, columns):
        for first in range(0, len(cells), _ROWS):
            low, end = max(0, first - reach), first + _ROWS
            some, own = slice(low, end + reach), slice(first - low, end - low)
            made = _along_rows(cells[some], things[some], *lengths)
            for mask, new in zip(found, made, strict=True):
                mask[first:end] |= new[own]
    opened = free | (small & ~posts[1:-1, 1:-1])
    return opened, opened & ~jambs[1:-1, 1:-1]


def _along_rows(
    free: BoolArray, small: BoolArray, widest: int, door: int, space: int, wall: int, line: int
) -> tuple[BoolArray, BoolArray]:
    """What narrows the openings (H, W) of walls along the rows, and the posts (H, W) in them.

    On one side of an opening a thin wall points at it, with open space on both faces; on the other
    one face is enough, as at a corner. Half of the opening is open to both sides: beside a cupboard
    the wall goes on. Posts divide it into openings, none wider than two doors.
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
