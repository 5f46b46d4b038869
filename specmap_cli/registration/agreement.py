"""Whether a result agrees with the motion that was expected."""

from __future__ import annotations

from specmap_cli.core.geometry import Pose2
from specmap_cli.registration.expected_motion import ExpectedMotion
from specmap_cli.registration.reliance import Reliance

# How far a motion carried on may be off, by how much a robot speeds up and turns in from one scan
# to the next: metres and radians, and shares of the motion.
_CARRIED_M, _CARRIED_RAD = 0.1, 0.12
_SHARE_OF_DISTANCE, _SHARE_OF_TURN = 0.2, 0.3


def agrees(
    guess: Pose2,
    found: Pose2,
    expected: ExpectedMotion,
    reliance: Reliance,
    slacks: float = 1.0,
) -> bool:
    """Whether a result is as near its guess as the robot's motion can have been.

    Odometry is held to what it has been worth, at any length of the motion, `slacks` times that.
    """
    motion, away = expected.motion, guess.inverse() @ found
    if expected.measured:
        return reliance.allows(motion, away, slacks)
    near = away.distance < slacks * (_CARRIED_M + _SHARE_OF_DISTANCE * motion.distance)
    turn_rad = slacks * (_CARRIED_RAD + _SHARE_OF_TURN * abs(motion.theta))
    return near and abs(away.theta) < turn_rad
