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
import scipy.fft
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray, Pose2, wrap_angle
from specmap_cli.core.sampling import evenly
from specmap_cli.grids.matching import refine
from specmap_cli.recognition.closure.prepared import COARSE_M, ImageArray, Place

_SLACKS_RAD = (0.0, math.radians(-3.0), math.radians(3.0))
_PEAKS = 8
_REFINED = 3
_HOPELESS = 0.3
_SURE = 0.8
_REFINE_POINTS = 160
_FINAL_POINTS = 1000
_INLIER_M = 0.15
_DEEP_M = 0.25
_CLEAR_M = 0.3


@dataclass(frozen=True, slots=True)
class Check:
    """The best transform between two grids and how well they agree under it.

    `score` is the smaller share of inliers less twice the larger share of contradictions, at most
    1; `inliers` the smaller count of wall points confirmed; `overlap` and `least_overlap` the
    larger and the smaller share of a place's walls that the other one knows about; `lead` how much
    better it is than the next best transform that is a different one.
    """

    old_from_new: Pose2
    score: float
    inliers: int
    overlap: float
    least_overlap: float
    lead: float = 0.0


def verify(old: Place, new: Place) -> Check | None:
    """The best transform between two places and its judgement; None when nothing overlaps.

    Directions of walls are taken as they are first; when that looks promising but not right, they
    are tried a few degrees off as well.
    """
    best = _best(old, new, _SLACKS_RAD[:1])
    if best is not None and _HOPELESS <= best.score < _SURE:
        slack = _best(old, new, _SLACKS_RAD)
        best = slack if slack is not None and _rank(slack) > _rank(best) else best
    return best


def _best(old: Place, new: Place, slacks: Sequence[float]) -> Check | None:
    """The best transform whose rotation is within the slacks of aligned walls."""
    points = evenly(new.walls, _REFINE_POINTS)
    guesses = _candidates(old, new, slacks)
    likely = np.argsort([-old.wide.score(points, guess) for guess in guesses], kind="stable")
    checks = []
    for k in likely[:_REFINED]:
        match = refine(old.field, points, guesses[k], iterations=6, max_shift=0.6)
        checks.append(judge(old, new, match.pose))
    if not checks:
        return None
    checks.sort(key=_rank, reverse=True)
    best = checks[0]
    if best.score < _HOPELESS:
        return best
    points = evenly(new.walls, _FINAL_POINTS)
    match = refine(old.field, points, best.old_from_new, iterations=15, max_shift=0.2)
    final = judge(old, new, match.pose)
    centre = new.coarse_walls.mean(axis=0)
    rivals = [c for c in checks[1:] if _apart(c.old_from_new, best.old_from_new, centre, 1.0, 10.0)]
    lead = _rank(best) - max((_rank(rival) for rival in rivals), default=-1.0)
    return replace(final if final.score >= best.score else best, lead=lead)


def judge(old: Place, new: Place, old_from_new: Pose2) -> Check:
    """How well two places agree under a given transform."""
    inlier, contra, inliers, overlap = _agreement(old, old_from_new.apply(new.walls))
    back = _agreement(new, old_from_new.inverse().apply(old.walls))
    score = min(inlier, back[0]) - 2.0 * max(contra, back[1])
    overlaps = overlap, back[3]
    return Check(old_from_new, score, min(inliers, back[2]), max(overlaps), min(overlaps))


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


def _rank(check: Check) -> float:
    """What decides between transforms: agreement, and how much of the walls it covers."""
    return check.score * math.sqrt(check.overlap) if check.score > 0.0 else check.score - 1.0


def _agreement(place: Place, points: FloatArray) -> tuple[float, float, int, float]:
    """Shares of inliers and of contradictions among the points in known area, the count of
    inliers, and the share of all points in known area.
    """
    cells = np.floor((points - place.origin) / place.resolution).astype(np.intp)
    height, width = place.known.shape
    inside = ((cells >= 0) & (cells < (width, height))).all(axis=1)
    columns, rows = cells[inside].T
    known = place.known[rows, columns]
    columns, rows = columns[known], rows[known]
    if not len(rows):
        return 0.0, 0.0, 0, 0.0
    distance = place.wall_distance[rows, columns]
    inliers = int(np.count_nonzero(distance <= _INLIER_M))
    contradicted = (distance > _CLEAR_M) & (place.depth[rows, columns] > _DEEP_M)
    return (
        inliers / len(rows),
        float(np.count_nonzero(contradicted)) / len(rows),
        inliers,
        len(rows) / len(points),
    )


def _candidates(old: Place, new: Place, slacks: Sequence[float]) -> list[Pose2]:
    """The most promising transforms old_from_new, best first."""
    aligned = old.direction - new.direction
    centre = new.coarse_walls.mean(axis=0)
    found: list[tuple[float, Pose2]] = []
    for angle in (aligned + k * math.pi / 2 + slack for k in range(4) for slack in slacks):
        turn = Pose2(0.0, 0.0, wrap_angle(angle))
        correlation = _correlate(
            old, turn.apply(new.coarse_walls - centre), turn.apply(new.coarse_free - centre)
        )
        for value, x, y in _peaks(correlation, old.target.shape):
            at = Pose2(x + old.coarse_origin[0], y + old.coarse_origin[1], turn.theta)
            found.append((value, at @ Pose2(-float(centre[0]), -float(centre[1]), 0.0)))
    found.sort(key=lambda item: -item[0])
    kept: list[Pose2] = []
    for _, pose in found:
        if all(_apart(pose, other, centre, 0.5, 2.0) for other in kept):
            kept.append(pose)
        if len(kept) == _PEAKS:
            break
    return kept


def _correlate(old: Place, walls: FloatArray, free: FloatArray) -> ImageArray:
    """How well walls (N, 2) and free space (M, 2) of another place, turned and centred, fall on an
    old place, for every shift in coarse cells; periodic, with room enough not to wrap.
    """
    reach = 2 * np.ceil(np.abs(np.vstack([walls, free])).max(axis=0) / COARSE_M).astype(int) + 3
    rows, columns = old.target.shape
    shape = [
        scipy.fft.next_fast_len(rows + int(reach[1]), real=True),
        scipy.fft.next_fast_len(columns + int(reach[0]), real=True),
    ]
    pictures = np.stack([_picture(walls, shape), _picture(free, shape)])
    moved = np.conj(scipy.fft.rfft2(pictures))
    product = scipy.fft.rfft2(old.target, shape) * moved[0]
    product -= 0.5 * scipy.fft.rfft2(old.obstacles, shape) * moved[1]
    return np.asarray(scipy.fft.irfft2(product, shape), dtype=np.float32)


def _picture(points: FloatArray, shape: list[int]) -> ImageArray:
    """Points (N, 2) on a periodic coarse image whose cell [0, 0] is centred on the origin."""
    columns, rows = np.floor(points / COARSE_M + 0.5).astype(np.intp).T
    flat = (rows % shape[0]) * shape[1] + columns % shape[1]
    counts = np.bincount(flat, minlength=shape[0] * shape[1])
    return np.minimum(counts, 1).astype(np.float32).reshape(shape)


def _peaks(
    correlation: ImageArray, size: tuple[int, ...], count: int = 2
) -> list[tuple[float, float, float]]:
    """(value, x, y) of the highest places of a correlation, 1 m apart, from the image's corner."""
    correlation = correlation.copy()
    height, width = correlation.shape
    suppressed = round(1.0 / COARSE_M)
    found: list[tuple[float, float, float]] = []
    for _ in range(count):
        row, column = divmod(int(correlation.argmax()), width)
        value = float(correlation[row, column])
        near_rows = np.arange(row - suppressed, row + suppressed + 1) % height
        near_columns = np.arange(column - suppressed, column + suppressed + 1) % width
        correlation[np.ix_(near_rows, near_columns)] = -np.inf
        row -= height if row > (height + size[0]) // 2 else 0
        column -= width if column > (width + size[1]) // 2 else 0
        found.append((value, (column + 0.5) * COARSE_M, (row + 0.5) * COARSE_M))
    return found


def _apart(a: Pose2, b: Pose2, centre: FloatArray, metres: float, degrees: float) -> bool:
    """Whether two transforms place `centre` (2,) some metres, or turn some degrees, apart."""
    shift = a.apply(centre[None])[0] - b.apply(centre[None])[0]
    turn = abs(wrap_angle(a.theta - b.theta))
    return math.hypot(*shift.tolist()) > metres or turn > math.radians(degrees)
