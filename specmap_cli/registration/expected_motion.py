"""The motion expected from one sweep to the next: odometry's, or the motion before carried on."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from specmap_cli.core.geometry import IDENTITY, Pose2
from specmap_cli.core.records import Sweep
from specmap_cli.core.settings import RegistrationConfig

_S_PER_NS = 1e-9
_INTERVALS = 40  # latest ones that tell which interval is usual: some seconds of most logs
_LONG_INTERVAL = 0.9  # quantile: stamps of some logs come in bursts, and most intervals are short
_HOLE = 3.0  # long intervals from which on one is a hole in the log
_FASTER = 1.5  # of the largest motion seen, and no more, may be carried on: robots speed up


@dataclass(frozen=True, slots=True, kw_only=True)
class ExpectedMotion:
    """The motion of the base expected since the sweep before, `interval_s` seconds.

    `motion` is odometry's when it was `measured`, else `carried`: the motion before carried on.
    `during` is the motion to de-skew with. `jumped` tells of an odometry increment too large to be
    a motion, `shortened` of a motion before that was too large to be carried on as it was. `hole`:
    much more time went by than between other sweeps. `unheard_of`: odometry reports a turn that is
    larger than those that walls have confirmed.
    """

    motion: Pose2
    carried: Pose2
    during: Pose2
    interval_s: float
    measured: bool
    jumped: bool
    shortened: bool
    hole: bool = False
    unheard_of: bool = False


@dataclass(frozen=True, slots=True)
class LargestMotions:
    """The two largest confirmed motions of a log in each direction: one alone may be an error."""

    forward_m: tuple[float, float] = (0.0, 0.0)
    sideways_m: tuple[float, float] = (0.0, 0.0)
    turn_rad: tuple[float, float] = (0.0, 0.0)

    def with_motion(self, motion: Pose2) -> LargestMotions:
        """The same after one more confirmed motion."""
        return LargestMotions(
            forward_m=_largest(self.forward_m, motion.x),
            sideways_m=_largest(self.sideways_m, motion.y),
            turn_rad=_largest(self.turn_rad, motion.theta),
        )


def _largest(largest: tuple[float, float], value: float) -> tuple[float, float]:
    """The two largest of three sizes, the larger one first."""
    first, second, _ = sorted((*largest, abs(value)), reverse=True)
    return first, second


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
        self._largest = LargestMotions()
        self._intervals: deque[float] = deque(maxlen=_INTERVALS)

    def expect(self, sweep: Sweep) -> ExpectedMotion:
        """The motion expected since the sweep before."""
        gap_ns = 0 if self._stamp_ns is None else sweep.stamp_ns - self._stamp_ns
        interval_s = max(0.0, gap_ns * _S_PER_NS)
        increment = self._increment(sweep)
        self._odometry, self._stamp_ns = sweep.odom_from_base, sweep.stamp_ns
        jumped = increment is not None and self._is_jump(increment, interval_s)
        measured = increment is not None and not jumped
        carried, during = self._shortened(self._last), self._shortened(self._steady())
        hole = self._is_hole(interval_s)
        self._intervals.append(interval_s)
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
            hole=hole,
            unheard_of=increment is not None and abs(increment.theta) > self._limits().theta,
        )

    def conclude(self, motion: Pose2, *, confirmed: bool = False) -> None:
        """Remember the motion since the sweep before; walls may have `confirmed` it."""
        self._before, self._last = self._last, motion
        if confirmed:
            self._largest = self._largest.with_motion(motion)

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

    def _is_hole(self, interval_s: float) -> bool:
        """Whether scans are missing before this one."""
        few = len(self._intervals) < _INTERVALS // 2
        if few or interval_s <= _HOLE * min(self._intervals):
            return False
        usual = sorted(self._intervals)[int(_LONG_INTERVAL * len(self._intervals))]
        return interval_s > _HOLE * usual > 0.0

    def _steady(self) -> Pose2:
        """The mean of the last two motions as registered.

        Odometry, whose clock may be apart from the laser's, draws walls double in turns. The last
        motion alone feeds each error back with its sign turned: a robot at rest would seem to
        swing, ever wider. The mean lets go of what alternates.
        """
        a, b = self._before, self._last
        return Pose2((a.x + b.x) / 2, (a.y + b.y) / 2, (a.theta + b.theta) / 2)

    def _shortened(self, motion: Pose2) -> Pose2:
        """A motion, no longer than may be carried on: an error must not grow from scan to scan.

        The settings limit it until walls have confirmed larger motions.
        """
        limits = self._limits()
        return Pose2(*(max(-m, min(m, v)) for v, m in zip(motion, limits, strict=True)))

    def _limits(self) -> Pose2:
        """The longest motion that may be carried on, in each direction; none is negative."""
        config, largest = self._config, self._largest
        return Pose2(
            max(config.carried_forward_m, _FASTER * largest.forward_m[1]),
            max(config.carried_sideways_m, _FASTER * largest.sideways_m[1]),
            max(config.carried_rad, _FASTER * largest.turn_rad[1]),
        )
