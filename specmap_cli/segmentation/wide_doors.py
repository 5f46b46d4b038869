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

import cv2
import numpy as np

from specmap_cli.grids.gridmap import BoolArray
from specmap_cli.segmentation.clutter import without_slits
from specmap_cli.segmentation.kmeans import LabelArray
from specmap_cli.segmentation.runs import Runs
from specmap_cli.segmentation.wall_ends import EndLengths, between_ends

_DOOR_M = 0.9  # what is left of a wide opening
_LINE_M = 6.0  # the longest row of openings and posts between two walls
_BETWEEN_POSTS_M = 1.6  # the widest opening of such a row
_POST_M, _POST_THICK_M = 0.15, 0.75  # the least length of a post, in line, and the most across
_PANEL_M, _SLENDER = 0.5, 2  # a post this long, and so many times longer than thick, is a wall


@dataclass(frozen=True, slots=True)
class _Widths:
    """Of openings and posts, in cells; `widest` is an opening without posts."""

    widest: int
    door: int
    line: int
    between_posts: int
    post: int
    post_thick: int
    panel: int

    @classmethod
    def at(cls, resolution: float, widest_m: float) -> _Widths:
        lengths = (widest_m, _DOOR_M, _LINE_M, _BETWEEN_POSTS_M, _POST_M, _POST_THICK_M, _PANEL_M)
        return cls(*(max(1, round(length / resolution)) for length in lengths))


def with_narrow_doors(
    free: BoolArray, small: BoolArray, resolution: float, widest_m: float
) -> tuple[BoolArray, BoolArray]:
    """Free space (H, W) with its `small` obstacles; and the same with wide openings narrowed.

    Posts in the line of a wall are not among the obstacles that are taken out. Openings up to
    `widest_m` are narrowed.
    """
    ends, widths = EndLengths.at(resolution), _Widths.at(resolution, widest_m)
    margin = max(ends.straight, ends.jamb + ends.frame)  # so that ends may lie at the edge
    even = np.pad(without_slits(free | small, resolution), margin)
    pieces = np.pad(small, margin) & even
    framed = even & ~pieces
    inner = np.s_[margin : margin + free.shape[0], margin : margin + free.shape[1]]
    rows = _along_rows(framed, pieces, ends, widths)
    columns = _along_rows(
        np.ascontiguousarray(framed.T), np.ascontiguousarray(pieces.T), ends, widths
    )
    jambs, posts = (one | other.T for one, other in zip(rows, columns, strict=True))
    opened = free | (small & ~posts[inner])
    return opened, opened & ~jambs[inner]


def _along_rows(
    free: BoolArray, small: BoolArray, ends: EndLengths, widths: _Widths
) -> tuple[BoolArray, BoolArray]:
    """What narrows the openings (H, W) of walls along the rows, and the posts (H, W) in them."""
    opened = free | small
    _, piece = cv2.connectedComponents(small.astype(np.uint8), connectivity=8)
    posts, panels = _posts(small, widths)
    lines = Runs.of(opened)  # from wall to wall, past what small things stand there
    inside = (lines.first >= ends.straight) & (lines.last < free.shape[1] - ends.straight)
    lines = lines.those(inside & (lines.lengths <= widths.line))
    lines = lines.those(between_ends(opened, lines, panels, ends))
    doors, kept = _openings(lines, posts > 0, widths)
    in_line = kept.painted(free.shape, np.ones(len(kept.row), dtype=np.bool_))
    standing = np.zeros(int(piece.max(initial=0)) + 1, dtype=np.bool_)
    standing[piece[in_line & (posts > 0)]] = True
    return _jambs(doors, widths.door, free.shape), standing[piece]


def _posts(small: BoolArray, widths: _Widths) -> tuple[LabelArray, BoolArray]:
    """The number (H, W) of the part of a small piece that is thin across the rows; the panels.

    It is 0 where there is none. The wall from which another one goes off has two such parts.
    """
    across_rows = Runs.of(small.T)
    thin = across_rows.painted(small.T.shape, across_rows.lengths <= widths.post_thick).T
    count, part, stats, _ = cv2.connectedComponentsWithStats(thin.astype(np.uint8), connectivity=8)
    along, across = stats[:, cv2.CC_STAT_WIDTH], stats[:, cv2.CC_STAT_HEIGHT]
    post = (along >= widths.post) & (across <= widths.post_thick)
    post[0] = False
    panel = post & (along >= widths.panel) & (along >= _SLENDER * across)
    names = np.where(post, np.arange(count), 0).astype(np.int32)
    return names[part], np.asarray(panel[part])


def _openings(lines: Runs, posts: BoolArray, widths: _Widths) -> tuple[Runs, Runs]:
    """The openings between the `posts` (H, W) of some lines, and the lines they are of.

    Lines with an opening that is too wide are left out with all of theirs.
    """
    number = lines.painted(posts.shape, np.arange(1, len(lines.row) + 1))
    gaps = Runs.of((number > 0) & ~posts)
    of = number[gaps.row, gaps.first] - 1
    several = np.bincount(of, minlength=len(lines.row)) > 1
    widest = np.where(several, widths.between_posts, widths.widest)
    good = np.ones(len(lines.row), dtype=np.bool_)
    good[of[gaps.lengths > widest[of]]] = False
    return gaps.those(good[of]), lines.those(good)


def _jambs(doors: Runs, door: int, shape: tuple[int, ...]) -> BoolArray:
    """(H, W) what is to be taken from both ends of each opening to leave a `door` of cells."""
    cut = np.maximum(doors.lengths - door, 0) // 2
    every = np.ones(len(cut), dtype=np.bool_)
    one = Runs(doors.row, doors.first, doors.first + cut - 1).painted(shape, every)
    return np.asarray(one | Runs(doors.row, doors.last - cut + 1, doors.last).painted(shape, every))
