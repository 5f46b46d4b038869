"""What odometry has been worth in this log, and how far it may be believed because of it.

Registrations that are certain are compared with the motion that odometry measured: along the way,
across it, and in turn. A deviation counts in shares of the slack that an unknown odometry has,
which grows with the motion. So what short steps showed holds for long ones, too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from specmap_cli.core.geometry import Pose2, wrap_angle

# What wheels on hard floors err at most, about twice what they do: metres and radians at rest, and
# shares of the way and of the turn. The turn also errs with the way, as wheels of unequal size do.
_LEAST_M, _LEAST_RAD = 0.05, 0.03
_SHARE_OF_DISTANCE, _SHARE_OF_TURN, _TURN_PER_M = 0.2, 0.3, 0.03
_REMEMBERED = 60  # latest deviations that count: some 20 m and more, so that a new floor shows
_PRIOR = 12  # deviations that an unknown odometry is taken to have had: they wear off slowly
_SIGMAS = 3.0  # of a deviation that still agrees
_QUANTILE, _QUANTILE_SIGMAS = 0.8, 1.2816  # of |z| for a normal z: a fifth may be wrong
_NARROWEST, _WIDEST = 0.5, 3.0  # slacks: registration itself errs by as much; a third is no measure
_WORTHLESS = 1.5  # slacks from which on odometry is worth less than was supposed of it
_STILL_M = 1e-3  # below it a motion has no direction, and the base's own counts


@dataclass(frozen=True, slots=True)
class Slack:
    """How far a motion may be from odometry's and still agree: metres, metres and radians."""

    along_m: float
    across_m: float
    turn_rad: float


@dataclass(frozen=True, slots=True)
class Reliance:
    """The latest deviations from odometry, in slacks of an unknown odometry; never changed.

    `limits` are the deviations that still agree, in the same slacks.
    """

    along: tuple[float, ...] = field(default=())
    across: tuple[float, ...] = field(default=())
    turn: tuple[float, ...] = field(default=())
    limits: Slack = field(init=False)

    def __post_init__(self) -> None:
        sizes = (_limit(deviations) for deviations in (self.along, self.across, self.turn))
        object.__setattr__(self, "limits", Slack(*sizes))

    @property
    def trusted(self) -> bool:
        """Whether odometry is worth what is supposed of an unknown one, or more."""
        return self.trusted_place and self.limits.turn_rad < _WORTHLESS

    @property
    def trusted_place(self) -> bool:
        """The same of its way alone: wheels may measure that well and turns badly."""
        return max(self.limits.along_m, self.limits.across_m) < _WORTHLESS

    def slack(self, motion: Pose2) -> Slack:
        """How far the truth can be from a motion that odometry measured."""
        unknown = _unknown(motion)
        return Slack(
            along_m=self.limits.along_m * unknown.along_m,
            across_m=self.limits.across_m * unknown.across_m,
            turn_rad=self.limits.turn_rad * unknown.turn_rad,
        )

    def allows(self, motion: Pose2, away: Pose2, slacks: float = 1.0) -> bool:
        """Whether a result so far `away` from odometry's place agrees with a measured motion.

        To within so many slacks.
        """
        return self.slacks(motion, away) < slacks

    def slacks(self, motion: Pose2, away: Pose2) -> float:
        """How many slacks a result so far `away` from odometry's place is off, place or turn."""
        turn = abs(away.theta) / self.slack(motion).turn_rad
        return max(self.place_slacks(motion, away), turn)

    def place_slacks(self, motion: Pose2, away: Pose2) -> float:
        """How many slacks it is off in its place alone."""
        slack, (along, across) = self.slack(motion), _parts(motion, away)
        return math.hypot(along / slack.along_m, across / slack.across_m)

    def after(self, motion: Pose2, away: Pose2, fixed: tuple[bool, bool]) -> Reliance:
        """The reliance after a certain registration, so far `away` from the motion measured.

        `fixed` says whether walls fix the place along the way, and whether across it. A direction
        that they do not fix says nothing about odometry.
        """
        unknown, (along, across) = _unknown(motion), _parts(motion, away)
        return Reliance(
            along=_with(self.along, along / unknown.along_m) if fixed[0] else self.along,
            across=_with(self.across, across / unknown.across_m) if fixed[1] else self.across,
            turn=_with(self.turn, wrap_angle(away.theta) / unknown.turn_rad),
        )


def direction_of(motion: Pose2) -> tuple[float, float]:
    """The unit vector along a motion, in the frame in which the motion ends."""
    if motion.distance < _STILL_M:
        return 1.0, 0.0
    c, s = math.cos(motion.theta), math.sin(motion.theta)
    x, y = motion.x / motion.distance, motion.y / motion.distance
    return c * x + s * y, c * y - s * x


def _parts(motion: Pose2, away: Pose2) -> tuple[float, float]:
    """A deviation, seen from the end of a motion, along and across the way."""
    x, y = direction_of(motion)
    return away.x * x + away.y * y, away.y * x - away.x * y


def _unknown(motion: Pose2) -> Slack:
    """The slack of an odometry of which nothing is known."""
    metres = _LEAST_M + _SHARE_OF_DISTANCE * motion.distance
    turn = _LEAST_RAD + _SHARE_OF_TURN * abs(motion.theta) + _TURN_PER_M * motion.distance
    return Slack(along_m=metres, across_m=metres, turn_rad=turn)


def _with(deviations: tuple[float, ...], latest: float) -> tuple[float, ...]:
    return (*deviations, abs(latest))[-_REMEMBERED:]


def _limit(deviations: tuple[float, ...]) -> float:
    """Slacks within which odometry agrees; 1 for an odometry of which nothing is known."""
    usual = _QUANTILE_SIGMAS / _SIGMAS
    known = sorted((*(usual,) * _PRIOR, *deviations))
    sigma = known[int(_QUANTILE * len(known))] / _QUANTILE_SIGMAS
    return min(_WIDEST, max(_NARROWEST, _SIGMAS * sigma))


UNKNOWN = Reliance()  # nothing was compared yet
