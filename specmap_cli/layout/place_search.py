"""Where points fit in a map, from coarse to fine: branch and bound on maxima of a score field.

Hess et al., "Real-Time Loop Closure in 2D LIDAR SLAM" (ICRA 2016), section V: level h of the
pyramid holds, at each cell, the largest value of the field in the 2^h x 2^h cells that begin there.
Points summed on it are never below their score at any of the shifts the cell stands for, so that
whole blocks of shifts are ruled out at once. Scores are sums of bytes: exact, and the same on any
processor.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray, Pose2, wrap_angle
from specmap_cli.core.records import IntArray
from specmap_cli.grids.matching import Match, ScoreField

_TOP = 3  # level the search begins on: blocks of 8 cells, wide rooms still rule them out
_FULL = 255  # of a byte: a cell whose score is 1
_AT_ONCE = 2_000_000  # lookups in one go: some 16 MB
_BEAM = 64  # blocks followed down to a first good place, whose score prunes the others


@dataclass(frozen=True, slots=True, kw_only=True)
class Pyramid:
    """Maxima of a score field: `levels[h]` (H, W) in bytes, over 2^h x 2^h cells from each cell.

    Noughts surround the field on `border` cells. `corner` (2,) is where the cells begin, metres.
    """

    levels: tuple[NDArray[np.uint8], ...]
    border: int
    corner: FloatArray
    cell_m: float

    @property
    def reach_m(self) -> float:
        """Points this far from their middle stay on the noughts around the field."""
        return float((self.border - 2**_TOP - 1) * self.cell_m)

    @classmethod
    def of(cls, field: ScoreField, reach_m: float) -> Pyramid:
        """The pyramid of a field, for points within `reach_m` of their origin."""
        border = math.ceil(reach_m / field.resolution) + 2**_TOP + 1
        cells = np.pad(np.round(field.values * _FULL).astype(np.uint8), border)
        levels = [cells]
        for level in range(_TOP):
            levels.append(_maxima(levels[-1], 2**level))
        return cls(
            levels=tuple(levels),
            border=border,
            corner=np.asarray(field.origin) - border * field.resolution,
            cell_m=field.resolution,
        )

    def blocks(self) -> IntArray:
        """(B, 2) columns and rows of the blocks of the top level that cover the field."""
        height, width = self.levels[0].shape
        side = 2**_TOP
        columns = np.arange(self.border, width - self.border, side)
        rows = np.arange(self.border, height - self.border, side)
        x, y = np.meshgrid(columns, rows)
        return np.column_stack([x.ravel(), y.ravel()]).astype(np.int64)

    def centres_of(self, blocks: IntArray) -> FloatArray:
        """(B, 2) metres of the middles of blocks of the top level."""
        return np.asarray(self.corner + (blocks + 0.5 * 2**_TOP) * self.cell_m, dtype=np.float64)


@dataclass(frozen=True, slots=True, kw_only=True)
class Places:
    """Places (L, 4) found: angle number, column, row, and score in [0, 1], best first.

    `cut_short` says that more blocks promised as much than were followed.
    """

    angle: IntArray
    cell: IntArray
    score: FloatArray
    cut_short: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Wanted:
    """What is searched for: places that score `least` and no more than `lead` below the best.

    `most` blocks are followed at the most; of places within `apart_m` and `apart_rad` of each other
    the best counts.
    """

    least: float
    lead: float
    most: int
    apart_m: float = 1.0
    apart_rad: float = 0.3


def best_places(
    pyramid: Pyramid,
    points: NDArray[Any],
    blocks: IntArray,
    angles: FloatArray,
    wanted: Wanted,
    count: int,
) -> tuple[list[Match], bool]:
    """The `count` best poses of points (N, 2), best first, and whether the search was cut short.

    Their middle is looked for in the `blocks` (B, 2) of the top level, at `angles` (A,). Exact on
    the lattice of cells and angles, unless it was cut short. Points farther from their middle than
    the pyramid's reach do not count.
    """
    if not len(points) or not len(blocks) or not len(angles):
        return [], False
    middle = np.asarray(points, dtype=np.float64).mean(axis=0)
    local = np.asarray(points, dtype=np.float64) - middle
    local = local[np.hypot(local[:, 0], local[:, 1]) <= pyramid.reach_m]
    back = Pose2(-float(middle[0]), -float(middle[1]), 0.0)
    found = _descend(pyramid, _jumps(pyramid, local, angles), blocks, wanted)
    places = pyramid.corner + (found.cell + 0.5) * pyramid.cell_m
    centres: list[Pose2] = []
    kept: list[Match] = []
    for number, place, score in zip(found.angle, places, found.score, strict=True):
        centre = Pose2(float(place[0]), float(place[1]), wrap_angle(float(angles[number])))
        if all(_apart(centre, other, wanted) for other in centres):
            centres.append(centre)
            kept.append(Match(centre @ back, float(score)))
        if len(kept) == count:
            break
    return kept, found.cut_short


def _maxima(cells: NDArray[np.uint8], step: int) -> NDArray[np.uint8]:
    """The largest of four values `step` apart, from each cell on."""
    padded = np.pad(cells, ((0, step), (0, step)))
    rows = np.maximum(padded[:-step], padded[step:])
    return np.maximum(rows[:, :-step], rows[:, step:])


def _jumps(pyramid: Pyramid, points: NDArray[Any], angles: FloatArray) -> NDArray[np.int32]:
    """(A, N) how far in the flat field each turned point lies from the cell of the origin."""
    c, s = np.cos(angles)[:, None], np.sin(angles)[:, None]
    x, y = points[:, 0], points[:, 1]
    columns = np.round((c * x - s * y) / pyramid.cell_m)
    rows = np.round((s * x + c * y) / pyramid.cell_m)
    return np.asarray(rows * pyramid.levels[0].shape[1] + columns, dtype=np.int32)


def _descend(
    pyramid: Pyramid, jumps: NDArray[np.int32], blocks: IntArray, wanted: Wanted
) -> Places:
    """All cells and angles that score enough, by pruning blocks level after level."""
    number = np.repeat(np.arange(len(jumps)), len(blocks))
    cell = np.tile(blocks, (len(jumps), 1))
    full = _FULL * jumps.shape[1]
    sums = _sums(pyramid, _TOP, jumps, number, cell)
    floor, cut_short = math.ceil(wanted.least * full), False
    for level in range(_TOP, 0, -1):
        floor = max(floor, _greedy(pyramid, level, jumps, number, cell, sums) - wanted.lead * full)
        kept = np.flatnonzero(sums >= floor)
        if len(kept) > wanted.most:
            kept = np.sort(kept[np.argsort(-sums[kept], kind="stable")[: wanted.most]])
            cut_short = True
        number, cell = _children(number[kept], cell[kept], 2 ** (level - 1))
        sums = _sums(pyramid, level - 1, jumps, number, cell)
    kept = np.flatnonzero(sums >= max(floor, sums.max(initial=0) - wanted.lead * full))
    kept = kept[np.argsort(-sums[kept], kind="stable")]
    return Places(angle=number[kept], cell=cell[kept], score=sums[kept] / full, cut_short=cut_short)


def _greedy(
    pyramid: Pyramid,
    level: int,
    jumps: NDArray[np.int32],
    number: IntArray,
    cell: IntArray,
    sums: IntArray,
) -> int:
    """The score of a good place below the most promising blocks of a level."""
    for below in range(level - 1, -1, -1):
        best = np.argsort(-sums, kind="stable")[:_BEAM]
        number, cell = _children(number[best], cell[best], 2**below)
        sums = _sums(pyramid, below, jumps, number, cell)
    return int(sums.max(initial=0))


def _children(number: IntArray, cell: IntArray, step: int) -> tuple[IntArray, IntArray]:
    """The four blocks of half the side in each block."""
    quarters = np.array([[0, 0], [step, 0], [0, step], [step, step]])
    cells = (cell[:, None, :] + quarters).reshape(-1, 2)
    return np.repeat(number, 4), cells


def _sums(
    pyramid: Pyramid, level: int, jumps: NDArray[np.int32], number: IntArray, cell: IntArray
) -> IntArray:
    """(K,) sums of the field's bytes under the points, at each angle and cell."""
    field = pyramid.levels[level]
    flat, starts = field.ravel(), cell[:, 1] * field.shape[1] + cell[:, 0]
    sums = np.empty(len(starts), dtype=np.int64)
    chunk = max(1, _AT_ONCE // jumps.shape[1])
    for first in range(0, len(starts), chunk):
        part = slice(first, first + chunk)
        places = jumps[number[part]] + starts[part, None]
        sums[part] = flat.take(places).sum(axis=1, dtype=np.int64)
    return sums


def _apart(pose: Pose2, other: Pose2, wanted: Wanted) -> bool:
    """Whether two poses are two answers."""
    if math.hypot(pose.x - other.x, pose.y - other.y) >= wanted.apart_m:
        return True
    return abs(wrap_angle(pose.theta - other.theta)) >= wanted.apart_rad
