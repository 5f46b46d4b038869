"""Where walls along the rows of a grid end, and what a gap between two such ends is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from specmap_cli.core.records import IntArray
from specmap_cli.grids.gridmap import BoolArray
from specmap_cli.segmentation.runs import Runs

_THICKEST_M = 0.5  # a wall
_OPEN_M = 1.1  # free space in front of a wall: more than the width of a door
_JAMB_M = 0.25  # the least length of a wall beside an opening
_FRAME_M = 0.1  # at its end a frame may stand out
_STRAIGHT_M = 0.4  # length on which a face has to be straight: no slanted wall is
_CORNER_M = 0.1  # length of a face that makes a corner
_UNEVEN = 2  # cells by which a straight face may stray: noise


@dataclass(frozen=True, slots=True)
class EndLengths:
    """What the end of a wall is told by, in cells."""

    thickest: int
    open_space: int
    jamb: int
    frame: int
    straight: int
    corner: int

    @classmethod
    def at(cls, resolution: float) -> EndLengths:
        """The lengths in cells of a grid."""
        lengths = (_THICKEST_M, _OPEN_M, _JAMB_M, _FRAME_M, _STRAIGHT_M, _CORNER_M)
        return cls(*(max(1, round(length / resolution)) for length in lengths))


@dataclass(frozen=True, slots=True)
class _Face:
    """One face of what is not free: `behind` (H, W) the cells that are no deeper than a wall.

    `row` (H, W) is the row of the face in the column of each of them.
    """

    behind: BoolArray
    row: IntArray


def between_ends(free: BoolArray, gaps: Runs, panels: BoolArray, lengths: EndLengths) -> BoolArray:
    """(n,) whether `gaps` in the rows of `free` (H, W) lie in the line of a wall.

    On one side of the gap a thin wall points at it, with open space on both faces, one of them
    straight. On the other side is the end of a wall, or at least a corner, with the same face: a
    partition that ends where the line of the wall is. Corners on both sides do when one of the
    `panels` (H, W), pieces of wall that touch no other, stands in the gap. Half of the gap is open
    to both sides.
    """
    thin, faces = _faces(free, lengths)
    pointing = _pointing(thin, gaps, lengths)
    sums = _sums(panels)
    panel = sums[gaps.row, gaps.last + 1] > sums[gaps.row, gaps.first]
    crossed = _crossed(free, gaps, lengths)
    found = np.zeros(len(gaps.row), dtype=np.bool_)
    for face in faces:
        before, after = (
            count == lengths.corner for count in _beside(face.behind, gaps, lengths.corner)
        )
        one, other = _straight(face, gaps, lengths.straight)
        jambs = (pointing[0] & one & after) | (pointing[1] & other & before)
        found |= jambs | (panel & before & after)
    return found & crossed


def _crossed(free: BoolArray, gaps: Runs, lengths: EndLengths) -> BoolArray:
    """(n,) whether half of each gap or more has open space before and behind it.

    Beside a cupboard that stands at a wall the wall itself goes on, and nobody comes through.
    """
    columns, shape = Runs.of(free.T), free.T.shape
    row = np.arange(free.shape[0])[:, None]
    before = row - columns.painted(shape, columns.first).T
    behind = columns.painted(shape, columns.last).T - row
    sums = _sums(free & (np.minimum(before, behind) >= lengths.open_space // 2))
    share = sums[gaps.row, gaps.last + 1] - sums[gaps.row, gaps.first]
    return np.asarray(2 * share >= gaps.lengths)


def _faces(free: BoolArray, lengths: EndLengths) -> tuple[BoolArray, tuple[_Face, _Face]]:
    """The cells (H, W) of thin walls with open space on both sides; both faces of all walls."""
    shape = free.T.shape
    walls, spaces = Runs.of(~free.T), Runs.of(free.T)
    depth = np.pad(spaces.painted(shape, spaces.lengths), ((0, 0), (1, 1)))
    low = depth[walls.row, walls.first] >= lengths.open_space
    high = depth[walls.row, walls.last + 2] >= lengths.open_space
    thin = walls.painted(shape, low & high & (walls.lengths <= lengths.thickest))
    near_low = np.minimum(walls.last, walls.first + lengths.thickest - 1)
    near_high = np.maximum(walls.first, walls.last - lengths.thickest + 1)
    faces = (
        _Face(Runs(walls.row, walls.first, near_low).painted(shape, low).T, _rows(walls, shape)),
        _Face(
            Runs(walls.row, near_high, walls.last).painted(shape, high).T,
            walls.painted(shape, walls.last).T,
        ),
    )
    return thin.T, faces


def _rows(walls: Runs, shape: tuple[int, ...]) -> IntArray:
    """The first cell of each wall of a turned picture, in the picture itself (H, W)."""
    return np.asarray(walls.painted(shape, walls.first).T, dtype=np.int64)


def _sums(mask: BoolArray) -> IntArray:
    """(H, W + 1) the number of set cells before each column."""
    return np.pad(np.cumsum(mask, axis=1), ((0, 0), (1, 0)))


def _beside(mask: BoolArray, gaps: Runs, reach: int) -> tuple[IntArray, IntArray]:
    """(n,) the number of set cells among the `reach` before each gap, and after it."""
    sums = _sums(mask)
    before = sums[gaps.row, gaps.first] - sums[gaps.row, gaps.first - reach]
    after = sums[gaps.row, gaps.last + 1 + reach] - sums[gaps.row, gaps.last + 1]
    return before, after


def _pointing(thin: BoolArray, gaps: Runs, lengths: EndLengths) -> tuple[BoolArray, BoolArray]:
    """(n,) whether a thin wall, unbroken for a jamb, begins no farther than a frame off each end.

    Without a break: a leaf that stands open behind the wall that a corridor runs along is none.
    """
    before = after = np.zeros(len(gaps.row), dtype=np.bool_)
    for off in range(lengths.frame + 1):
        wider = Runs(gaps.row, gaps.first - off, gaps.last + off)
        one, other = _beside(thin, wider, lengths.jamb)
        before, after = before | (one == lengths.jamb), after | (other == lengths.jamb)
    return before, after


def _straight(face: _Face, gaps: Runs, reach: int) -> tuple[BoolArray, BoolArray]:
    """(n,) whether the face of what is before each gap, and after it, is straight for `reach`."""
    whole = _beside(face.behind, gaps, reach)
    starts = gaps.first - reach, gaps.last + 1
    along = np.arange(reach)
    even = [
        np.ptp(face.row[gaps.row[:, None], start[:, None] + along], axis=1) <= _UNEVEN
        for start in starts
    ]
    return (whole[0] == reach) & even[0], (whole[1] == reach) & even[1]
