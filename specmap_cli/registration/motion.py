"""The motion expected from one sweep to the next, from odometry or from the motion before."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from specmap_cli.core.geometry import IDENTITY, Pose2
from specmap_cli.core.records import Sweep

_FORWARD_M, _SIDEWAYS_M, _TURN_RAD = 0.5, 0.2, 0.8  # of a motion carried on without odometry
_JUMP_M, _JUMP_SPEED = 2.0, 3.0  # an odometry increment beyond metres + metres/s is a reset


@dataclass(frozen=True, slots=True)
class Step:
    """Expected motion of the base since the last sweep, and whether odometry measured it.

    `during` is the motion to de-skew with, over the same interval.
    """

    motion: Pose2
    during: Pose2
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
        self._last = self._before = IDENTITY

    def predict(self, sweep: Sweep) -> Step:
        """The motion expected since the sweep before."""
        before, now = self._odometry, sweep.odom_from_base
        gap_ns = 0 if self._stamp_ns is None else sweep.stamp_ns - self._stamp_ns
        interval_s = max(0.0, gap_ns * 1e-9)
        self._odometry, self._stamp_ns = now, sweep.stamp_ns
        jumped = False
        if before is not None and now is not None:
            motion = before.inverse() @ now
            if motion.distance <= _JUMP_M + _JUMP_SPEED * interval_s:
                return Step(motion, self._steady(), interval_s, True)
            jumped = True
        return Step(self.carried_on(), self._steady(), interval_s, False, jumped)

    def conclude(self, motion: Pose2) -> None:
        """Remember the motion since the sweep before."""
        self._before, self._last = self._last, motion

    def carried_on(self) -> Pose2:
        """The last motion, clipped to what a robot does within a sweep."""
        return _clipped(self._last)

    def _steady(self) -> Pose2:
        """The mean of the last two motions as registered, clipped.

        Odometry, whose clock may be apart from the laser's, draws walls double in turns. The last
        motion alone feeds each error back with its sign turned: a robot at rest would seem to
        swing, ever wider. The mean lets go of what alternates.
        """
        a, b = self._before, self._last
        return _clipped(Pose2((a.x + b.x) / 2, (a.y + b.y) / 2, (a.theta + b.theta) / 2))


def _clipped(motion: Pose2) -> Pose2:
    x = float(np.clip(motion.x, -_FORWARD_M, _FORWARD_M))
    y = float(np.clip(motion.y, -_SIDEWAYS_M, _SIDEWAYS_M))
    return Pose2(x, y, float(np.clip(motion.theta, -_TURN_RAD, _TURN_RAD)))
