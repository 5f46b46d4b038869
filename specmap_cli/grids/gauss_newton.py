"""The last centimetres of a match: Gauss-Newton on an interpolated score field.

Kohlbrecher et al., "A Flexible and Scalable SLAM System with Full 3D Motion Estimation" (SSRR
2011), with damping and step halving.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray, Pose2, product, wrap_angle
from specmap_cli.core.records import BoolArray
from specmap_cli.grids.score_field import FieldArray, ScoreField

_FEWEST_POINTS = 3  # as many as unknowns
_DAMPING = 1e-6  # a point, added to the normal matrix: along a single wall it is singular
_LONGEST_STEP = 0.1  # metres and radians: about a sigma, as far as the field is nearly linear
_HALVINGS = 4  # of a step that makes it worse, before giving up
_SHORTEST_STEP = 1e-4  # metres and radians: it ends here, far below a cell
_TINY = 1e-12  # keeps a step of nothing from dividing by zero


def descend(
    field: ScoreField, points: NDArray[Any], guess: Pose2, iterations: int, max_shift_m: float
) -> Pose2:
    """The pose near `guess` at which sum (1 - M(p))^2 over points (N, 2) is least.

    M(p) is the interpolated field under a point. No more than `iterations` steps are made, none of
    which leads farther than `max_shift_m` from the guess or makes the sum larger.
    """
    if len(points) < _FEWEST_POINTS:
        return guess
    pose, here = guess, Sample.of(field, points, guess)
    cost = here.cost()
    for _ in range(iterations):
        step = _step(here)
        for _ in range(_HALVINGS):
            trial = Pose2(*(np.array(pose) + step).tolist())
            there = Sample.of(field, points, trial)
            trial_cost = there.cost()
            if trial_cost < cost:
                break
            step = step / 2
        else:
            break
        if math.hypot(trial.x - guess.x, trial.y - guess.y) > max_shift_m:
            break
        pose, cost, here = trial, trial_cost, there
        if float(np.abs(step).max()) < _SHORTEST_STEP:
            break
    return Pose2(pose.x, pose.y, wrap_angle(pose.theta))


def _step(here: Sample) -> FloatArray:
    """The Gauss-Newton step (3,) from a pose, cut to the longest allowed."""
    jacobian = here.jacobian()
    normal = product(jacobian.T, jacobian) + _DAMPING * len(jacobian) * np.eye(3)
    step = _solved(normal, product(jacobian.T, (1.0 - here.values)[:, None])[:, 0])
    return np.asarray(step * min(1.0, _LONGEST_STEP / max(float(np.abs(step).max()), _TINY)))


def _solved(normal: FloatArray, right: FloatArray) -> FloatArray:
    """The solution (3,) of a symmetric, positive definite (3, 3) system with side `right` (3,).

    L D L^T step by step: LAPACK rounds otherwise on another processor.
    """
    (a, _, _), (b, c, _), (d, e, f) = normal.tolist()
    x, y, z = right.tolist()
    low, last = b / a, d / a
    middle = c - low * b
    side = (e - last * b) / middle
    y -= low * x
    z = (z - last * x - side * y) / (f - last * d - side * side * middle)
    y = y / middle - side * z
    return np.array([x / a - low * y - last * z, y, z])


@dataclass(frozen=True, slots=True, kw_only=True)
class Sample:
    """A field under points at a pose: `values` (N,), 0 outside the outermost cell centres.

    `corners` (4, N) are those of the cells around each point, lower left, lower right, upper left,
    upper right; `share` (2, N) is where it lies between them, `turned` (N, 2) the points about the
    pose, `inside` (N,) whether they lie on the field.
    """

    values: FloatArray
    corners: FieldArray
    share: FloatArray
    turned: FloatArray
    inside: BoolArray
    cell_m: float

    @classmethod
    def of(cls, field: ScoreField, points: NDArray[Any], pose: Pose2) -> Sample:
        """Looked up at points (N, 2)."""
        placed = pose.apply(points)
        u = (placed - field.origin) / field.resolution - 0.5
        height, width = field.values.shape
        if min(height, width) == 1:  # nothing lies between the centres of cells
            inside, base = np.zeros(len(u), dtype=bool), np.zeros((len(u), 2), dtype=np.intp)
        else:
            inside = np.all((u >= 0) & (u < (width - 1, height - 1)), axis=1)
            base = np.clip(np.floor(u).astype(np.intp), 0, (width - 2, height - 2))
        fx, fy = share = np.clip(u - base, 0.0, 1.0).T
        start = base[:, 1] * width + base[:, 0]
        flat = field.values.ravel()
        ends = np.array([[0], [1], [width], [width + 1]])
        corners = flat.take(start + ends, mode="clip")
        v00, v01, v10, v11 = corners
        low, high = v00 + (v01 - v00) * fx, v10 + (v11 - v10) * fx
        return cls(
            values=(low + (high - low) * fy) * inside,
            corners=corners,
            share=share,
            turned=placed - (pose.x, pose.y),
            inside=inside,
            cell_m=field.resolution,
        )

    def cost(self) -> float:
        """Sum over the points of (1 - value)^2."""
        return float(((1.0 - self.values) ** 2).sum())

    def jacobian(self) -> FloatArray:
        """(N, 3) derivatives of the values by the pose."""
        (v00, v01, v10, v11), (fx, fy), turned = self.corners, self.share, self.turned.T
        low, high = v00 + (v01 - v00) * fx, v10 + (v11 - v10) * fx
        dx = ((v01 - v00) * (1 - fy) + (v11 - v10) * fy) / self.cell_m
        dy = (high - low) / self.cell_m
        columns = np.column_stack([dx, dy, dy * turned[0] - dx * turned[1]])
        return columns * self.inside[:, None]
