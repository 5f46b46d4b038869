"""The motion expected from sweep to sweep: odometry's unless it jumped, else the motion before."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.geometry import IDENTITY, Pose2
from specmap_cli.core.records import Sweep
from specmap_cli.core.settings import RegistrationConfig
from specmap_cli.registration.motion import ExpectedMotion, MotionModel
from tests.registration.drives import circle
from tests.strategies import poses

BEAMS = np.ones(4)


def sweep(stamp_s: float = 0.0, odometry: Pose2 | None = None, times: bool = False) -> Sweep:
    """A sweep whose ranges do not matter."""
    made = circle(0, BEAMS, odometry)
    beam_times_s = np.linspace(0.0, 0.1, 4) if times else None
    return dataclasses.replace(
        made,
        stamp_ns=round(stamp_s * 1e9),
        planar=dataclasses.replace(made.planar, beam_times_s=beam_times_s),
    )


def after(last: Pose2, now: Sweep, **settings: float) -> ExpectedMotion:
    """What is expected of `now` when the last two motions were `last`."""
    model = MotionModel(RegistrationConfig.model_validate(settings))
    model.expect(sweep(odometry=IDENTITY))
    model.conclude(last)
    model.conclude(last)
    return model.expect(now)


def test_nothing_is_expected_of_the_first_sweep() -> None:
    expected = MotionModel(RegistrationConfig()).expect(sweep(5.0, Pose2(3.0, 2.0, 1.0), True))
    assert expected == ExpectedMotion(
        motion=IDENTITY,
        carried=IDENTITY,
        during=IDENTITY,
        interval_s=0.0,
        measured=False,
        jumped=False,
        shortened=False,
    )


@given(poses, st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(-3.0, 3.0))
def test_the_frame_of_odometry_does_not_matter(
    start: Pose2, x: float, y: float, turn: float
) -> None:
    motion = Pose2(x, y, turn)
    model = MotionModel(RegistrationConfig())
    model.expect(sweep(0.0, start))
    expected = model.expect(sweep(0.1, start @ motion))
    assert expected.measured
    assert np.allclose(expected.motion, motion, atol=1e-9)


@pytest.mark.parametrize(
    ("distance_m", "gap_s", "jumped"),
    [
        (1.99, 0.0, False),
        (2.01, 0.0, True),
        (4.99, 1.0, False),
        (5.01, 1.0, True),
        (2.01, -10.0, True),  # stamps that step back allow nothing more
        (np.nan, 1.0, True),
        (np.inf, 1.0, True),
    ],
)
def test_odometry_farther_than_a_robot_drives_is_a_reset(
    distance_m: float, gap_s: float, jumped: bool
) -> None:
    before = Pose2(0.1, 0.0, 0.02)
    expected = after(before, sweep(gap_s, Pose2(distance_m, 0.0, 0.0)))
    assert (expected.jumped, expected.measured) == (jumped, not jumped)
    assert expected.motion == (before if jumped else Pose2(distance_m, 0.0, 0.0))
    assert expected.interval_s == max(0.0, gap_s)


def test_limits_of_a_jump_are_settings() -> None:
    far = sweep(1.0, Pose2(9.0, 0.0, 0.0))
    assert after(IDENTITY, far).jumped
    assert not after(IDENTITY, far, odometry_jump_m=8.0, odometry_jump_mps=1.0).jumped
    assert after(IDENTITY, far, odometry_jump_m=7.9, odometry_jump_mps=1.0).jumped


def test_after_a_jump_odometry_counts_from_its_new_place() -> None:
    model = MotionModel(RegistrationConfig())
    flags = []
    for k, x in enumerate([0.0, 0.1, 500.0, 500.1]):
        expected = model.expect(sweep(0.1 * k, Pose2(x, 0.0, 0.0)))
        flags.append((expected.measured, expected.jumped))
    assert flags == [(False, False), (True, False), (False, True), (True, False)]
    assert expected.motion.x == pytest.approx(0.1)


def test_a_sweep_without_odometry_leaves_two_motions_unmeasured() -> None:
    model = MotionModel(RegistrationConfig())
    at = [IDENTITY, Pose2(0.1, 0, 0), None, Pose2(0.3, 0, 0), Pose2(0.4, 0, 0)]
    found = [model.expect(sweep(0.1 * k, odometry)) for k, odometry in enumerate(at)]
    assert [expected.measured for expected in found] == [False, True, False, False, True]
    assert not any(expected.jumped for expected in found)


@given(poses, poses)
def test_what_is_carried_on_is_bounded(one: Pose2, other: Pose2) -> None:
    model = MotionModel(RegistrationConfig())
    model.conclude(one)
    model.conclude(other)
    expected = model.expect(sweep())
    for motion in (expected.carried, expected.during):
        assert abs(motion.x) <= 0.5
        assert abs(motion.y) <= 0.2
        assert abs(motion.theta) <= 0.8
    assert expected.motion == expected.carried
    small = abs(other.x) <= 0.5 and abs(other.y) <= 0.2 and abs(other.theta) <= 0.8
    assert (expected.carried == other) == small


def test_errors_that_alternate_are_not_de_skewed_with() -> None:
    model = MotionModel(RegistrationConfig())
    swing = Pose2(0.02, -0.01, 0.1)
    model.conclude(swing)
    model.conclude(Pose2(*(-value for value in swing)))
    assert model.expect(sweep()).during == IDENTITY
    assert after(swing, sweep()).during == swing


@pytest.mark.parametrize(
    ("last", "now", "shortened"),
    [
        (Pose2(0.5, 0.2, 0.8), sweep(), False),
        (Pose2(0.51, 0.0, 0.0), sweep(), True),
        (Pose2(0.0, -0.21, 0.0), sweep(), True),
        (Pose2(0.0, 0.0, -0.81), sweep(), True),
        (Pose2(0.51, 0.0, 0.0), sweep(odometry=IDENTITY), False),  # odometry is the guess
        (Pose2(0.51, 0.0, 0.0), sweep(odometry=IDENTITY, times=True), True),  # de-skewing
        (Pose2(0.5, 0.0, 0.0), sweep(odometry=IDENTITY, times=True), False),
    ],
)
def test_a_motion_held_to_the_limits_is_told_where_it_is_used(
    last: Pose2, now: Sweep, shortened: bool
) -> None:
    assert after(last, now).shortened == shortened


def test_limits_of_what_is_carried_on_are_settings() -> None:
    last = Pose2(3.0, -2.0, 2.0)
    assert after(last, sweep()).motion == Pose2(0.5, -0.2, 0.8)
    wide = after(last, sweep(), carried_forward_m=5.0, carried_sideways_m=1.5, carried_rad=3.0)
    assert wide.motion == Pose2(3.0, -1.5, 2.0)
    assert wide.shortened


def test_two_confirmed_motions_widen_what_is_carried_on() -> None:
    """One alone may be an error. A robot may speed up by half from one scan to the next."""
    model = MotionModel(RegistrationConfig())
    long = Pose2(2.0, 0.0, 0.0)
    carried = []
    for confirmed in (True, False, True):
        model.conclude(long, confirmed=confirmed)
        carried.append(model.expect(sweep()).carried.x)
    assert carried == [0.5, 0.5, 2.0]
    model.conclude(Pose2(9.0, -0.5, 0.3))
    assert model.expect(sweep()).carried == Pose2(3.0, -0.2, 0.3)


@pytest.mark.parametrize(
    ("gaps_s", "gap_s", "hole"),
    [
        ([0.1] * 40, 0.31, True),
        ([0.1] * 40, 0.29, False),
        ([0.1] * 10, 5.0, False),  # too early to tell
        ([0.001, 0.199] * 20, 0.5, False),  # stamps in bursts
        ([0.001, 0.199] * 20, 0.7, True),
        ([0.0] * 40, 5.0, False),  # stamps that say nothing
        ([2.0] * 40, 2.5, False),  # a sparse log has no holes
    ],
)
def test_a_hole_in_the_log_is_a_gap_much_longer_than_usual(
    gaps_s: list[float], gap_s: float, hole: bool
) -> None:
    model = MotionModel(RegistrationConfig())
    stamps_s = np.cumsum([1.0, *gaps_s, gap_s])
    found = [model.expect(sweep(float(stamp))).hole for stamp in stamps_s]
    assert found[-1] == hole
    assert not any(found[1:-1])


@pytest.mark.parametrize(
    ("turn_rad", "unheard_of"), [(0.7, False), (-0.7, False), (0.9, True), (-0.9, True)]
)
def test_a_turn_beyond_what_may_be_carried_on_is_unheard_of(
    turn_rad: float, unheard_of: bool
) -> None:
    now = sweep(odometry=Pose2(0.0, 0.0, turn_rad))
    assert after(IDENTITY, now).unheard_of == unheard_of
    assert not after(IDENTITY, now, carried_rad=1.0).unheard_of


def test_a_turn_such_as_walls_have_confirmed_is_not_unheard_of() -> None:
    model = MotionModel(RegistrationConfig())
    model.expect(sweep(odometry=IDENTITY))
    for _ in range(2):
        model.conclude(Pose2(0.0, 0.0, 1.0), confirmed=True)
    assert not model.expect(sweep(odometry=Pose2(0.0, 0.0, 1.4))).unheard_of
    assert model.expect(sweep(odometry=Pose2(0.0, 0.0, 3.0))).unheard_of
