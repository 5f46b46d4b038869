"""A closure told more precisely: by the walls around the two keyframes that it ties.

Grids of whole submaps match to their cells, and a path that drifts within a submap bends its grid.
What was seen within a few metres of either keyframe is not bent, and not drawn on cells: first one
place as a whole is laid on the other, then scans of both are laid on each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from specmap_cli.core.arrays import evenly
from specmap_cli.core.geometry import (
    FloatArray,
    Pose2,
    compose,
    inverse3,
    invert,
    product,
    travelled,
    wrap_angles,
)
from specmap_cli.core.records import BoolArray, IntArray
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.grids.score_field import thinned
from specmap_cli.layout.path_graph import MATCH_RANGE_M
from specmap_cli.layout.wall_matching import LOOP_SCORE, MATCH_POINTS
from specmap_cli.layout.walls import CELL_M

_PLACE_M = 2.5  # of path on either side of a keyframe: its walls make one place
_SCANS = 8  # of a place that are laid on each other, beside that of its keyframe
_BASIN_M, _BASIN_RAD = 0.3, 0.06  # the grids were compared that near: what lies beyond was not
_SPREAD = (_BASIN_M / 2, _BASIN_RAD / 2)  # the guess lies in there with two standard deviations

_SEARCHES, _STEPS = 2, 2  # neighbours are looked up so often, and used for so many steps
_NEIGHBOURS = 24  # returns of other scans, at the most, that make a line
_AROUND_M = 0.15  # and how far they lie from the point: a wall is straight that far
_FEWEST = 4  # of them: two would draw a line anywhere
_SHORTEST_M = 0.02  # standard deviation along the line: shorter ones have no direction
_FLAT = 0.25  # of the variance along a line, that across it: more is a corner or a leg of a chair
_NOISE_M = 0.03  # a return this far off its line counts half: some sigmas of a laser
# Lines of noisy returns are turned by some four degrees: what no more than this share of the
# squares of their normals says of a place is made of that, as along a bare corridor.
_SCATTER = 0.005
# A scan was registered to that beside the others: along a bare corridor it stays where it was.
_TRUST = np.array([0.05, 0.05, 0.02]) ** -2.0


@dataclass(frozen=True, slots=True)
class Place:
    """What was seen around a keyframe on one pass.

    `scans` are points (N, 2) on walls, each in the base frame of its keyframe; `poses` (n, 3) of
    these in the frame of the `own`-th, which is that keyframe.
    """

    scans: tuple[FloatArray, ...]
    poses: FloatArray
    own: int

    @property
    def walls(self) -> FloatArray:
        """Points (N, 2) on the walls, one in a cell."""
        seen = [
            Pose2(*pose.tolist()).apply(points)
            for points, pose in zip(self.scans, self.poses, strict=True)
        ]
        return thinned(np.concatenate(seen), CELL_M)

    def of_few(self, most: int) -> Place:
        """The same of its own keyframe and at most `most` others, evenly spread."""
        others = np.delete(np.arange(len(self.scans)), self.own)
        few = np.sort(np.append(evenly(others, most), self.own))
        scans = tuple(thinned(self.scans[k], CELL_M) for k in few.tolist())
        return Place(scans, self.poses[few], int(np.searchsorted(few, self.own)))


def place_around(store: KeyframeStore, keyframes: Sequence[int], k: int) -> Place:
    """What was seen near the k-th of some keyframes of one pass."""
    poses = store.poses_of(keyframes)
    path = travelled(poses)
    near = np.flatnonzero(np.abs(path - path[k]) <= _PLACE_M)
    scans = tuple(store.points(keyframes[i], MATCH_RANGE_M) for i in near.tolist())
    relative = compose(invert(poses[k]), poses[near])
    return Place(scans, relative, int(np.searchsorted(near, k)))


def sharpened(old: Place, new: Place, guess: Pose2) -> Pose2:
    """The pose of the keyframe of `new` seen from that of `old`, from a guess that was verified.

    Along a bare corridor the guess stays, across it the walls decide. Where these do not fit, or
    fit elsewhere, it stays as it is.
    """
    old, new = old.of_few(_SCANS), new.of_few(_SCANS)
    rough = onto_lines(new.walls, old.walls, guess, _SPREAD)
    if rough.share < LOOP_SCORE or rough.points < MATCH_POINTS:
        return guess
    # then, a few centimetres off at the most, the scans of both places are laid on each other
    poses = np.concatenate([old.poses, compose(np.array(rough.target_from_source), new.poses)])
    placed = on_lines([*old.scans, *new.scans], poses)
    ends = placed[old.own], placed[len(old.poses) + new.own]
    fine = Pose2(*compose(invert(ends[0]), ends[1]).tolist())
    off = guess.inverse() @ fine
    return fine if off.distance <= _BASIN_M and abs(off.theta) <= _BASIN_RAD else guess


@dataclass(frozen=True, slots=True)
class LineFit:
    """The pose of one place in another, and how well they fit there.

    Of the points of one that lie near a line of the other, `share` lie on it; there are `points` of
    them. Both are those of the place that has less of them.
    """

    target_from_source: Pose2
    share: float
    points: int


def onto_lines(
    source: FloatArray, target: FloatArray, guess: Pose2, spread: tuple[float, float]
) -> LineFit:
    """The pose of points `source` (N, 2) on the lines of `target` (M, 2), and the other way round.

    `guess` is `target_from_source` to within two of `spread`, metres and radians. What only one of
    the two shows does not count.
    """
    cloud = _Cloud([target, source])
    first = np.array([(0.0, 0.0, 0.0), guess])
    trust, placed = np.array([spread[0], spread[0], spread[1]]) ** -2.0, first
    moving = np.array([[0.0], [1.0]])  # the target stays
    for around_m in (2.0 * spread[0], _AROUND_M):
        placed = cloud.laid(placed, first, trust, around_m, moving)
    lines = cloud.lines(placed, *cloud.neighbours(placed, _AROUND_M))
    known = [lines.known & (cloud.scan == k) for k in (0, 1)]
    on_it = np.abs(lines.off) < _NOISE_M
    on = [int(np.count_nonzero(on_it & each)) for each in known]
    count = [int(np.count_nonzero(each)) for each in known]
    share = min(part / max(whole, 1) for part, whole in zip(on, count, strict=True))
    return LineFit(Pose2(*placed[1].tolist()), share, min(count))


def on_lines(scans: Sequence[FloatArray], poses: FloatArray) -> FloatArray:
    """The poses (n, 3), near those given, at which scans of points (N, 2) fit each other best.

    All may move; what counts is how they lie to each other. One that shows no line stays.
    """
    return _Cloud(scans).laid(poses, poses, _TRUST, _AROUND_M, np.ones((len(poses), 1)))


class _Lines(NamedTuple):
    """Lines beside N points, where they are `known` (N,).

    Unit `normals` (2, N), and how far `off` (N,) along them, metres, the lines are.
    """

    normals: FloatArray
    off: FloatArray
    known: BoolArray


class _Cloud:
    """The points (N, 2) of all scans, each in its scan's frame, and the `scan` (N,) of each."""

    def __init__(self, scans: Sequence[FloatArray]) -> None:
        self.points = np.concatenate(scans)
        self.scan = np.repeat(np.arange(len(scans)), [len(points) for points in scans])

    def laid(
        self,
        placed: FloatArray,
        first: FloatArray,
        trust: FloatArray,
        around_m: float,
        moving: FloatArray,
    ) -> FloatArray:
        """The poses (n, 3) after some steps from those at which the scans are `placed`.

        `first` (n, 3) are those that were known to `trust` (3,), an information in x, y and turn.
        Each moves by the share `moving` (n, 1) of its steps.
        """
        for _ in range(_SEARCHES):
            near = self.neighbours(placed, around_m)
            for _ in range(_STEPS):
                lines = self.lines(placed, *near)
                placed = placed + self._step(lines, placed, first, trust) * moving
        return placed

    def neighbours(self, poses: FloatArray, around_m: float) -> tuple[IntArray, BoolArray]:
        """(N, k) and (N, k) the points near each, with the scans at some poses, and which count.

        Those count that are of other scans.
        """
        placed = self._turned(poses) + poses[self.scan, :2]
        if not len(placed):
            return np.zeros((0, 1), dtype=np.int64), np.zeros((0, 1), dtype=bool)
        nearest = range(1, min(_NEIGHBOURS, len(placed)) + 1)
        _, found = cKDTree(placed).query(placed, nearest, distance_upper_bound=around_m)
        known = found < len(placed)
        found[~known] = 0
        return found, known & (self.scan[found] != self.scan[:, None])

    def lines(self, poses: FloatArray, near: IntArray, counted: BoolArray) -> _Lines:
        """The lines that the neighbours of each point draw, with the scans at some poses."""
        placed = self._turned(poses) + poses[self.scan, :2]
        count = counted.sum(axis=1)
        shares = counted / np.maximum(count, 1)[:, None]
        x, y = (placed[:, axis][near] - placed[:, axis, None] for axis in (0, 1))
        mean_x, mean_y = (shares * x).sum(axis=1), (shares * y).sum(axis=1)
        xx = (shares * x * x).sum(axis=1) - mean_x * mean_x
        yy = (shares * y * y).sum(axis=1) - mean_y * mean_y
        xy = (shares * x * y).sum(axis=1) - mean_x * mean_y
        half, middle = 0.5 * (xx - yy), 0.5 * (xx + yy)
        reach = np.sqrt(half * half + xy * xy)
        across, along = middle - reach, middle + reach
        # the shorter axis, by that of the two forms of the vector that does not vanish
        steep = half > 0.0
        normals = np.stack([np.where(steep, -xy, reach - half), np.where(steep, half + reach, -xy)])
        length = np.sqrt(normals[0] * normals[0] + normals[1] * normals[1])
        normals = normals / np.where(length > 0.0, length, 1.0)
        is_line = (count >= _FEWEST) & (along > _SHORTEST_M**2) & (across < _FLAT * along)
        return _Lines(normals, normals[0] * mean_x + normals[1] * mean_y, is_line)

    def _turned(self, poses: FloatArray) -> FloatArray:
        """(N, 2) the points about the place of their scan, turned as it is."""
        c, s = np.cos(poses[:, 2])[self.scan], np.sin(poses[:, 2])[self.scan]
        x, y = self.points.T
        return np.column_stack([c * x - s * y, s * x + c * y])

    def _step(
        self, lines: _Lines, placed: FloatArray, first: FloatArray, trust: FloatArray
    ) -> FloatArray:
        """(n, 3) a Gauss-Newton step of every scan towards the lines of the others."""
        (nx, ny), (x, y) = lines.normals, self._turned(placed).T
        rows = np.stack([nx, ny, ny * x - nx * y])
        # Cauchy's, so that what stands elsewhere now draws at nothing
        weights = lines.known / (_NOISE_M**2 + lines.off * lines.off)
        weighted = rows * weights
        back = first - placed
        back[:, 2] = wrap_angles(back[:, 2])
        summed = partial(np.bincount, self.scan, minlength=len(placed))  # over each scan's points
        held = np.zeros((len(placed), 3)) + trust
        held[:, :2] += _SCATTER * summed(weights)[:, None]
        side, hessian = held * back, held[..., None] * np.eye(3)
        for i in range(3):
            side[:, i] += summed(weighted[i] * lines.off)
            for j in range(3):
                hessian[:, i, j] += summed(weighted[i] * rows[j])
        return product(inverse3(hessian), side[..., None])[..., 0]
