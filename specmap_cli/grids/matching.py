"""The correlative matcher: how well points fit a place, and the pose at which they fit best.

One home for matching scans against scans, scans against grids and grids against grids. A
`ScoreField` holds, per cell, how near the closest obstacle is: exp(-d^2 / 2 sigma^2), so that the
score of points at a pose is in [0, 1] and needs one lookup a point. Poses are `field_from_points`.

Typical use, when the pose is known roughly (`search`) or not at all (`search_everywhere`)::

    field = ScoreField.from_grid(grid)
    match = refine(field, points, search(field, points, guess, Window(1.0, 0.3, 0.1)).pose)

The search is the correlative scan matching of Olson (ICRA 2009), the refinement the Gauss-Newton
step on an interpolated field of Kohlbrecher et al. (SSRR 2011).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray, Pose2, wrap_angle
from specmap_cli.grids.score_field import ScoreField, thinned

__all__ = [
    "Match",
    "ScoreField",
    "Window",
    "covariance",
    "refine",
    "search",
    "search_everywhere",
    "thinned",
]


@dataclass(frozen=True, slots=True)
class Window:
    """Where to search around a guess: +-`distance` metres in x and y, +-`angle` radians.

    Shifts are tried every `step` metres, angles every `angle_step` (None: the angle that moves the
    farther points by one step). A penalty of `distance_penalty` d^2 + `angle_penalty` a^2 for a
    pose d metres and a radians from the guess decides between places that fit alike.
    """

    distance: float
    angle: float
    step: float
    angle_step: float | None = None
    distance_penalty: float = 0.0
    angle_penalty: float = 0.0


@dataclass(frozen=True, slots=True)
class Match:
    """A pose `field_from_points` and its score in [0, 1], any penalty left out."""

    pose: Pose2
    score: float


def search(field: ScoreField, points: NDArray[Any], guess: Pose2, window: Window) -> Match:
    """The best pose of points (N, 2) on the steps of `window` around `guess`, exhaustively.

    Ties go to the pose nearest the guess. With N points, A angles and S shifts the cost is A S N
    lookups. Without points the guess comes back with score 0.
    """
    if not len(points):
        return Match(guess, 0.0)
    shifts, angles = _lattice(points, window, field.resolution)
    penalty = window.distance_penalty * (shifts**2).sum(axis=1)
    best, best_value, best_score = guess, -np.inf, 0.0
    for angle, scores in _lattice_scores(field, points, guess, shifts, angles):
        values = scores - penalty - window.angle_penalty * angle**2
        k = int(values.argmax())
        if values[k] > best_value + 1e-9:
            best_value, best_score = float(values[k]), float(scores[k])
            x, y = guess.x + float(shifts[k, 0]), guess.y + float(shifts[k, 1])
            best = Pose2(x, y, wrap_angle(guess.theta + angle))
    return Match(best, best_score)


def search_everywhere(
    field: ScoreField,
    points: NDArray[Any],
    count: int = 5,
    step: float = 0.2,
    angle_step: float | None = None,
    apart: float = 1.0,
) -> list[Match]:
    """The best `count` poses of points (N, 2) anywhere on the field at any angle, best first.

    A correlation by Fourier transform per angle, on the field pooled to cells of about `step`
    metres: no guess is needed, drift of any size does not matter. The poses are good to about a
    step and are at least `apart` metres (or 0.3 rad) from each other; follow with `search` over
    +- a step, or `refine`. Scores are upper bounds, pooled.
    """
    if not len(points):
        return []
    coarse = field.coarser(max(1, round(step / field.resolution)))
    middle = np.asarray(points).mean(axis=0)
    local = points - middle
    turn = angle_step or _angle_step(local, coarse.resolution)
    found = _correlate(coarse, local, np.arange(0.0, 2 * np.pi, turn), count)
    kept: list[Match] = []
    centres: list[Pose2] = []
    for score, x, y, angle in found:
        centre = Pose2(x, y, wrap_angle(angle))
        if all(_differ(centre, other, apart) for other in centres):
            centres.append(centre)
            kept.append(
                Match(centre @ Pose2(-float(middle[0]), -float(middle[1]), 0.0), min(1.0, score))
            )
        if len(kept) == count:
            break
    return kept


def refine(
    field: ScoreField,
    points: NDArray[Any],
    guess: Pose2,
    iterations: int = 20,
    max_shift: float = 0.3,
) -> Match:
    """The pose near `guess` at which the interpolated field fits points (N, 2) best.

    Gauss-Newton on sum (1 - M(p))^2 with step halving; stops at steps below 0.1 mm. Never farther
    than `max_shift` metres from the guess, never a worse score than the guess's.
    """
    if len(points) < 3:
        return Match(guess, field.score(points, guess))
    pose, cost = guess, _cost(field, points, guess)
    for _ in range(iterations):
        values, jacobian = _interpolate(field, points, pose)
        normal = jacobian.T @ jacobian + 1e-6 * len(points) * np.eye(3)
        step = np.linalg.solve(normal, jacobian.T @ (1.0 - values))
        step *= min(1.0, 0.1 / max(float(np.abs(step).max()), 1e-12))
        for _ in range(4):
            trial = Pose2(
                pose.x + float(step[0]), pose.y + float(step[1]), pose.theta + float(step[2])
            )
            trial_cost = _cost(field, points, trial)
            if trial_cost < cost:
                break
            step = step / 2
        else:
            break
        if math.hypot(trial.x - guess.x, trial.y - guess.y) > max_shift:
            break
        pose, cost = trial, trial_cost
        if float(np.abs(step).max()) < 1e-4:
            break
    best = Pose2(pose.x, pose.y, wrap_angle(pose.theta))
    return Match(best, field.score(points, best))


def covariance(
    field: ScoreField,
    points: NDArray[Any],
    pose: Pose2,
    temperature: float = 0.02,
    distance: float = 0.3,
    angle: float = 0.09,
) -> FloatArray:
    """Covariance (3, 3) of a match, of the score surface around `pose` (Olson 2009, section III).

    Poses on a lattice of +-`distance` metres and +-`angle` radians are weighted by
    exp((score - best) / `temperature`): a corridor comes out long along its axis. Coordinates are
    x, y and theta of the pose in the field's frame.
    """
    window = Window(distance, angle, max(distance / 6, field.resolution), angle / 6)
    shifts, angles = _lattice(points, window, field.resolution)
    poses = np.concatenate([np.column_stack([shifts, np.full(len(shifts), a)]) for a in angles])
    lattice = _lattice_scores(field, points, pose, shifts, angles)
    scores = np.concatenate([row for _, row in lattice])
    weights = np.exp((scores - scores.max()) / temperature)
    weights /= weights.sum()
    centred = poses - weights @ poses
    spread: FloatArray = (centred * weights[:, None]).T @ centred
    return spread


def _lattice(
    points: NDArray[Any], window: Window, resolution: float
) -> tuple[FloatArray, FloatArray]:
    """Shifts (S, 2), whole cells, and angles (A,) of a window, those nearest the guess first."""
    stride = max(1, round(window.step / resolution))
    n = math.ceil(window.distance / (stride * resolution) - 1e-9)
    x, y = np.meshgrid(np.arange(-n, n + 1), np.arange(-n, n + 1))
    cells = np.column_stack([x.ravel(), y.ravel()])
    cells = cells[np.argsort((cells**2).sum(axis=1), kind="stable")]
    shifts = np.asarray(cells * (stride * resolution), dtype=np.float64)
    turn = window.angle_step or _angle_step(points, window.step)
    m = math.ceil(window.angle / turn - 1e-9)
    spacing = window.angle / max(m, 1)
    angles = np.array([0.0] + [s * k * spacing for k in range(1, m + 1) for s in (-1, 1)])
    return shifts, angles


def _angle_step(points: NDArray[Any], step: float) -> float:
    """The angle that moves the point at four fifths of the ranges by one step."""
    far = float(np.percentile(np.sqrt((np.asarray(points) ** 2).sum(axis=1)), 80))
    return min(0.05, max(0.01, step / max(far, 1e-6)))


def _lattice_scores(
    field: ScoreField, points: NDArray[Any], guess: Pose2, shifts: FloatArray, angles: FloatArray
) -> Iterator[tuple[float, FloatArray]]:
    """For each angle the scores (S,) of points (N, 2) at the guess turned by it and shifted."""
    offsets = np.round(shifts / field.resolution).astype(np.intp)
    reach = int(np.abs(offsets).max(initial=0))
    border = 2 * reach + 1
    padded = cv2.copyMakeBorder(
        field.values, border, border, border, border, cv2.BORDER_CONSTANT, value=0.0
    )
    height, width = padded.shape
    flat, jumps = padded.ravel(), offsets[:, 1] * width + offsets[:, 0]
    corner = np.asarray(field.origin) - border * field.resolution
    for angle in angles.tolist():
        placed = Pose2(guess.x, guess.y, guess.theta + angle).apply(points)
        columns, rows = ((placed - corner) / field.resolution).astype(np.intp).T
        # a point too far outside to be shifted onto the field waits on the border of noughts
        np.clip(columns, reach, width - 1 - reach, out=columns)
        np.clip(rows, reach, height - 1 - reach, out=rows)
        cells = jumps[:, None] + (rows * width + columns)[None, :]
        yield angle, flat.take(cells).sum(axis=1, dtype=np.float64) / len(points)


def _correlate(
    coarse: ScoreField, local: FloatArray, angles: FloatArray, count: int
) -> list[tuple[float, float, float, float]]:
    """(score, x, y, angle) of the best places of centred points (N, 2), best first."""
    step = coarse.resolution
    cells = math.ceil(float(np.sqrt((local**2).sum(axis=1)).max()) / step) + 1
    shape = [scipy.fft.next_fast_len(n + 2 * cells, real=True) for n in coarse.values.shape]
    spectrum = scipy.fft.rfft2(coarse.values.astype(np.float64), shape)
    found: list[tuple[float, float, float, float]] = []
    for angle in angles.tolist():
        turned = Pose2(0.0, 0.0, angle).apply(local)
        columns, rows = np.floor(turned / step + 0.5).astype(np.intp).T
        picture = np.zeros(shape)
        np.add.at(picture, (rows % shape[0], columns % shape[1]), 1.0 / len(local))
        product = spectrum * np.conj(scipy.fft.rfft2(picture))
        found.extend(_peaks(scipy.fft.irfft2(product, shape), coarse, count, angle))
    return sorted(found, key=lambda peak: (-peak[0], peak[1:]))


def _differ(a: Pose2, b: Pose2, apart: float) -> bool:
    """Whether two poses are two different answers."""
    turn = abs(wrap_angle(a.theta - b.theta))
    return math.hypot(a.x - b.x, a.y - b.y) >= apart or turn >= 0.3


def _cost(field: ScoreField, points: NDArray[Any], pose: Pose2) -> float:
    """Sum over the points of (1 - interpolated value)^2."""
    values, _ = _interpolate(field, points, pose)
    return float(((1.0 - values) ** 2).sum())


def _peaks(
    correlation: FloatArray, coarse: ScoreField, count: int, angle: float
) -> list[tuple[float, float, float, float]]:
    """(score, x, y, angle) of the highest local maxima of one correlation, highest first."""
    picture = correlation.astype(np.float32)
    highest = cv2.dilate(picture, np.ones((3, 3), dtype=np.uint8))
    places = np.flatnonzero(picture.ravel() >= highest.ravel())
    values = correlation.ravel()[places]
    order = np.lexsort((places, -values))[:count]
    rows, columns = np.divmod(places[order], picture.shape[1])
    height, width = coarse.values.shape
    rows = np.where(rows > (picture.shape[0] + height) // 2, rows - picture.shape[0], rows)
    columns = np.where(
        columns > (picture.shape[1] + width) // 2, columns - picture.shape[1], columns
    )
    x = (columns + 0.5) * coarse.resolution + coarse.origin[0]
    y = (rows + 0.5) * coarse.resolution + coarse.origin[1]
    return [
        (float(v), float(px), float(py), angle)
        for v, px, py in zip(values[order], x, y, strict=True)
    ]


def _interpolate(
    field: ScoreField, points: NDArray[Any], pose: Pose2
) -> tuple[FloatArray, FloatArray]:
    """Bilinear values (N,) under points (N, 2) at `pose`, and their derivative (N, 3) by it."""
    placed = pose.apply(points)
    u = (placed - field.origin) / field.resolution - 0.5
    height, width = field.values.shape
    if min(height, width) < 2:
        return np.zeros(len(u)), np.zeros((len(u), 3))
    inside = np.all((u >= 0) & (u < (width - 1, height - 1)), axis=1)
    base = np.clip(np.floor(u).astype(np.intp), 0, (width - 2, height - 2))
    fx, fy = np.clip(u - base, 0.0, 1.0).T
    start = base[:, 1] * width + base[:, 0]
    flat = field.values.ravel()
    v00, v01 = flat.take(start), flat.take(start + 1)
    v10, v11 = flat.take(start + width), flat.take(start + width + 1)
    low, high = v00 + (v01 - v00) * fx, v10 + (v11 - v10) * fx
    dx = ((v01 - v00) * (1 - fy) + (v11 - v10) * fy) / field.resolution
    dy = (high - low) / field.resolution
    turned = placed - (pose.x, pose.y)
    jacobian = np.column_stack([dx, dy, dy * turned[:, 0] - dx * turned[:, 1]])
    return (low + (high - low) * fy) * inside, jacobian * inside[:, None]
