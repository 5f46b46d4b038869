"""Driving a path: limited speed, acceleration and turn rate, turns in place at sharp corners."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray, wrap_angles

_ACCELERATION = 0.5  # m/s^2
_SHARP_RAD = 0.35  # a corner the robot stops for
_TURN_STEP_RAD = 0.1


@dataclass(frozen=True, slots=True)
class Drive:
    """Poses over time: `times_s` (k,) ascending from 0 and `poses` (k, 3), angles unwrapped."""

    times_s: FloatArray
    poses: FloatArray

    @property
    def duration_s(self) -> float:
        """When the robot arrives."""
        return float(self.times_s[-1])

    def at(self, times_s: NDArray[Any]) -> FloatArray:
        """Poses (..., 3) at any times, the robot standing before the first and after the last."""
        times = np.asarray(times_s, dtype=np.float64)
        columns = [np.interp(times, self.times_s, self.poses[:, axis]) for axis in range(3)]
        return np.stack(columns, axis=-1)


def drive(path: FloatArray, speed_mps: float, turn_rate: float) -> Drive:
    """Drive along a path (N, 2) of at least two points; `turn_rate` in radians a second."""
    steps = np.diff(path, axis=0)
    lengths = np.hypot(steps[:, 0], steps[:, 1])
    path, steps, lengths = _without_repeats(path, steps, lengths)
    if len(path) < 2:
        return Drive(np.zeros(1), np.array([[path[0, 0], path[0, 1], 0.0]]))
    heading = np.arctan2(steps[:, 1], steps[:, 0])
    turns = wrap_angles(np.diff(heading))
    heading = heading[0] + np.concatenate([[0.0], np.cumsum(turns)])
    sharp = np.abs(turns) > _SHARP_RAD
    # headings in which each inner corner is reached and left: equal unless the robot turns there
    middle = heading[:-1] + 0.5 * turns
    reached = np.concatenate([np.where(sharp, heading[:-1], middle), heading[-1:]])
    left = np.concatenate([heading[:1], np.where(sharp, heading[1:], middle)])
    bend = np.abs(reached - left)
    limit = np.minimum(speed_mps, turn_rate * lengths / np.maximum(bend, 1e-9))
    corner = np.minimum(limit[:-1], limit[1:])
    speeds = np.concatenate([[0.0], np.where(sharp, 0.0, corner), [0.0]])
    seconds = _durations(_accelerated(speeds, lengths), lengths)
    return _knots(path, reached, left, seconds, turn_rate)


def _without_repeats(
    path: FloatArray, steps: FloatArray, lengths: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    kept = lengths > 1e-9
    return np.concatenate([path[:1], path[1:][kept]]), steps[kept], lengths[kept]


def _accelerated(speeds: FloatArray, lengths: FloatArray) -> FloatArray:
    """The speeds (N,) lowered so that neither speeding up nor braking passes the acceleration."""
    result = speeds.copy()
    for i in range(1, len(result)):
        reachable = math.sqrt(result[i - 1] ** 2 + 2.0 * _ACCELERATION * lengths[i - 1])
        result[i] = min(result[i], reachable)
    for i in range(len(result) - 2, -1, -1):
        stoppable = math.sqrt(result[i + 1] ** 2 + 2.0 * _ACCELERATION * lengths[i])
        result[i] = min(result[i], stoppable)
    return result


def _durations(speeds: FloatArray, lengths: FloatArray) -> FloatArray:
    """Seconds (N - 1,) from point to point; from standstill to standstill by way of a peak."""
    both = speeds[:-1] + speeds[1:]
    peaked = 2.0 * np.sqrt(lengths / _ACCELERATION)
    return np.where(both > 0.0, 2.0 * lengths / np.maximum(both, 1e-9), peaked)


def _knots(
    path: FloatArray,
    reached: FloatArray,
    left: FloatArray,
    seconds: FloatArray,
    turn_rate: float,
) -> Drive:
    """The drive through all corners, with eased turns where a corner is left in another heading."""
    times, poses = [np.zeros(1)], [np.array([[*path[0], left[0]]])]
    now = 0.0
    for i, second in enumerate(seconds):
        now += float(second)
        times.append(np.array([now]))
        poses.append(np.array([[*path[i + 1], reached[i]]]))
        turn = float(left[i + 1] - reached[i]) if i + 1 < len(left) else 0.0
        if turn == 0.0:
            continue
        share = np.linspace(0.0, 1.0, math.ceil(abs(turn) / _TURN_STEP_RAD) + 1)[1:]
        eased = share * share * (3.0 - 2.0 * share)  # its steepest slope is 1.5
        duration = 1.5 * abs(turn) / turn_rate
        times.append(now + duration * share)
        still = np.tile(path[i + 1], (len(share), 1))
        poses.append(np.column_stack([still, reached[i] + turn * eased]))
        now += duration
    return Drive(np.concatenate(times), np.concatenate(poses))
