"""How far odometry may be off, by the motion that it measured.

What wheels on hard floors err at most, about twice what they do. A robot's own may be worth more or
less: what registration compared with walls tells in shares of this.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from specmap_cli.core.geometry import Pose2

SIGMAS = 3.0  # of a deviation that still agrees: a slack is so many
# Metres and radians at rest, and shares of the way and of the turn. The turn also errs with the
# way, as wheels of unequal size do.
_LEAST_M, _LEAST_RAD = 0.05, 0.03
SHARE_OF_DISTANCE, _SHARE_OF_TURN, _TURN_PER_M = 0.2, 0.3, 0.03


class Slack(NamedTuple):
    """How far a motion may be from odometry's and still agree: metres, metres and radians."""

    along_m: float
    across_m: float
    turn_rad: float

    @property
    def place_m(self) -> float:
        """How far that is in the plane."""
        return math.hypot(self.along_m, self.across_m)


UNMEASURED = Slack(math.inf, math.inf, math.inf)  # of a motion without odometry


def unknown_slack(motion: Pose2) -> Slack:
    """The slack of an odometry of which nothing is known."""
    metres = _LEAST_M + SHARE_OF_DISTANCE * motion.distance
    turn = _LEAST_RAD + _SHARE_OF_TURN * abs(motion.theta) + _TURN_PER_M * motion.distance
    return Slack(along_m=metres, across_m=metres, turn_rad=turn)
