"""Whether a registration result can be believed.

A result is judged by its score, how well the sweep's walls lie on the local map's, together with
whether it agrees with the expected motion. Neither alone will do: a robot that enters a room scores
0.35 to 0.5 at the right pose, and a wrong pose in a corridor can score 0.8.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial.transform import Rotation

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.registration.motion import Step

GOOD = 0.75  # above it, and near the guess, nothing is searched
POOR = 0.5  # below it a wide search is worth its time
HOPELESS = 0.15  # below it no agreement helps
BETTER = 0.02  # what a search must gain in score to be believed
SLIP_M = 0.08  # a result this far behind odometry may have slipped along a corridor
SAME = 0.01  # scores this near speak for two places alike
_SURE, _FAIR = 0.7, 0.6  # needed against the expected motion, by odometry and without
_MAX_STEP_M, _MAX_STEP_RAD, _MAX_TILT = 1.5, 0.8, 0.3


def needed_score(doubted: bool, measured: bool) -> float:
    """The score that a result contradicting the expected motion must have.

    `doubted`: a search had to be called; `measured`: the expected motion is odometry's.
    """
    if not doubted:
        return POOR
    return _SURE if measured else _FAIR


def agrees(guess: Pose2, found: Pose2, step: Step) -> bool:
    """Whether a result is as near its guess as the robot's motion can have been.

    Odometry is held to its errors; a motion carried on also to how a robot speeds up and turns in.
    """
    motion, away = step.motion, guess.inverse() @ found
    if motion.distance >= 0.5 or abs(motion.theta) >= 0.5:
        return False
    slack_m, slack_rad = (0.05, 0.03) if step.measured else (0.1, 0.12)
    near = away.distance < slack_m + 0.2 * motion.distance
    return near and abs(away.theta) < slack_rad + 0.3 * abs(motion.theta)


def bounded(guess: FloatArray, found: FloatArray) -> bool:
    """Whether a registration result is finite and no farther from the guess than can be."""
    if not np.isfinite(found).all():
        return False
    trace = float((guess[:3, :3] * found[:3, :3]).sum())  # of the turn from one to the other
    turn = math.acos(min(1.0, max(-1.0, (trace - 1.0) / 2.0)))
    upright = float(found[2, 2]) > np.cos(_MAX_TILT)
    near = math.dist(guess[:3, 3].tolist(), found[:3, 3].tolist()) <= _MAX_STEP_M
    return near and turn <= _MAX_STEP_RAD and upright


def levelled(pose: FloatArray, share: float) -> FloatArray:
    """A pose (4, 4) with `share` of its roll and pitch taken back, the heading and place kept.

    A lidar of few rings says little about its own tilt, whose drift would lift the robot off.
    """
    yaw, pitch, roll = Rotation.from_matrix(pose[:3, :3]).as_euler("ZYX")
    level = np.array(pose)
    kept = 1.0 - share
    level[:3, :3] = Rotation.from_euler("ZYX", [yaw, kept * pitch, kept * roll]).as_matrix()
    return level
