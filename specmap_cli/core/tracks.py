"""Ways driven: the length of a path, and whether the robot moved far enough to look again."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray, Pose2


def step_lengths(poses: NDArray[Any]) -> FloatArray:
    """(n - 1,) metres from each place of `poses` (n, 2 or more columns) to the next; (0,) of none.

    NaN where one of the two places is not known.
    """
    steps = np.diff(np.asarray(poses, dtype=np.float64)[:, :2], axis=0)
    return np.asarray(np.hypot(steps[:, 0], steps[:, 1]), dtype=np.float64)


def path_length(poses: NDArray[Any]) -> float:
    """Metres along `poses` (n, 2 or more columns)."""
    return float(step_lengths(poses).sum())


def travelled(poses: NDArray[Any]) -> FloatArray:
    """(n,) metres driven from the first of `poses` (n, 2 or more columns) to each of them."""
    way = np.zeros(len(poses))
    np.cumsum(step_lengths(poses), out=way[1:])
    return way


def moved(before: Pose2 | None, now: Pose2, distance_m: float, angle_rad: float) -> bool:
    """Whether the robot drove `distance_m` or turned `angle_rad` since `before`, or more.

    Without a pose before, it has: the first scan always counts.
    """
    if before is None:
        return True
    step = before.inverse() @ now
    return step.distance >= distance_m or abs(step.theta) >= angle_rad
