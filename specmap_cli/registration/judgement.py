"""Whether a registration result can be believed.

A result is judged by its score, how well the sweep's walls lie on the local map's, together with
whether it agrees with the expected motion. Neither alone will do: a robot that enters a room scores
0.35 to 0.5 at the right pose, and a wrong pose in a corridor can score 0.8.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.settings import RegistrationConfig
from specmap_cli.registration.expected_motion import ExpectedMotion
from specmap_cli.registration.locating import Located
from specmap_cli.registration.scene import Fit

_HOPELESS = 0.15  # below it no agreement helps: points thrown at random score as much
# How far a result may be from its guess and still agree: metres and radians, plus shares of the
# expected motion. Odometry is held to its errors, twice what wheels err on hard floors; a motion
# carried on also to how much a robot speeds up and turns in from one scan to the next.
_ODOMETRY_SLACK, _CARRIED_SLACK = (0.05, 0.03), (0.1, 0.12)
_SHARE_OF_DISTANCE, _SHARE_OF_TURN = 0.2, 0.3


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """The pose of a sweep and what is thought of it.

    A `lost` sweep is at its guess. `agrees`: the result agrees with the expected motion. `long`:
    that motion was too long to prove anything; `lost_by_length`: it was odometry's, and had it been
    believed, the sweep would not be lost.
    """

    fit: Fit
    agrees: bool = True
    lost: bool = False
    long: bool = False
    lost_by_length: bool = False

    def levelled(self, share: float) -> Verdict:
        """The same with `share` of the roll and pitch taken back, heading and place kept.

        A lidar of few rings says little about its own tilt, whose drift would lift the robot off.
        """
        yaw, pitch, roll = Rotation.from_matrix(self.fit.pose[:3, :3]).as_euler("ZYX")
        level, kept = np.array(self.fit.pose), 1.0 - share
        level[:3, :3] = Rotation.from_euler("ZYX", [yaw, kept * pitch, kept * roll]).as_matrix()
        return replace(self, fit=replace(self.fit, pose=level))


def judge(
    located: Located, guess: FloatArray, expected: ExpectedMotion, config: RegistrationConfig
) -> Verdict:
    """What is thought of the pose found from a guess (4, 4); a lost sweep is put back on it."""
    fit = located.fit
    long = _is_long(expected.motion, config)
    near = _is_near(Pose2.from_matrix(guess), fit.planar, expected)
    agrees = near and not long
    hopeless = fit.score < _HOPELESS
    needed = needed_score(config, searched=located.searched, measured=expected.measured)
    lost = hopeless or (not agrees and fit.score < needed)
    return Verdict(
        fit=replace(fit, pose=guess) if lost else fit,
        agrees=agrees,
        lost=lost,
        long=long,
        lost_by_length=lost and near and expected.measured and not hopeless,
    )


def needed_score(config: RegistrationConfig, *, searched: bool, measured: bool) -> float:
    """The score that a result contradicting the expected motion must have.

    `searched`: a search had to be called; `measured`: the expected motion is odometry's.
    """
    if not searched:
        return config.poor_score
    return config.sure_score if measured else config.fair_score


def _is_long(motion: Pose2, config: RegistrationConfig) -> bool:
    """Whether a motion is so long that agreeing with it proves no result right."""
    far = motion.distance >= config.believed_step_m
    return far or abs(motion.theta) >= config.believed_step_rad


def _is_near(guess: Pose2, found: Pose2, expected: ExpectedMotion) -> bool:
    """Whether a result is as near its guess as the robot's motion can have been."""
    motion, away = expected.motion, guess.inverse() @ found
    slack_m, slack_rad = _ODOMETRY_SLACK if expected.measured else _CARRIED_SLACK
    near = away.distance < slack_m + _SHARE_OF_DISTANCE * motion.distance
    return near and abs(away.theta) < slack_rad + _SHARE_OF_TURN * abs(motion.theta)
