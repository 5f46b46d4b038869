"""The motion expected from one sweep to the next, from odometry or from the motion before."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from specmap_cli.geometry import IDENTITY, Pose2
from specmap_cli.records import Sweep

_FORWARD_M, _SIDEWAYS_M, _TURN_RAD = 0.5, 0.2, 0.8  # of a motion carried on without odometry
_JUMP_M, _JUMP_SPEED = 2.0, 3.0  # an odometry increment beyond metres + metres/s is a reset


@dataclass(frozen=True, slots=True)
class Step:
    """Expected motion of the base since the last sweep, and whether odometry measured it."""

    motion: Pose2
    interval_s: float
    measured: bool
    jumped: bool = False


class MotionModel:
    """Predicts the next motion; tell it by `conclude` what the motion turned out to be.

    Increments are per sweep and never divided by time: stamps of some logs come in bursts or step
    backwards.
    """

    def __init__(self) -> None:
        self._odometry: Pose2 | None = None
        self._stamp_ns: int | None = None
        self._last = IDENTITY

    def predict(self, sweep: Sweep) -> Step:
        """The motion expected since the sweep before."""
        before, now = self._odometry, sweep.odom_from_base
        gap_ns = 0 if self._stamp_ns is None else sweep.stamp_ns - self._stamp_ns
        interval_s = max(0.0, gap_ns * 1e-9)
        self._odometry, self._stamp_ns = now, sweep.stamp_ns
        if before is not None and now is not None:
            motion = before.inverse() @ now
            if motion.distance <= _JUMP_M + _JUMP_SPEED * interval_s:
                return Step(motion, interval_s, True)
            return Step(self.carried_on(), interval_s, False, True)
        return Step(self.carried_on(), interval_s, False)

    def conclude(self, motion: Pose2) -> None:
        """Remember the motion since the sweep before."""
        self._last = motion

    def carried_on(self) -> Pose2:
        """The last motion, clipped to what a robot does within a sweep."""
        x = float(np.clip(self._last.x, -_FORWARD_M, _FORWARD_M))
        y = float(np.clip(self._last.y, -_SIDEWAYS_M, _SIDEWAYS_M))
        return Pose2(x, y, float(np.clip(self._last.theta, -_TURN_RAD, _TURN_RAD)))
