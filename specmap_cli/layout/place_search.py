"""Where points fit in a map, from coarse to fine: branch and bound on maxima of a score field.

Hess et al., "Real-Time Loop Closure in 2D LIDAR SLAM" (ICRA 2016), section V: level h of the
pyramid holds, at each cell, the largest value of the field in the 2^h x 2^h cells that begin there.
Points summed on it are never below their score at any of the shifts the cell stands for, so that
whole blocks of shifts are ruled out at once, as are those from where the robot would stand in a
wall. Scores are sums of bytes: exact, and the same on any processor.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray, Pose2, wrap_angle
from specmap_cli.core.records import IntArray
from specmap_cli.grids.matching import Match
from specmap_cli.grids.score_field import ScoreField

_TOP = 3  # level the search begins on: blocks of 8 cells, wide rooms still rule them out
_FULL = 255  # of a byte: a cell whose score is 1
_AT_ONCE = 500_000  # lookups in one go: some 4 MB
_SOME = 0.125  # of the points: what the search begins with, to find out what is hopeless
_GOLDEN = 0.5 * (5**0.5 - 1.0)  # steps of this share spread points evenly over any part of them
_BEAM = 64  # blocks followed down to a first good place, whose score prunes the others


@dataclass(frozen=True, slots=True, kw_only=True)
class Pyramid:
    """Maxima of a score field: `levels[h]` (H, W) in bytes, over 2^h x 2^h cells from each cell.

    Noughts surround the field on `border` cells. `corner` (2,) is where the cells begin, metres.
    `free`, of the same form, holds 1 where a robot may stand; it may stand anywhere when empty.
    """

    levels: tuple[NDArray[np.uint8], ...]
    free: tuple[NDArray[np.uint8], ...]
    border: int
    corner: FloatArray
    cell_m: float

    @property
    def reach_m(self) -> float:
        """Points this far from their middle stay on the noughts around the field."""
        return float((self.border - 2**_TOP - 1) * self.cell_m)

    @classmethod
    def of(
        cls, field: ScoreField, reach_m: float, free: NDArray[np.bool_] | None = None
    ) -> Pyramid:
        """The pyramid of a field, for points within `reach_m` of their origin.

        `free` marks the cells of the field where a robot may stand.
        """
        border = math.ceil(reach_m / field.resolution) + 2**_TOP + 1
        cells = np.round(field.values * _FULL).astype(np.uint8)
        return cls(
            levels=_levels(np.pad(cells, border)),
            free=() if free is None else _levels(np.pad(free.astype(np.uint8), border)),
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

    Their middle is looked for in the `blocks` (B, 2) of the top level, at `angles` (A,), their
    origin, where the robot stands, in free cells. Exact on the lattice of cells and angles, unless
    it was cut short. Points farther from their middle than the pyramid's reach do not count.
    """
    if not len(points) or not len(blocks) or not len(angles):
        return [], False
    middle = np.asarray(points, dtype=np.float64).mean(axis=0)
    local = np.asarray(points, dtype=np.float64) - middle
    local = local[np.hypot(local[:, 0], local[:, 1]) <= pyramid.reach_m]
    back = Pose2(-float(middle[0]), -float(middle[1]), 0.0)
    found = _descend(_Task.of(pyramid, local, -middle, angles), blocks, wanted)
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


def _levels(cells: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], ...]:
    """The cells, and the maxima over blocks of them, level after level."""
    levels = [cells]
    for level in range(_TOP):
        levels.append(_maxima(levels[-1], 2**level))
    return tuple(levels)


def _maxima(cells: NDArray[np.uint8], step: int) -> NDArray[np.uint8]:
    """The largest of four values `step` apart, from each cell on."""
    padded = np.pad(cells, ((0, step), (0, step)))
    rows = np.maximum(padded[:-step], padded[step:])
    return np.maximum(rows[:, :-step], rows[:, step:])


@dataclass(frozen=True, slots=True)
class _Task:
    """Turned points in a flat field: `points` (A, N) and the robot (A,), cells from their middle.

    `robot` is None where it may stand anywhere.
    """

    pyramid: Pyramid
    points: NDArray[np.int32]
    robot: NDArray[np.int32] | None

    @classmethod
    def of(
        cls, pyramid: Pyramid, points: FloatArray, robot: FloatArray, angles: FloatArray
    ) -> _Task:
        """Of points (N, 2) about their middle, and the robot (2,) seen from there."""
        spread = np.argsort(np.arange(len(points)) * _GOLDEN % 1.0, kind="stable")
        jumps = _jumps(pyramid, np.concatenate([points[spread], robot[None]]), angles)
        known = pyramid.free and np.hypot(robot[0], robot[1]) <= pyramid.reach_m
        return cls(pyramid, jumps[:, :-1], jumps[:, -1] if known else None)

    @property
    def full(self) -> int:
        """The sum of a perfect fit."""
        return int(_FULL * self.points.shape[1])

    def some(self) -> _Task:
        """The same of some of the points, which lie all over."""
        return replace(self, points=self.points[:, : math.ceil(_SOME * self.points.shape[1])])

    def starts(self, cell: IntArray) -> IntArray:
        """(K,) cells (K, 2) in the flat field."""
        return np.asarray(cell[:, 1] * self.pyramid.levels[0].shape[1] + cell[:, 0])

    def allowed(self, level: int, number: IntArray, cell: IntArray) -> tuple[IntArray, IntArray]:
        """Those of the blocks in which the robot may stand somewhere."""
        if self.robot is None:
            return number, cell
        free = self.pyramid.free[level].ravel()
        kept = free.take(self.robot[number] + self.starts(cell)) > 0
        return number[kept], cell[kept]


def _jumps(pyramid: Pyramid, points: NDArray[Any], angles: FloatArray) -> NDArray[np.int32]:
    """(A, N) how far in the flat field each turned point lies from the cell of the origin."""
    c, s = np.cos(angles)[:, None], np.sin(angles)[:, None]
    x, y = points[:, 0], points[:, 1]
    columns = np.round((c * x - s * y) / pyramid.cell_m)
    rows = np.round((s * x + c * y) / pyramid.cell_m)
    return np.asarray(rows * pyramid.levels[0].shape[1] + columns, dtype=np.int32)


def _descend(task: _Task, blocks: IntArray, wanted: Wanted) -> Places:
    """All cells and angles that score enough, by pruning blocks level after level."""
    number = np.repeat(np.arange(len(task.points)), len(blocks))
    number, cell = task.allowed(_TOP, number, np.tile(blocks, (len(task.points), 1)))
    some, lead = task.some(), math.floor(wanted.lead * task.full)
    rough = _sums(some, _TOP, number, cell, 0)
    floor, cut_short = math.ceil(wanted.least * task.full), False
    floor = max(floor, _greedy(task, _TOP, number, cell, rough) - lead)
    kept = np.flatnonzero(rough + task.full - some.full >= floor)
    number, cell = number[kept], cell[kept]
    sums = _sums(task, _TOP, number, cell, floor)
    for level in range(_TOP, 0, -1):
        floor = max(floor, _greedy(task, level, number, cell, sums) - lead)
        kept = np.flatnonzero(sums >= floor)
        if len(kept) > wanted.most:
            kept = np.sort(kept[np.argsort(-sums[kept], kind="stable")[: wanted.most]])
            cut_short = True
        number, cell = _children(task, level - 1, number[kept], cell[kept])
        sums = _sums(task, level - 1, number, cell, floor)
    kept = np.flatnonzero(sums >= max(floor, sums.max(initial=0) - wanted.lead * task.full))
    kept = kept[np.argsort(-sums[kept], kind="stable")]
    return Places(
        angle=number[kept], cell=cell[kept], score=sums[kept] / task.full, cut_short=cut_short
    )


def _greedy(task: _Task, level: int, number: IntArray, cell: IntArray, sums: IntArray) -> int:
    """The score of a good place below the most promising blocks of a level."""
    for below in range(level - 1, -1, -1):
        best = _best(sums)
        number, cell = _children(task, below, number[best], cell[best])
        sums = _sums(task, below, number, cell, 0)
    return int(sums.max(initial=0))


def _best(sums: IntArray) -> IntArray:
    """Which of the blocks are followed down: the first of the best."""
    if len(sums) > _BEAM:
        least = np.partition(sums, -_BEAM)[-_BEAM]
        among = np.flatnonzero(sums >= least)
    else:
        among = np.arange(len(sums))
    return np.asarray(among[np.argsort(-sums[among], kind="stable")[:_BEAM]], dtype=np.int64)


def _children(
    task: _Task, level: int, number: IntArray, cell: IntArray
) -> tuple[IntArray, IntArray]:
    """The four blocks of half the side in each block, where the robot may stand in them."""
    step = 2**level
    quarters = np.array([[0, 0], [step, 0], [0, step], [step, step]])
    cells = (cell[:, None, :] + quarters).reshape(-1, 2)
    return task.allowed(level, np.repeat(number, 4), cells)


def _sums(task: _Task, level: int, number: IntArray, cell: IntArray, floor: int) -> IntArray:
    """(K,) sums of the field's bytes under the points, at each angle and cell.

    Where they cannot reach `floor` any more the sum is that of some of the points.
    """
    flat, starts = task.pyramid.levels[level].ravel(), task.starts(cell)
    count = task.points.shape[1]
    first = math.ceil(_SOME * count)
    sums = np.zeros(len(starts), dtype=np.int64)
    chunk = max(1, _AT_ONCE // count)
    for start in range(0, len(starts), chunk):
        left = np.arange(start, min(start + chunk, len(starts)))
        for columns in (slice(0, first), slice(first, count)):
            places = task.points[number[left], columns] + starts[left, None]
            sums[left] += flat.take(places).sum(axis=1, dtype=np.uint32)
            left = left[sums[left] + _FULL * (count - first) >= floor]
    return sums


def _apart(pose: Pose2, other: Pose2, wanted: Wanted) -> bool:
    """Whether two poses are two answers."""
    if math.hypot(pose.x - other.x, pose.y - other.y) >= wanted.apart_m:
        return True
    return abs(wrap_angle(pose.theta - other.theta)) >= wanted.apart_rad
