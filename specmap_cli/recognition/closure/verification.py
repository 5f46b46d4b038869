"""Do two grids show the same place? A global search without pose prior, and a judgement.

Rotations come from the directions of the walls, translations from a correlation by Fourier
transform of walls with walls and of free space with walls, the best few are refined. The
judgement counts the wall points of each grid that the other one confirms, less twice those that
stand where the other saw free space: a right transform contradicts nothing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray, Pose2, wrap_angle
from specmap_cli.core.sampling import evenly
from specmap_cli.core.settings import RecognitionConfig
from specmap_cli.grids.correlation import Target, cell_counts, peaks
from specmap_cli.grids.matching import refine
from specmap_cli.recognition.closure.prepared import CoarseGrid, KnownArea, PreparedGrid

_CONTRADICTION_WEIGHT = 2.0  # separates right from wrong transforms of fr079 without an error
# A wall may be drawn one cell beside where it is, or two where a turned grid is laid on another.
_INLIER_CELLS, _CONTRADICTION_CELLS = 1.0, 2.5
# How much is tried: more of each takes longer and found nothing more on fr079 and simulated tours.
_SLACK_RAD = math.radians(3.0)  # the direction of few walls is good to a few degrees
# Stairs of coarse cells bend that direction: by 22 degrees on simulated rooms in cells of 0.25 m.
_FINE_CELL_M, _CELL_M_PER_SLACK = 0.05, 0.025
_PEAKS_PER_ROTATION = 2
_PEAKS_APART_M = 1.0
_TRANSFORMS = 8
_REFINED = 3
# Points and shift of the refinement: first from a coarse cell away, then for the last centimetres.
_ROUGH_POINTS, _ROUGH_STEPS, _ROUGH_SHIFT_M = 160, 6, 0.6
_FINE_POINTS, _FINE_STEPS, _FINE_SHIFT_M = 1000, 15, 0.2
# Transforms farther apart are different ones to try, and rivals when both fit.
_DIFFERENT_M, _DIFFERENT_RAD = 0.5, math.radians(2.0)
_RIVAL_M, _RIVAL_RAD = 1.0, math.radians(10.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """The best transform between two grids and how well they agree under it.

    `score` is the smaller share of inliers less twice the larger share of contradictions, at most
    1; `confirmed_m` the smaller length of wall confirmed, metres; `overlap` and `least_overlap` the
    larger and the smaller share of a grid's walls that the other one knows about; `lead` how much
    better it is than the next best transform that is a different one.
    """

    old_from_new: Pose2
    score: float
    confirmed_m: float
    overlap: float
    least_overlap: float
    lead: float = 0.0


def verify(old: PreparedGrid, new: PreparedGrid, config: RecognitionConfig) -> Check | None:
    """The best transform between two grids and its judgement; None when nothing overlaps.

    Directions of walls are taken as they are first; when that looks promising but not right, they
    are tried a few degrees off as well.
    """
    steps = _slack_steps(old, new)
    best = _best(old, new, _slacks(steps), config)
    if best is not None and config.hopeless_score <= best.score < config.sure_score:
        other = _best(old, new, _slacks(steps + 1), config)
        best = other if other is not None and _rank(other) > _rank(best) else best
    return best


def judge(
    old: PreparedGrid, new: PreparedGrid, old_from_new: Pose2, config: RecognitionConfig
) -> Check:
    """How well two grids agree under a given transform."""
    there = _agreement(old.area, old_from_new.apply(new.walls), config)
    back = _agreement(new.area, old_from_new.inverse().apply(old.walls), config)
    contradicted = max(there.contradicted, back.contradicted)
    return Check(
        old_from_new=old_from_new,
        score=min(there.confirmed, back.confirmed) - _CONTRADICTION_WEIGHT * contradicted,
        confirmed_m=min(there.inliers * new.metres_a_point, back.inliers * old.metres_a_point),
        overlap=max(there.known, back.known),
        least_overlap=min(there.known, back.known),
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


def _best(
    old: PreparedGrid, new: PreparedGrid, slacks: Sequence[float], config: RecognitionConfig
) -> Check | None:
    """The best transform whose rotation is within the slacks of aligned walls."""
    points = evenly(new.walls, _ROUGH_POINTS)
    guesses = _candidates(old, new, slacks)
    likely = np.argsort([-old.wide.score(points, guess) for guess in guesses], kind="stable")
    checks = []
    for k in likely[:_REFINED]:
        match = refine(old.field, points, guesses[k], _ROUGH_STEPS, _ROUGH_SHIFT_M)
        checks.append(judge(old, new, match.pose, config))
    if not checks:
        return None
    checks.sort(key=_rank, reverse=True)
    best = checks[0]
    if best.score < config.hopeless_score:
        return best
    points = evenly(new.walls, _FINE_POINTS)
    match = refine(old.field, points, best.old_from_new, _FINE_STEPS, _FINE_SHIFT_M)
    final = judge(old, new, match.pose, config)
    lead = _lead(checks, new.coarse.walls.mean(axis=0))
    return replace(final if final.score >= best.score else best, lead=lead)


def _slack_steps(old: PreparedGrid, new: PreparedGrid) -> int:
    """How many steps to either side of aligned walls are tried at once, for the size of cells."""
    cell_m = max(old.area.resolution, new.area.resolution)
    return max(0, int((cell_m - _FINE_CELL_M) / _CELL_M_PER_SLACK))


def _slacks(steps: int) -> tuple[float, ...]:
    """Rotations off that of aligned walls, the smallest first, radians."""
    return (0.0, *(sign * k * _SLACK_RAD for k in range(1, steps + 1) for sign in (-1.0, 1.0)))


def _lead(checks: Sequence[Check], centre: FloatArray) -> float:
    """How much better the first of some checks is than the best that is a different transform.

    They are different when they place `centre` (2,) of the new grid elsewhere, or turn it.
    """
    best = checks[0]
    rivals = [
        check
        for check in checks[1:]
        if _apart(check.old_from_new, best.old_from_new, centre, _RIVAL_M, _RIVAL_RAD)
    ]
    return _rank(best) - max((_rank(rival) for rival in rivals), default=-1.0)


def _rank(check: Check) -> float:
    """What decides between transforms: agreement, and how much of the walls it covers."""
    return check.score * math.sqrt(check.overlap) if check.score > 0.0 else check.score - 1.0


@dataclass(frozen=True, slots=True)
class _Agreement:
    """Of points on walls: the share in a known area, and of these the shares that it confirms and
    contradicts, and the count of those confirmed.
    """

    known: float
    confirmed: float
    contradicted: float
    inliers: int


def _agreement(area: KnownArea, points: FloatArray, config: RecognitionConfig) -> _Agreement:
    """What an area says to points (N, 2) on walls, in its grid's frame."""
    cells = np.floor((points - area.origin) / area.resolution).astype(np.intp)
    height, width = area.known.shape
    inside = ((cells >= 0) & (cells < (width, height))).all(axis=1)
    columns, rows = cells[inside].T
    known = area.known[rows, columns]
    columns, rows = columns[known], rows[known]
    if not len(rows):
        return _Agreement(0.0, 0.0, 0.0, 0)
    distance, depth = area.wall_distance[rows, columns], area.depth[rows, columns]
    # distances are of whole cells: no limit is finer than they can tell
    cell = area.resolution
    inliers = int(np.count_nonzero(distance <= max(config.inlier_m, _INLIER_CELLS * cell)))
    off = distance > max(config.contradiction_m, _CONTRADICTION_CELLS * cell)
    contradicted = off & (depth > max(config.contradiction_depth_m, _INLIER_CELLS * cell))
    return _Agreement(
        len(rows) / len(points),
        inliers / len(rows),
        float(np.count_nonzero(contradicted)) / len(rows),
        inliers,
    )


def _candidates(old: PreparedGrid, new: PreparedGrid, slacks: Sequence[float]) -> list[Pose2]:
    """The most promising transforms old_from_new, best first."""
    aligned = old.direction - new.direction
    centre = new.coarse.walls.mean(axis=0)
    found: list[tuple[float, Pose2]] = []
    for angle in (aligned + k * math.pi / 2 + slack for k in range(4) for slack in slacks):
        found.extend(_shifts(old.coarse, new.coarse, centre, wrap_angle(angle)))
    found.sort(key=lambda item: -item[0])
    # of many rotations, neighbours of the best must not crowd out the rivals that `lead` needs
    many = _slack_steps(old, new) > 0
    metres, radians = (_RIVAL_M, _RIVAL_RAD) if many else (_DIFFERENT_M, _DIFFERENT_RAD)
    kept: list[Pose2] = []
    for _, pose in found:
        if all(_apart(pose, other, centre, metres, radians) for other in kept):
            kept.append(pose)
        if len(kept) == _TRANSFORMS:
            break
    return kept


def _shifts(
    old: CoarseGrid, new: CoarseGrid, centre: FloatArray, angle: float
) -> list[tuple[float, Pose2]]:
    """The best transforms old_from_new of one rotation about `centre` (2,), with their values.

    Walls and free space of the new grid, turned, are laid on the old one at every shift in cells.
    """
    turn, cell = Pose2(0.0, 0.0, angle), old.cell_m
    parts = turn.apply(new.walls - centre), turn.apply(new.free - centre)
    # to both sides, and what rounding to cells adds
    reach = 2 * np.ceil(np.abs(np.vstack(parts)).max(axis=0) / cell).astype(int) + 3
    target = Target.of(old.layers, (int(reach[1]), int(reach[0])))
    pictures = [np.minimum(cell_counts(points, cell, target.shape), 1) for points in parts]
    correlation = target.correlate(np.stack(pictures).astype(np.float32))
    apart = round(_PEAKS_APART_M / cell)
    shifts = []
    for peak in peaks(correlation, target.size, cell, _PEAKS_PER_ROTATION, apart):
        at = Pose2(peak.x + old.origin[0], peak.y + old.origin[1], angle)
        shifts.append((peak.value, at @ Pose2(-float(centre[0]), -float(centre[1]), 0.0)))
    return shifts


def _apart(a: Pose2, b: Pose2, centre: FloatArray, metres: float, radians: float) -> bool:
    """Whether two transforms place `centre` (2,) farther apart than this, or turn it further."""
    shift = a.apply(centre[None])[0] - b.apply(centre[None])[0]
    turn = abs(wrap_angle(a.theta - b.theta))
    return math.hypot(*shift.tolist()) > metres or turn > radians
