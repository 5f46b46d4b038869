"""Wide openings between walls in line, made as narrow as doors before a map is divided.

An office that stands open to a corridor for two metres, or a cubicle, sees its neighbour too well
for the visibility graph to tell them apart. But a person sees the line of the wall go on across the
opening. So an opening between walls that lie in one row or column of the grid, along which the
walls of a finished map lie, is narrowed from both sides to the width of a door: to the graph, and
to all that follows, it is one. What stands in that line and is thin, such as a post between two
doors, is a part of the wall and no furniture. Walls are told without the slits and holes that the
noise of a laser leaves in them: these would tip what is an end, and what is thin or straight.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.records import IntArray
from specmap_cli.grids.gridmap import BoolArray
from specmap_cli.segmentation.furniture import without_slits

_DOOR_M = 0.9  # what is left of a wide opening
_LINE_M = 6.0  # the longest row of openings and posts between two walls
_BETWEEN_POSTS_M = 1.6  # the widest opening of such a row
_POST_M, _POST_THICK_M = 0.15, 0.75  # the least length of a post, in line, and the most across
_PANEL_M, _SLENDER = 0.5, 2  # a post this long, and so many times longer than thick, is a wall

_THICKEST_M = 0.5  # a wall
_OPEN_M = 1.1  # free space in front of a wall: more than the width of a door
_JAMB_M = 0.25  # the least length of a wall beside an opening
_FRAME_M = 0.1  # at its end a frame may stand out
_STRAIGHT_M = 0.4  # length on which a face has to be straight: no slanted wall is
_CORNER_M = 0.1  # length of a face that makes a corner
_UNEVEN = 2  # cells by which a straight face may stray: noise


_Face = tuple[BoolArray, IntArray]


@dataclass(frozen=True, slots=True)
class _Lengths:
    """Of openings, posts and the ends of walls, in cells; `widest` is an opening without posts."""

    widest: int
    door: int
    line: int
    between_posts: int
    post: int
    post_thick: int
    panel: int
    thickest: int
    open_space: int
    jamb: int
    frame: int
    straight: int
    corner: int


def with_narrow_doors(
    free: BoolArray, small: BoolArray, resolution: float, widest_m: float
) -> tuple[BoolArray, BoolArray]:
    """Free space (H, W) with its `small` obstacles; and the same with wide openings narrowed.

    Posts in the line of a wall are not among the obstacles that are taken out. Openings up to
    `widest_m` are narrowed.
    """
    openings = (widest_m, _DOOR_M, _LINE_M, _BETWEEN_POSTS_M, _POST_M, _POST_THICK_M, _PANEL_M)
    ends = (_THICKEST_M, _OPEN_M, _JAMB_M, _FRAME_M, _STRAIGHT_M, _CORNER_M)
    lengths = _Lengths(*(max(1, round(length / resolution)) for length in (*openings, *ends)))
    margin = max(lengths.straight, lengths.jamb + lengths.frame)  # so that ends may lie at the edge
    even = np.pad(without_slits(free | small, resolution), margin)
    pieces = np.pad(small, margin) & even
    framed = even & ~pieces
    inner = np.s_[margin : margin + free.shape[0], margin : margin + free.shape[1]]
    rows = _along_rows(framed, pieces, lengths)
    turned = np.ascontiguousarray(framed.T), np.ascontiguousarray(pieces.T)
    columns = _along_rows(*turned, lengths)
    jambs, posts = (one | other.T for one, other in zip(rows, columns, strict=True))
    opened = free | (small & ~posts[inner])
    return opened, opened & ~jambs[inner]


def _along_rows(
    free: BoolArray, small: BoolArray, lengths: _Lengths
) -> tuple[BoolArray, BoolArray]:
    """What narrows the openings (H, W) of walls along the rows, and the posts (H, W) in them."""
    opened = free | small
    # parts of small pieces that are thin across the rows: posts; some are panels. The wall from
    # which another one goes off has two such parts
    across_rows = Runs.of(small.T)
    thin = across_rows.painted(small.T.shape, across_rows.lengths <= lengths.post_thick).T
    _, part, stats, _ = cv2.connectedComponentsWithStats(thin.astype(np.uint8), connectivity=8)
    along, across = stats[:, cv2.CC_STAT_WIDTH], stats[:, cv2.CC_STAT_HEIGHT]
    post = (along >= lengths.post) & (across <= lengths.post_thick)
    post[0] = False
    panel = post & (along >= lengths.panel) & (along >= _SLENDER * across)
    posts, panels = post[part], panel[part]
    # lines: from wall to wall, past what small things stand there
    lines = Runs.of(opened)
    inside = (lines.first >= lengths.straight) & (lines.last < free.shape[1] - lengths.straight)
    lines = lines.those(inside & (lines.lengths <= lengths.line))
    lines = lines.those(_between_ends(opened, lines, panels, lengths))
    # their openings, between posts; a line with one that is too wide is left out with all of its
    number = lines.painted(free.shape, np.arange(1, len(lines.row) + 1))
    doors = Runs.of((number > 0) & ~posts)
    of = number[doors.row, doors.first] - 1
    several = np.bincount(of, minlength=len(lines.row)) > 1
    widest = np.where(several, lengths.between_posts, lengths.widest)
    good = np.ones(len(lines.row), dtype=np.bool_)
    good[of[doors.lengths > widest[of]]] = False
    doors, lines = doors.those(good[of]), lines.those(good)
    # what is taken from both ends of an opening, to leave a door
    cut = np.maximum(doors.lengths - lengths.door, 0) // 2
    jambs = Runs(doors.row, doors.first, doors.first + cut - 1).mask(free.shape)
    jambs |= Runs(doors.row, doors.last - cut + 1, doors.last).mask(free.shape)
    _, piece = cv2.connectedComponents(small.astype(np.uint8), connectivity=8)
    standing = np.zeros(int(piece.max(initial=0)) + 1, dtype=np.bool_)
    standing[piece[lines.mask(free.shape) & posts]] = True
    return jambs, standing[piece]


def _between_ends(free: BoolArray, gaps: Runs, panels: BoolArray, lengths: _Lengths) -> BoolArray:
    """(n,) whether `gaps` in the rows of `free` (H, W) lie in the line of a wall.

    On one side of the gap a thin wall points at it, with open space on both faces, one of them
    straight. On the other side is the end of a wall, or at least a corner, with the same face: a
    partition that ends where the line of the wall is. Corners on both sides do when one of the
    `panels` (H, W), pieces of wall that touch no other, stands in the gap. Half of the gap is open
    to both sides.
    """
    thin, faces = _faces(free, lengths)
    # a wall points at the gap when it begins no farther than a frame off its end, and goes on
    # without a break: a leaf that stands open behind the wall that a corridor runs along does not
    from_before = from_after = np.zeros(len(gaps.row), dtype=np.bool_)
    for off in range(lengths.frame + 1):
        wider = Runs(gaps.row, gaps.first - off, gaps.last + off)
        one, other = _beside(thin, wider, lengths.jamb)
        from_before = from_before | (one == lengths.jamb)
        from_after = from_after | (other == lengths.jamb)
    panel = gaps.counts(panels) > 0
    reach, along = lengths.straight, np.arange(lengths.straight)
    found = np.zeros(len(gaps.row), dtype=np.bool_)
    for behind, row in faces:
        before, after = (count == lengths.corner for count in _beside(behind, gaps, lengths.corner))
        straight_before, straight_after = (
            (whole == reach)
            & (np.ptp(row[gaps.row[:, None], start[:, None] + along], axis=1) <= _UNEVEN)
            for whole, start in zip(
                _beside(behind, gaps, reach), (gaps.first - reach, gaps.last + 1), strict=True
            )
        )
        jambs = (from_before & straight_before & after) | (from_after & straight_after & before)
        found |= jambs | (panel & before & after)
    # beside a cupboard that stands at a wall the wall itself goes on, and nobody comes through
    columns, shape = Runs.of(free.T), free.T.shape
    here = np.arange(free.shape[0])[:, None]
    above = here - columns.painted(shape, columns.first).T
    below = columns.painted(shape, columns.last).T - here
    crossed = gaps.counts(free & (np.minimum(above, below) >= lengths.open_space // 2))
    return np.asarray(found & (2 * crossed >= gaps.lengths))


def _faces(free: BoolArray, lengths: _Lengths) -> tuple[BoolArray, tuple[_Face, _Face]]:
    """The cells (H, W) of thin walls with open space on both sides; both faces of all walls.

    Of a face: the cells (H, W) behind it that are no deeper than a wall, and (H, W) its row in the
    column of each of them.
    """
    shape = free.T.shape
    walls, spaces = Runs.of(~free.T), Runs.of(free.T)
    depth = np.pad(spaces.painted(shape, spaces.lengths), ((0, 0), (1, 1)))
    low = depth[walls.row, walls.first] >= lengths.open_space
    high = depth[walls.row, walls.last + 2] >= lengths.open_space
    thin = walls.painted(shape, low & high & (walls.lengths <= lengths.thickest))
    near_low = np.minimum(walls.last, walls.first + lengths.thickest - 1)
    near_high = np.maximum(walls.first, walls.last - lengths.thickest + 1)
    near, far = Runs(walls.row, walls.first, near_low), Runs(walls.row, near_high, walls.last)
    faces = (
        (near.painted(shape, low).T, walls.painted(shape, walls.first).T),
        (far.painted(shape, high).T, walls.painted(shape, walls.last).T),
    )
    return thin.T, faces


def _beside(mask: BoolArray, gaps: Runs, reach: int) -> tuple[IntArray, IntArray]:
    """(n,) the number of set cells among the `reach` before each gap, and after it."""
    before = Runs(gaps.row, gaps.first - reach, gaps.first - 1)
    return before.counts(mask), Runs(gaps.row, gaps.last + 1, gaps.last + reach).counts(mask)


@dataclass(frozen=True, slots=True)
class Runs:
    """Stretches of the rows of a grid: (n,) their `row`, their `first` and their `last` column."""

    row: IntArray
    first: IntArray
    last: IntArray

    @classmethod
    def of(cls, mask: BoolArray) -> Runs:
        """The longest stretches of set cells of a `mask` (H, W), row by row."""
        steps = np.diff(np.pad(mask, ((0, 0), (1, 1))).astype(np.int8), axis=1)
        row, first = np.nonzero(steps > 0)
        return cls(row, first, np.nonzero(steps < 0)[1] - 1)

    @property
    def lengths(self) -> IntArray:
        """(n,) their numbers of cells."""
        return self.last - self.first + 1

    def those(self, chosen: BoolArray) -> Runs:
        """The runs that are `chosen` (n,)."""
        return Runs(self.row[chosen], self.first[chosen], self.last[chosen])

    def counts(self, mask: BoolArray) -> IntArray:
        """(n,) how many of their cells are set in a `mask` (H, W)."""
        before = np.pad(np.cumsum(mask, axis=1), ((0, 0), (1, 0)))
        return np.asarray(before[self.row, self.last + 1] - before[self.row, self.first])

    def mask(self, shape: tuple[int, ...]) -> BoolArray:
        """(H, W) their cells."""
        return np.asarray(self.painted(shape, np.ones(len(self.row), dtype=np.bool_)))

    def painted(self, shape: tuple[int, ...], values: NDArray[Any]) -> NDArray[Any]:
        """A picture (H, W) with the value (n,) of each run on its cells, and zeros elsewhere.

        Runs without a cell are left out.
        """
        picture = np.zeros(shape, dtype=values.dtype)
        lengths = np.maximum(self.lengths, 0)
        run = np.repeat(np.arange(len(lengths)), lengths)
        along = np.arange(len(run)) - np.repeat(np.cumsum(lengths) - lengths, lengths)
        picture[self.row[run], self.first[run] + along] = values[run]
        return picture
