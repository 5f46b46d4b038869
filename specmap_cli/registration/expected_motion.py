"""The motion expected from one sweep to the next: odometry's, or the motion before carried on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from specmap_cli.core.geometry import IDENTITY, Pose2
from specmap_cli.core.records import Sweep
from specmap_cli.core.settings import RegistrationConfig

_S_PER_NS = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class ExpectedMotion:
    """The motion of the base expected since the sweep before, `interval_s` seconds.

    `motion` is odometry's when it was `measured`, else `carried`: the motion before carried on.
    `during` is the motion to de-skew with. `jumped` tells of an odometry increment too large to be
    a motion, `shortened` of a motion before that was too large to be carried on as it was.
    """

    motion: Pose2
    carried: Pose2
    during: Pose2
    interval_s: float
    measured: bool
    jumped: bool
    shortened: bool


class MotionModel:
    """Expects the next motion; tell it by `conclude` what the motion turned out to be.

    Increments are per sweep and never divided by time: stamps of some logs come in bursts or step
    backwards.
    """

    def __init__(self, config: RegistrationConfig) -> None:
        self._config = config
        self._odometry: Pose2 | None = None
        self._stamp_ns: int | None = None
        self._last = self._before = IDENTITY

    def expect(self, sweep: Sweep) -> ExpectedMotion:
        """The motion expected since the sweep before."""
        gap_ns = 0 if self._stamp_ns is None else sweep.stamp_ns - self._stamp_ns
        interval_s = max(0.0, gap_ns * _S_PER_NS)
        increment = self._increment(sweep)
        self._odometry, self._stamp_ns = sweep.odom_from_base, sweep.stamp_ns
        jumped = increment is not None and self._is_jump(increment, interval_s)
        measured = increment is not None and not jumped
        carried, during = self._shortened(self._last), self._shortened(self._steady())
        timed = sweep.planar.beam_times_s is not None or sweep.cloud_times_s is not None
        return ExpectedMotion(
            motion=increment if increment is not None and measured else carried,
            carried=carried,
            during=during,
            interval_s=interval_s,
            measured=measured,
            jumped=jumped,
            shortened=(not measured and carried != self._last)
            or (timed and during != self._steady()),
        )

    def conclude(self, motion: Pose2) -> None:
        """Remember the motion since the sweep before."""
        self._before, self._last = self._last, motion

    def _increment(self, sweep: Sweep) -> Pose2 | None:
        """The motion since the sweep before by odometry, None where either has none."""
        if self._odometry is None or sweep.odom_from_base is None:
            return None
        return self._odometry.inverse() @ sweep.odom_from_base

    def _is_jump(self, increment: Pose2, interval_s: float) -> bool:
        """Whether odometry was reset: no robot drives that far."""
        config = self._config
        limit_m = config.odometry_jump_m + config.odometry_jump_mps * interval_s
        return not increment.distance <= limit_m

    def _steady(self) -> Pose2:
        """The mean of the last two motions as registered.

        Odometry, whose clock may be apart from the laser's, draws walls double in turns. The last
        motion alone feeds each error back with its sign turned: a robot at rest would seem to
        swing, ever wider. The mean lets go of what alternates.
        """
        a, b = self._before, self._last
        return Pose2((a.x + b.x) / 2, (a.y + b.y) / 2, (a.theta + b.theta) / 2)

    def _shortened(self, motion: Pose2) -> Pose2:
        """A motion, no longer than may be carried on: an error must not grow from scan to scan."""
        config = self._config
        limits = (config.carried_forward_m, config.carried_sideways_m, config.carried_rad)
        return Pose2(*(float(np.clip(v, -m, m)) for v, m in zip(motion, limits, strict=True)))
