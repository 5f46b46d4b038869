"""Driving a path: limited speed, acceleration and turn rate, turns in place at sharp corners."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray, step_lengths, wrap_angles
from specmap_cli.grids.gridmap import BoolArray

_SHARP_RAD = 0.35  # 20 degrees: the robot stops and turns at sharper corners, and rounds others
_TURN_STEP_RAD = 0.1  # a turn in place is told by poses this far apart
# The ease-in, ease-out curve 3 s^2 - 2 s^3 of a turn in place is steepest in its middle: 1.5.
_EASE_PEAK = 1.5
_TINY = 1e-9  # metres, radians or metres a second that count as none


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


@dataclass(frozen=True, slots=True)
class Limits:
    """What the robot's wheels can do; all are above 0."""

    speed_mps: float
    turn_rate_radps: float
    acceleration_mps2: float


def drive(path: FloatArray, limits: Limits) -> Drive:
    """Drive along a path (N, 2), N >= 1, as fast as the limits let the robot.

    It starts and ends at a standstill, looks where it drives, and turns in place at sharp corners.
    A path of one place is a robot that stands there, its heading 0.
    """
    path = path[np.concatenate([[True], step_lengths(path) > _TINY])]
    if len(path) < 2:
        return Drive(np.zeros(1), np.array([[path[0, 0], path[0, 1], 0.0]]))
    lengths = step_lengths(path)
    reached, left, sharp = _headings(path)
    bend = np.abs(reached - left)
    limit = np.minimum(limits.speed_mps, limits.turn_rate_radps * lengths / np.maximum(bend, _TINY))
    corner = np.minimum(limit[:-1], limit[1:])
    speeds = np.concatenate([[0.0], np.where(sharp, 0.0, corner), [0.0]])
    speeds = _accelerated(speeds, lengths, limits.acceleration_mps2)
    seconds = _durations(speeds, lengths, limits)
    return _knots(path, reached, left, seconds, limits.turn_rate_radps)


def _headings(path: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Headings at the end (N - 1,) and at the start (N - 1,) of each step, and the sharp corners.

    The heading in which an inner corner is reached is that in which it is left, unless the robot
    turns there: `sharp` (N - 2,).
    """
    steps = np.diff(path, axis=0)
    heading = np.arctan2(steps[:, 1], steps[:, 0])
    turns = wrap_angles(np.diff(heading))
    heading = heading[0] + np.concatenate([[0.0], np.cumsum(turns)])
    sharp = np.abs(turns) > _SHARP_RAD
    middle = heading[:-1] + 0.5 * turns
    reached = np.concatenate([np.where(sharp, heading[:-1], middle), heading[-1:]])
    left = np.concatenate([heading[:1], np.where(sharp, heading[1:], middle)])
    return reached, left, sharp


def _accelerated(speeds: FloatArray, lengths: FloatArray, acceleration: float) -> FloatArray:
    """The speeds (N,) lowered so that neither speeding up nor braking passes the acceleration."""
    result = speeds.copy()
    for i in range(1, len(result)):
        reachable = math.sqrt(result[i - 1] ** 2 + 2.0 * acceleration * lengths[i - 1])
        result[i] = min(result[i], reachable)
    for i in range(len(result) - 2, -1, -1):
        stoppable = math.sqrt(result[i + 1] ** 2 + 2.0 * acceleration * lengths[i])
        result[i] = min(result[i], stoppable)
    return result


def _durations(speeds: FloatArray, lengths: FloatArray, limits: Limits) -> FloatArray:
    """Seconds (N - 1,) from point to point; from standstill to standstill by way of a peak."""
    both = speeds[:-1] + speeds[1:]
    highest, acceleration = limits.speed_mps, limits.acceleration_mps2
    peaked = 2.0 * np.sqrt(lengths / acceleration)
    coasting = lengths / highest + highest / acceleration
    stopped = np.where(lengths * acceleration > highest**2, coasting, peaked)
    return np.where(both > 0.0, 2.0 * lengths / np.maximum(both, _TINY), stopped)


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
        eased = share * share * (3.0 - 2.0 * share)
        duration = _EASE_PEAK * abs(turn) / turn_rate
        times.append(now + duration * share)
        still = np.tile(path[i + 1], (len(share), 1))
        poses.append(np.column_stack([still, reached[i] + turn * eased]))
        now += duration
    return Drive(np.concatenate(times), np.concatenate(poses))
