"""Odometry between stamps, from topics and from transforms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.geometry import Pose2
from specmap_cli.logs.odometry import MAX_POSES, OdometryBuffer
from tests.turning import turn

MS = 1_000_000


@given(share=st.floats(0.0, 1.0), start=st.floats(-3.1, 3.1), turn=st.floats(-1.5, 1.5))
def test_poses_between_stamps_lie_on_the_way(share: float, start: float, turn: float) -> None:
    buffer = OdometryBuffer()
    buffer.add(1000 * MS, Pose2(1.0, 2.0, start))
    buffer.add(1100 * MS, Pose2(3.0, -2.0, start + turn))
    pose = buffer.at(1000 * MS + round(share * 100 * MS))
    assert pose is not None
    assert pose.x == pytest.approx(1.0 + 2.0 * share)
    assert pose.y == pytest.approx(2.0 - 4.0 * share)
    assert math.remainder(pose.theta - start - share * turn, 2 * math.pi) == pytest.approx(
        0.0, abs=1e-6
    )


def test_memory_is_bounded() -> None:
    buffer = OdometryBuffer()
    for number in range(20_000):
        buffer.add(number * MS, Pose2(float(number), 0.0, 0.0))
    assert len(buffer) <= MAX_POSES
    assert buffer.at(19_990 * MS) == (19_990.0, 0.0, 0.0)
    assert buffer.at(0) is None


@given(st.lists(st.tuples(st.integers(0, 400), st.floats(-9, 9)), min_size=2, max_size=30))
def test_poses_are_those_of_linear_interpolation(found: list[tuple[int, float]]) -> None:
    """Whatever the order of arrival; the last of a repeated stamp counts."""
    turn("logs", odometry_gap_s=1000)
    buffer = OdometryBuffer()
    known = {}
    for stamp, x in found:
        buffer.add(stamp * MS, Pose2(x, -x, 0.0))
        known[stamp] = x
    stamps = sorted(known)
    for asked in np.linspace(stamps[0], stamps[-1], 7):
        pose = buffer.at(round(asked * MS))
        assert pose is not None
        expected = np.interp(asked, stamps, [known[stamp] for stamp in stamps])
        assert pose.x == pytest.approx(expected, abs=1e-5)
        assert pose.y == pytest.approx(-expected, abs=1e-5)
    assert len(buffer) == len(known)


@pytest.mark.parametrize(
    ("settings_", "asked_ms", "there"),
    [
        ({}, 1050, True),
        ({"odometry_gap_s": 0.05}, 1050, False),
        ({"odometry_gap_s": 0.1}, 1050, True),
        ({}, 950, True),
        ({"odometry_hold_s": 0.049}, 950, False),
        ({"odometry_hold_s": 0.0}, 1101, False),
        ({"odometry_hold_s": 1.0}, 2100, True),
    ],
)
def test_the_settings_say_how_far_odometry_reaches(
    settings_: dict[str, float], asked_ms: int, there: bool
) -> None:
    turn("logs", **settings_)
    buffer = OdometryBuffer()
    buffer.add(1000 * MS, Pose2(0.0, 0.0, 0.0))
    buffer.add(1100 * MS, Pose2(1.0, 0.0, 0.0))
    assert (buffer.at(asked_ms * MS) is not None) is there


@pytest.mark.parametrize(("reset_s", "kept"), [(5.0, 1), (6.0, 2)])
def test_the_settings_say_what_is_late_and_what_a_clock_set_back(reset_s: float, kept: int) -> None:
    turn("logs", clock_reset_s=reset_s)
    buffer = OdometryBuffer()
    buffer.add(10_000 * MS, Pose2(0.0, 0.0, 0.0))
    buffer.add(4_500 * MS, Pose2(1.0, 0.0, 0.0))
    assert len(buffer) == kept
