"""Where points fit in a map: anywhere, or as far as a guess may be off.

From coarse to fine, by branch and bound on maxima of a score field (Hess et al., "Real-Time Loop
Closure in 2D LIDAR SLAM", ICRA 2016, section V): level h of the pyramid holds, at each cell, the
largest value of the field in the 2^h x 2^h cells that begin there. Points summed on it are never
below their score at any of the shifts the cell stands for, so that whole blocks of shifts are ruled
out at once, as are those from where the robot would stand in a wall. Scores are sums of bytes:
exact, and the same on any processor.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray, Pose2, inverse3, wrap_angle
from specmap_cli.core.records import BoolArray, IntArray
from specmap_cli.grids.matching import Match, Window, within_ellipse, different_places, search
from specmap_cli.grids.score_field import ScoreField, thinned
from specmap_cli.layout.path_graph import MATCH_RANGE_M
from specmap_cli.layout.wall_matching import (
    FINE_POINTS_M,
    LOOP_SCORE,
    MATCH_POINTS,
    SURE,
    Place,
    Seen,
    WallFit,
    everywhere,
)

_MAP_CELLS = 512  # cells a side in such a search: a larger map is searched coarser
_SEARCH_BLOCKS = 400_000  # places followed at once in that search, at the most
_CELL_M, _BLUR_M = 0.1, 0.1  # of the field of the whole map
_SIDE = 40.0  # of that field, in ranges of the laser
_STEP_M, _TURN_RAD, _MOST_TURN_RAD = 0.3, 0.04, 0.08  # of the search in a map that is not too large
_RIVALS, _LEAD = 4, 0.05  # places compared, and the score by which the best must lead
_NEAR_STEPS, _NEAR_RAD, _NEAR_M = 0.75, 0.06, 0.1  # the search about each: its width and its step
_PINNED_M = 0.1  # largest mean deviation of a place found: more is a corridor's open direction
_BLOCK_M = 2.4  # side of the blocks that search begins with
_LEAST = SURE + 0.5 * LOOP_SCORE  # score of a sure fit of which half could have been seen
_STANDING_M = 0.6  # beyond what was seen: a robot's width, and what the poses there are off
_GUESS_SIGMAS = 3.0  # of a guess that are searched
_SPARSE_M = 0.4  # between the points of that search: some 100 of them tell a place
_REACH_RANGES = 1.5  # from a node to the farthest wall seen from the nodes around it
_NEAR_RANGES = 2.0  # walls this many ranges around a place are those seen from it

_TOP = 3  # level the search begins on: blocks of 8 cells, wide rooms still rule them out
_FULL = 255  # of a byte: a cell whose score is 1
_AT_ONCE = 500_000  # lookups in one go: some 4 MB
_SOME = 0.125  # of the points: what the search begins with, to find out what is hopeless
_GOLDEN = 0.5 * (5**0.5 - 1.0)  # steps of this share spread points evenly over any part of them
_BEAM = 64  # blocks followed down to a first good place, whose score prunes the others


@dataclass(frozen=True, slots=True)
class Guess:
    """Where points may be: about `pose`, with an error of this covariance (3, 3) in the map."""

    pose: Pose2
    covariance: FloatArray

    def angles(self, step_rad: float) -> FloatArray:
        """(A,) headings within three sigmas, from the guess outwards on either side."""
        reach = min(np.pi, _GUESS_SIGMAS * float(np.sqrt(self.covariance[2, 2])))
        count = int(np.ceil(reach / step_rad))
        steps = step_rad * np.arange(-count, count + 1)
        return np.asarray(self.pose.theta + steps, dtype=np.float64)

    def reaches(self, places: FloatArray, middle: FloatArray) -> BoolArray:
        """(B,) whether `middle` (2,), a point of the source, may lie at these places (B, 2)."""
        away = places - self.pose.apply(middle[None])
        spread = _GUESS_SIGMAS**2 * self.covariance[:2, :2] + _BLOCK_M**2 * np.eye(2)
        return within_ellipse(away, spread)


@dataclass(frozen=True, slots=True, kw_only=True)
class WallMap:
    """The walls (N, 2) among which places are looked for, and their score field.

    Places are searched `step_m` apart; `coarsened` says that the map is so large that this is more
    than usual. `seen` says which cells of a field, and so near to them, were looked into.
    """

    points: FloatArray
    seen: Seen
    field: ScoreField
    pyramid: Pyramid
    step_m: float
    coarsened: bool

    @classmethod
    def of(cls, points: FloatArray, seen: Seen = everywhere, *, standing: bool = False) -> WallMap:
        """The walls with their field; the robot is `standing` in what was seen, or anywhere."""
        field = ScoreField.from_points(points, _CELL_M, _BLUR_M, _SIDE * MATCH_RANGE_M)
        side_m = float(np.sqrt(field.values.size * field.resolution**2))
        needed_m = side_m / _MAP_CELLS
        step_m = max(_STEP_M, needed_m)
        coarse = field.coarser(max(1, round(step_m / field.resolution)))
        reach_m = _REACH_RANGES * MATCH_RANGE_M
        return cls(
            points=points,
            seen=seen,
            field=field,
            pyramid=Pyramid.of(coarse, reach_m, seen(coarse, _STANDING_M) if standing else None),
            step_m=step_m,
            coarsened=needed_m > _STEP_M,
        )

    def place_of(self, source: FloatArray, guess: Guess | None = None) -> WallFit | None:
        """The pose of points (N, 2) in the map: anywhere, or as far as a guess may be off.

        They must fit well, nowhere else nearly as well, and leave no direction open: in a bare
        corridor nothing is found.
        """
        few, sparse = thinned(source, FINE_POINTS_M), thinned(source, _SPARSE_M)
        if len(few) < MATCH_POINTS:
            return None
        turn = min(_TURN_RAD * self.step_m / _STEP_M, _MOST_TURN_RAD)
        angles, blocks = np.arange(0.0, 2 * np.pi, turn), self.pyramid.blocks()
        if guess is not None:
            angles = guess.angles(turn)
            pyramid, middle = self.pyramid, sparse.mean(axis=0)
            places = pyramid.corner + (blocks + 0.5 * 2**_TOP) * pyramid.cell_m
            blocks = blocks[guess.reaches(places, middle)]
        # the pooled score, an upper bound, may still become that of a match
        wanted = Wanted(least=_LEAST, lead=2 * _LEAD, most=_SEARCH_BLOCKS)
        rough = best_places(self.pyramid, sparse, blocks, angles, wanted, _RIVALS)
        window = Window(distance_m=_NEAR_STEPS * self.step_m, angle_rad=_NEAR_RAD, step_m=_NEAR_M)
        fine = [search(self.field, few, match.pose, window) for match in rough]
        fine.sort(key=lambda match: -match.score)
        if not fine or (len(fine) > 1 and fine[1].score > fine[0].score - _LEAD):
            return None
        best = fine[0]
        away = self.points - (best.pose.x, best.pose.y)
        near = np.hypot(away[:, 0], away[:, 1]) < _NEAR_RANGES * MATCH_RANGE_M
        found = Place.of(self.points[near], self.seen).confirmed(source, best.pose, SURE)
        if found is None:
            return None
        variance = float(inverse3(found.information)[:2, :2].trace())
        return found if variance <= 2 * _PINNED_M**2 else None


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
    def of(cls, field: ScoreField, reach_m: float, free: BoolArray | None = None) -> Pyramid:
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


def _levels(cells: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], ...]:
    """The cells, and the maxima over blocks of them, level after level."""
    levels = [cells]
    for level in range(_TOP):
        step = 2**level
        padded = np.pad(levels[-1], ((0, step), (0, step)))
        rows = np.maximum(padded[:-step], padded[step:])
        levels.append(np.maximum(rows[:, :-step], rows[:, step:]))
    return tuple(levels)


@dataclass(frozen=True, slots=True, kw_only=True)
class Wanted:
    """What is searched for: places that score `least` and no more than `lead` below the best.

    `most` blocks are followed at the most.
    """

    least: float
    lead: float
    most: int


def best_places(
    pyramid: Pyramid,
    points: NDArray[Any],
    blocks: IntArray,
    angles: FloatArray,
    wanted: Wanted,
    count: int,
) -> list[Match]:
    """The `count` best poses of points (N, 2), best first, each a place of its own.

    Their middle is looked for in the `blocks` (B, 2) of the top level, at `angles` (A,), their
    origin, where the robot stands, in free cells. Exact on the lattice of cells and angles, unless
    more blocks promise as much than may be followed. Points farther from their middle than the
    pyramid's reach do not count.
    """
    if not len(points) or not len(blocks) or not len(angles):
        return []
    middle = np.asarray(points, dtype=np.float64).mean(axis=0)
    local = np.asarray(points, dtype=np.float64) - middle
    local = local[np.hypot(local[:, 0], local[:, 1]) <= pyramid.reach_m]
    spread = np.argsort(np.arange(len(local)) * _GOLDEN % 1.0, kind="stable")
    x, y = np.concatenate([local[spread], -middle[None]]).T  # the robot last
    c, s = np.cos(angles)[:, None], np.sin(angles)[:, None]
    columns = np.round((c * x - s * y) / pyramid.cell_m)
    rows = np.round((s * x + c * y) / pyramid.cell_m)
    jumps = np.asarray(rows * pyramid.levels[0].shape[1] + columns, dtype=np.int32)
    known = pyramid.free and np.hypot(middle[0], middle[1]) <= pyramid.reach_m
    task = _Task(pyramid, jumps[:, :-1], jumps[:, -1] if known else None)
    number, cell, scores = _descend(task, blocks, wanted)
    places = pyramid.corner + (cell + 0.5) * pyramid.cell_m
    found = (
        (float(score), Pose2(float(place[0]), float(place[1]), wrap_angle(float(angle))))
        for angle, place, score in zip(angles[number], places, scores, strict=True)
    )
    return different_places(found, middle, count)


@dataclass(frozen=True, slots=True)
class _Task:
    """Turned points in a flat field: `points` (A, N) and the robot (A,), cells from their middle.

    `robot` is None where it may stand anywhere.
    """

    pyramid: Pyramid
    points: NDArray[np.int32]
    robot: NDArray[np.int32] | None

    @property
    def full(self) -> int:
        """The sum of a perfect fit."""
        return int(_FULL * self.points.shape[1])

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

    def children(self, level: int, number: IntArray, cell: IntArray) -> tuple[IntArray, IntArray]:
        """The four blocks of half the side in each block, where the robot may stand in them."""
        step = 2**level
        quarters = np.array([[0, 0], [step, 0], [0, step], [step, step]])
        cells = (cell[:, None, :] + quarters).reshape(-1, 2)
        return self.allowed(level, np.repeat(number, 4), cells)

    def sums(self, level: int, number: IntArray, cell: IntArray, floor: int) -> IntArray:
        """(K,) sums of the field's bytes under the points, at each angle and cell.

        Where they cannot reach `floor` any more the sum is that of some of the points.
        """
        flat, starts = self.pyramid.levels[level].ravel(), self.starts(cell)
        count = self.points.shape[1]
        first = math.ceil(_SOME * count)
        sums = np.zeros(len(starts), dtype=np.int64)
        chunk = max(1, _AT_ONCE // count)
        for start in range(0, len(starts), chunk):
            left = np.arange(start, min(start + chunk, len(starts)))
            for columns in (slice(0, first), slice(first, count)):
                places = self.points[number[left], columns] + starts[left, None]
                sums[left] += flat.take(places).sum(axis=1, dtype=np.uint32)
                left = left[sums[left] + _FULL * (count - first) >= floor]
        return sums


def _descend(
    task: _Task, blocks: IntArray, wanted: Wanted
) -> tuple[IntArray, IntArray, FloatArray]:
    """All cells and angles that score enough, by pruning blocks level after level.

    Numbers of the angles (L,), cells (L, 2), and scores (L,) in [0, 1], best first.
    """
    number = np.repeat(np.arange(len(task.points)), len(blocks))
    number, cell = task.allowed(_TOP, number, np.tile(blocks, (len(task.points), 1)))
    lead, count = math.floor(wanted.lead * task.full), task.points.shape[1]
    some = replace(task, points=task.points[:, : math.ceil(_SOME * count)])  # which lie all over
    rough = some.sums(_TOP, number, cell, 0)
    floor = math.ceil(wanted.least * task.full)
    floor = max(floor, _greedy(task, _TOP, number, cell, rough) - lead)
    kept = np.flatnonzero(rough + task.full - some.full >= floor)
    number, cell = number[kept], cell[kept]
    sums = task.sums(_TOP, number, cell, floor)
    for level in range(_TOP, 0, -1):
        floor = max(floor, _greedy(task, level, number, cell, sums) - lead)
        kept = np.flatnonzero(sums >= floor)
        if len(kept) > wanted.most:
            kept = np.sort(kept[np.argsort(-sums[kept], kind="stable")[: wanted.most]])
        number, cell = task.children(level - 1, number[kept], cell[kept])
        sums = task.sums(level - 1, number, cell, floor)
    kept = np.flatnonzero(sums >= max(floor, sums.max(initial=0) - wanted.lead * task.full))
    kept = kept[np.argsort(-sums[kept], kind="stable")]
    return number[kept], cell[kept], sums[kept] / task.full


def _greedy(task: _Task, level: int, number: IntArray, cell: IntArray, sums: IntArray) -> int:
    """The score of a good place below the most promising blocks of a level."""
    for below in range(level - 1, -1, -1):
        among = np.arange(len(sums))
        if len(sums) > _BEAM:
            among = np.flatnonzero(sums >= np.partition(sums, -_BEAM)[-_BEAM])
        best = among[np.argsort(-sums[among], kind="stable")[:_BEAM]]
        number, cell = task.children(below, number[best], cell[best])
        sums = task.sums(below, number, cell, 0)
    return int(sums.max(initial=0))
