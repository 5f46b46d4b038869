"""Gauss-Newton on an interpolated score field: the way to a match, and its last centimetres.

Kohlbrecher et al., "A Flexible and Scalable SLAM System with Full 3D Motion Estimation" (SSRR
2011), with damping and step halving.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray, Pose2, product, wrap_angle
from specmap_cli.grids.score_field import ScoreField

Step = tuple[float, float, float]  # metres, metres, radians

_FEWEST_POINTS = 3  # as many as unknowns
_DAMPING = 1e-6  # a point, added to the normal matrix: along a single wall it is singular
_LONGEST_STEP = 0.1  # metres and radians: about a sigma, as far as the field is nearly linear
_HALVINGS = 4  # of a step that makes it worse, before giving up
_SHORTEST_STEP = 1e-4  # metres and radians: it ends here, far below a cell
_TINY = 1e-12  # keeps a step of nothing from dividing by zero
# Of the way to a match. A point on a slope adds some 20 a square metre to the normal matrix: so one
# that is damped by 0.2 a point stays where it is guessed along what a hundredth of the points fix.
_WAY_DAMPING = 0.2
_WAY_STEPS = 6
_NEAR_STEP = 1e-3  # metres and radians: what follows mends as much


def descend(
    field: ScoreField, points: NDArray[Any], guess: Pose2, iterations: int, max_shift_m: float
) -> Pose2:
    """The pose near `guess` at which sum (1 - M(p))^2 over points (N, 2) is least.

    M(p) is the interpolated field under a point. No more than `iterations` steps are made, none of
    which leads farther than `max_shift_m` from the guess or makes the sum larger.
    """
    if len(points) < _FEWEST_POINTS:
        return guess
    columns = np.ascontiguousarray(points.T)
    pose, here = guess, Sample.of(field, columns, guess)
    cost = here.cost()
    for _ in range(iterations):
        step = _step(here, _DAMPING)
        for _ in range(_HALVINGS):
            trial = _moved(pose, step)
            there = Sample.of(field, columns, trial)
            trial_cost = there.cost()
            if trial_cost < cost:
                break
            step = (step[0] / 2, step[1] / 2, step[2] / 2)
        else:
            break
        if math.hypot(trial.x - guess.x, trial.y - guess.y) > max_shift_m:
            break
        pose, cost, here = trial, trial_cost, there
        if _size(step) < _SHORTEST_STEP:
            break
    return Pose2(pose.x, pose.y, wrap_angle(pose.theta))


def approach(field: ScoreField, points: NDArray[Any], guess: Pose2, sigma_m: float) -> Pose2:
    """A pose some millimetres from where points (N, 2) fit a field of `sigma_m`, from a near guess.

    A few quick steps, of which nothing is promised: look at the score where they end. The field
    counts with half its sigma once the steps are shorter than that.
    """
    if len(points) < _FEWEST_POINTS:
        return guess
    columns = np.ascontiguousarray(points.T)
    pose, sharp = guess, False
    for _ in range(_WAY_STEPS):
        here = Sample.of(field, columns, pose)
        step = _step(here.sharper() if sharp else here, _WAY_DAMPING)
        pose = _moved(pose, step)
        if sharp and _size(step) < _NEAR_STEP:
            break
        sharp = sharp or _size(step) < sigma_m / 2
    return Pose2(pose.x, pose.y, wrap_angle(pose.theta))


def _moved(pose: Pose2, step: Step) -> Pose2:
    return Pose2(pose.x + step[0], pose.y + step[1], pose.theta + step[2])


def _size(step: Step) -> float:
    """The largest part of a step, metres or radians."""
    return max(abs(step[0]), abs(step[1]), abs(step[2]))


def _step(here: Sample, damping: float) -> Step:
    """The Gauss-Newton step from a pose, cut to the longest allowed."""
    equations = here.equations()
    sums = product(equations, equations.T).tolist()
    step = _solved(sums, damping * equations.shape[1])
    share = min(1.0, _LONGEST_STEP / max(_size(step), _TINY))
    return step[0] * share, step[1] * share, step[2] * share


def _solved(sums: Sequence[Sequence[float]], damping: float) -> Step:
    """The solution of a symmetric, positive definite system.

    Of `sums` (4, 4) the upper left (3, 3) is the matrix, its diagonal to be damped, and the last
    row the right side. L D L^T step by step: LAPACK rounds otherwise on another processor.
    """
    (a, *_), (b, c, *_), (d, e, f, _), (x, y, z, _) = sums
    a, c, f = a + damping, c + damping, f + damping
    low, last = b / a, d / a
    middle = c - low * b
    side = (e - last * b) / middle
    y -= low * x
    z = (z - last * x - side * y) / (f - last * d - side * side * middle)
    y = y / middle - side * z
    return x / a - low * y - last * z, y, z


@dataclass(frozen=True, slots=True, kw_only=True)
class Sample:
    """A field under N points at a pose; all is 0 outside the outermost cell centres.

    `values` (N,), their `slopes` (2, N) a metre in x and y, and `turned` (2, N), the points about
    the pose.
    """

    values: FloatArray
    slopes: FloatArray
    turned: FloatArray

    @classmethod
    def of(cls, field: ScoreField, points: NDArray[Any], pose: Pose2) -> Sample:
        """Looked up at points (2, N), their x above their y: by rows it is twice as quick."""
        cell_m, (x, y) = field.resolution, field.origin
        height, width = field.values.shape
        turned = product(pose.rotation(), points)
        u = turned / cell_m
        u += [[(pose.x - x) / cell_m - 0.5], [(pose.y - y) / cell_m - 0.5]]
        last = np.array([[width - 1.0], [height - 1.0]])
        on = (u >= 0.0) & (u < last)  # nothing is, where nothing lies between the centres of cells
        base = np.maximum(np.minimum(np.floor(u), last - 1.0), 0.0)
        fx, fy = np.minimum(np.maximum(u - base, 0.0), 1.0)
        start = (base[1] * width + base[0]).astype(np.intp)
        corners = field.values.ravel().take(start + _corners(width), mode="clip")
        rise = corners[2:] - corners[:2]
        low, high = corners[:2] + rise * fx
        slopes = np.stack([rise[0] + (rise[1] - rise[0]) * fy, high - low])
        inside = on[0] & on[1]
        values = (low + slopes[1] * fy) * inside
        slopes *= inside / cell_m
        return cls(values=values, slopes=slopes, turned=turned)

    def sharper(self) -> Sample:
        """The same in the field with half its sigma: the fourth power of its values."""
        cube = self.values * self.values * self.values
        return Sample(
            values=cube * self.values, slopes=4.0 * cube * self.slopes, turned=self.turned
        )

    def cost(self) -> float:
        """Sum over the points of (1 - value)^2."""
        missing = 1.0 - self.values
        return float((missing * missing).sum())

    def equations(self) -> FloatArray:
        """(4, N) derivatives of the values by x, y and turn, and what the values miss to one."""
        (dx, dy), (x, y) = self.slopes, self.turned
        rows = np.empty((4, len(x)))
        rows[:2] = self.slopes
        np.subtract(dy * x, dx * y, out=rows[2])
        np.subtract(1.0, self.values, out=rows[3])
        return rows


@cache
def _corners(width: int) -> NDArray[np.intp]:
    """(4, 1) places of the cells around a point from the lower left one: left ones, right ones."""
    return np.array([[0], [width], [1], [width + 1]])
