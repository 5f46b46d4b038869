"""Where the robot is taken to be when walls do not tell how far it came."""

from __future__ import annotations

import numpy as np
import pytest

from specmap_cli.core.geometry import IDENTITY, Pose2
from specmap_cli.registration.frontend import Track

HERE = Pose2(2.0, 1.0, np.pi / 2)


def test_without_a_motion_that_walls_fixed_the_robot_is_taken_to_stand() -> None:
    assert Track(pose=HERE.matrix()).carried_on == pytest.approx(HERE)


def test_the_motion_carried_on_is_the_usual_one_straight_on() -> None:
    """The last ones before a bare corridor, which registration makes too short, do not count."""
    track = Track(pose=HERE.matrix())
    for forward_m in (*[9.0] * 8, *[0.5] * 10, *[0.1] * 5):
        track = track.with_steady(Pose2(forward_m, 0.02, 0.3))
    assert len(track.steady) == 15
    assert HERE.inverse() @ track.carried_on == pytest.approx(Pose2(0.5, 0.02, 0.0))
    assert Track().carried_on == IDENTITY
