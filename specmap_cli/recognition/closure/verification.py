"""Do two grids show the same place? The most promising transforms refined, and a judgement.

The search needs no prior pose: rotations come from the directions of the walls, translations from a
correlation by Fourier transform of walls with walls and of free space with walls. The judgement
counts the wall points of each grid that the other one confirms, less twice those that stand where
the other saw free space: a right transform contradicts nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.arrays import evenly
from specmap_cli.core.geometry import FloatArray, Pose2, wrap_angle
from specmap_cli.grids.correlation import Target, marked_cells, peaks
from specmap_cli.grids.matching import refine
from specmap_cli.recognition.closure.prepared import INLIER_M, KnownArea, PreparedGrid

# How much is tried: more of each takes longer and found nothing more on fr079 and simulated tours.
_SLACK_RAD = math.radians(3.0)  # the direction of few walls is good to a few degrees
# Stairs of coarse cells bend that direction: by 22 degrees on simulated rooms in cells of 0.25 m.
_FINE_CELL_M, _CELL_M_PER_SLACK = 0.05, 0.025
_PEAKS_PER_ROTATION = 2
_PEAKS_APART_M = 1.0
_TRANSFORMS = 8
# Transforms farther apart are different ones to try, and rivals when both fit.
_DIFFERENT_M, _DIFFERENT_RAD = 0.5, math.radians(2.0)
RIVAL_M, RIVAL_RAD = 1.0, math.radians(10.0)

CANDIDATES = 3  # best ranked old submaps whose grids are matched
_HOPELESS_SCORE = 0.3  # a match below this is given up
_SURE_SCORE = 0.8  # a match above this needs no other rotation
_CONTRADICTION_M = 0.3  # a wall point farther than this from walls, and in free space, contradicts
_CONTRADICTION_DEPTH_M = 0.25  # free space counts this far from its edge, which noise blurs
MIN_LEAD = 0.1  # score over the next best match, or it is ambiguous
MIN_WALL_M = 5.0  # metres of wall that agree, cell by cell
MIN_OVERLAP = 0.4  # shared part of the walls of one of two submaps
LEAST_OVERLAP = 0.15  # shared part of the walls of the other one
CONTRADICTION_WEIGHT = 2.0  # separates right from wrong transforms of fr079 without an error
# A wall may be drawn one cell beside where it is, or two where a turned grid is laid on another.
_INLIER_CELLS, _CONTRADICTION_CELLS = 1.0, 2.5
_REFINED = 3
# Points and shift of the refinement: first from a coarse cell away, then for the last centimetres.
_ROUGH_POINTS, _ROUGH_STEPS, _ROUGH_SHIFT_M = 160, 6, 0.6
_FINE_POINTS, _FINE_STEPS, _FINE_SHIFT_M = 1000, 15, 0.2


class TransformSearch:
    """The promising transforms old_from_new between two grids.

    `few` and `many` are the rotations off that of aligned walls, the smallest first, radians, that
    are tried at first, and when these lead nowhere. `centre` (2,) is that of the new grid's walls.
    """

    def __init__(self, old: PreparedGrid, new: PreparedGrid) -> None:
        # the larger the cells, the more steps to either side of aligned walls are tried at once
        cell_m = max(old.area.resolution, new.area.resolution)
        steps = max(0, int((cell_m - _FINE_CELL_M) / _CELL_M_PER_SLACK))
        offs = [sign * k * _SLACK_RAD for k in range(1, steps + 2) for sign in (-1.0, 1.0)]
        self.few, self.many = (0.0, *offs[:-2]), (0.0, *offs)
        self.centre: FloatArray = new.coarse.walls.mean(axis=0)
        self._old = old.coarse
        self._aligned = old.direction - new.direction
        self._parts = (new.coarse.walls - self.centre, new.coarse.free - self.centre)
        # of many rotations, neighbours of the best must not crowd out the rivals that count
        self._apart = (RIVAL_M, RIVAL_RAD) if steps else (_DIFFERENT_M, _DIFFERENT_RAD)
        self._targets: dict[int, Target] = {}
        self._placed: dict[tuple[int, float], list[tuple[float, Pose2]]] = {}

    def best(self, slacks: Iterable[float]) -> list[Pose2]:
        """At most 8 transforms with one of these rotations, the most promising first."""
        found = [
            placed
            for quarters in (0, 1)
            for slack in slacks
            for placed in self._of_rotation(quarters, slack)
        ]
        found.sort(key=lambda item: -item[0])
        kept: list[Pose2] = []
        for _, pose in found:
            if all(differ(pose, other, self.centre, *self._apart) for other in kept):
                kept.append(pose)
            if len(kept) == _TRANSFORMS:
                break
        return kept

    def _of_rotation(self, quarters: int, slack: float) -> list[tuple[float, Pose2]]:
        """The best transforms, with their values, of a rotation and of half a turn more.

        Walls and free space of the new grid, turned, are laid on the old one at every shift. There
        is room for the new grid at every rotation about one of aligned walls.
        """
        if (quarters, slack) in self._placed:
            return self._placed[quarters, slack]
        cell_m, (x, y) = self._old.cell_m, self._old.origin
        angle = self._aligned + quarters * math.pi / 2
        if quarters not in self._targets:
            turned = Pose2(0.0, 0.0, angle).apply(np.vstack(self._parts))
            reach: FloatArray = np.abs(turned).max(axis=0)
            reach = reach + math.sin(self.many[-1]) * reach[::-1]
            # to both sides, and what rounding to cells adds
            columns, rows = (2 * np.ceil(reach / cell_m).astype(int) + 3).tolist()
            self._targets[quarters] = Target.of(self._old.layers, (rows, columns))
        target, angle = self._targets[quarters], angle + slack
        turn, apart = Pose2(0.0, 0.0, angle), round(_PEAKS_APART_M / cell_m)
        pictures = [marked_cells(turn.apply(part), cell_m, target.shape) for part in self._parts]
        whole, half = target.correlate_turned(np.stack(pictures))
        to_centre = Pose2(-float(self.centre[0]), -float(self.centre[1]), 0.0)
        found = []
        for correlation, heading in ((whole, angle), (half, angle + math.pi)):
            for peak in peaks(correlation, target.size, cell_m, _PEAKS_PER_ROTATION, apart):
                at = Pose2(peak.x + x, peak.y + y, wrap_angle(heading))
                found.append((peak.value, at @ to_centre))
        self._placed[quarters, slack] = found
        return found


def differ(a: Pose2, b: Pose2, centre: NDArray[np.float64], metres: float, radians: float) -> bool:
    """Whether two transforms place `centre` (2,) farther apart than this, or turn it further."""
    shift = a.apply(centre[None])[0] - b.apply(centre[None])[0]
    turn = abs(wrap_angle(a.theta - b.theta))
    return math.hypot(*shift.tolist()) > metres or turn > radians


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """The best transform between two grids and how well they agree under it.

    `score` is the smaller share of inliers less twice the larger share of contradictions, at most
    1; `confirmed_m` the smaller length of wall confirmed, metres; `overlap` and `least_overlap` the
    larger and the smaller share of a grid's walls that the other one knows about; `net_walls_m` the
    smaller length of wall that speaks for the transform, less twice that against it: a share would
    favour grids that hardly touch. `lead` is how much better it is than the next best transform
    that is a different one.
    """

    old_from_new: Pose2
    score: float
    confirmed_m: float
    overlap: float
    least_overlap: float
    net_walls_m: float = 0.0
    lead: float = 0.0

    @property
    def overlaps(self) -> bool:
        """Whether each grid knows enough of the walls of the other."""
        return self.overlap >= MIN_OVERLAP and self.least_overlap >= LEAST_OVERLAP

    def matches(self, min_score: float) -> bool:
        """Whether the grids match here, whatever else may match as well."""
        walls = self.confirmed_m >= MIN_WALL_M
        return self.score >= min_score and walls and self.overlaps


def verify(
    old: PreparedGrid,
    new: PreparedGrid,
    plausible: Callable[[Pose2], bool] | None = None,
) -> Check | None:
    """The best transform between two grids and its judgement; None when nothing overlaps.

    Of transforms that fit alike only those are rivals that are `plausible`, if that is known.

    Directions of walls are taken as they are first; when that looks promising but is neither right
    nor clear, they are tried a few degrees off as well.
    """
    search = TransformSearch(old, new)
    trials = _Trials(old, new, search.centre, plausible)
    best = trials.best(search.best(search.few))
    promising = best is not None and _HOPELESS_SCORE <= best.score < _SURE_SCORE
    # what contradicts a clear match is a difference of the places, not an error of the direction
    if best is not None and promising and not (best.overlaps and best.lead >= MIN_LEAD):
        other = trials.best(search.best(search.many))
        best = other if other is not None and _rank(other) > _rank(best) else best
    return best


def judge(old: PreparedGrid, new: PreparedGrid, old_from_new: Pose2) -> Check:
    """How well two grids agree under a given transform."""
    there = agreement(old.area, old_from_new.apply(new.walls))
    back = agreement(new.area, old_from_new.inverse().apply(old.walls))
    contradicted = max(there.contradicted, back.contradicted)
    return Check(
        old_from_new=old_from_new,
        score=min(there.confirmed, back.confirmed) - CONTRADICTION_WEIGHT * contradicted,
        confirmed_m=min(there.inliers * new.metres_a_point, back.inliers * old.metres_a_point),
        overlap=max(there.known, back.known),
        least_overlap=min(there.known, back.known),
        net_walls_m=min(
            said.known
            * len(grid.walls)
            * grid.metres_a_point
            * (said.confirmed - CONTRADICTION_WEIGHT * said.contradicted)
            for said, grid in ((there, new), (back, old))
        ),
    )


def tracks_overlap(
    old: NDArray[np.float64], new: NDArray[np.float64], old_from_new: Pose2, reach: float
) -> float:
    """The smaller share of either track (k, 3) that passes within `reach` metres of the other."""
    if not len(old) or not len(new):
        return 0.0
    placed = old_from_new.apply(new[:, :2])
    squared = ((old[:, None, :2] - placed[None]) ** 2).sum(axis=2)
    near = squared <= reach * reach
    return float(min(near.any(axis=0).mean(), near.any(axis=1).mean()))


class _Trials:
    """Transforms between two grids that were refined and judged, each once.

    `centre` (2,) is that of the new grid's walls.
    """

    def __init__(
        self,
        old: PreparedGrid,
        new: PreparedGrid,
        centre: FloatArray,
        plausible: Callable[[Pose2], bool] | None,
    ) -> None:
        self.old, self.new, self.centre, self.plausible = old, new, centre, plausible
        self.rough = evenly(new.walls, _ROUGH_POINTS)
        self._checks: dict[tuple[Pose2, bool], Check] = {}

    def refined(self, guess: Pose2, *, fine: bool = False) -> Check:
        """A guess refined from a coarse cell away, or, `fine`, for the last centimetres."""
        if (guess, fine) not in self._checks:
            points = evenly(self.new.walls, _FINE_POINTS) if fine else self.rough
            steps = _FINE_STEPS if fine else _ROUGH_STEPS
            shift_m = _FINE_SHIFT_M if fine else _ROUGH_SHIFT_M
            match = refine(self.old.field, points, guess, steps, shift_m)
            self._checks[guess, fine] = judge(self.old, self.new, match.pose)
        return self._checks[guess, fine]

    def best(self, guesses: Sequence[Pose2]) -> Check | None:
        """The best transform near guesses, and how much better it is than a different one.

        Those that tracking rules out are not weighed. Where the best is ruled out itself and leads,
        all are: it is to be told.
        """
        wide, rough = self.old.wide, self.rough
        likely = sorted(guesses, key=lambda guess: wide.score(rough, guess), reverse=True)
        checks = sorted(map(self.refined, likely[:_REFINED]), key=_rank, reverse=True)
        if not checks:
            return None
        if self.plausible is not None:
            possible = [check for check in checks if self.plausible(check.old_from_new)]
            if possible and _rank(checks[0]) - _rank(possible[0]) < MIN_LEAD:
                checks = possible
        best, *others = checks
        if best.score < _HOPELESS_SCORE:
            return best
        final = self.refined(best.old_from_new, fine=True)
        rivals = [
            _rank(check)
            for check in others
            if differ(check.old_from_new, best.old_from_new, self.centre, RIVAL_M, RIVAL_RAD)
        ]
        lead = _rank(best) - max(rivals, default=-1.0)
        return replace(final if final.score >= best.score else best, lead=lead)


def _rank(check: Check) -> float:
    """What decides between transforms: agreement, and how much of the walls it covers."""
    return check.score * math.sqrt(check.overlap) if check.score > 0.0 else check.score - 1.0


@dataclass(frozen=True, slots=True)
class Agreement:
    """Of points on walls: the share in a known area, and of these the shares that it confirms and
    contradicts, and the count of those confirmed.
    """

    known: float
    confirmed: float
    contradicted: float
    inliers: int


def agreement(area: KnownArea, points: FloatArray) -> Agreement:
    """What an area says to points (N, 2) on walls, in its grid's frame."""
    cells = np.floor((points - area.origin) / area.resolution).astype(np.intp)
    height, width = area.known.shape
    inside = ((cells >= 0) & (cells < (width, height))).all(axis=1)
    columns, rows = cells[inside].T
    known = area.known[rows, columns]
    columns, rows = columns[known], rows[known]
    if not len(rows):
        return Agreement(0.0, 0.0, 0.0, 0)
    distance, depth = area.wall_distance[rows, columns], area.depth[rows, columns]
    # distances are of whole cells: no limit is finer than they can tell
    cell = area.resolution
    inliers = int(np.count_nonzero(distance <= max(INLIER_M, _INLIER_CELLS * cell)))
    off = distance > max(_CONTRADICTION_M, _CONTRADICTION_CELLS * cell)
    contradicted = off & (depth > max(_CONTRADICTION_DEPTH_M, _INLIER_CELLS * cell))
    return Agreement(
        len(rows) / len(points),
        inliers / len(rows),
        float(np.count_nonzero(contradicted)) / len(rows),
        inliers,
    )
