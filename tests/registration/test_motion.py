"""The motion expected from sweep to sweep: odometry's unless it jumped, else the motion before."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from specmap_cli.core.geometry import IDENTITY, Pose2
from specmap_cli.core.records import PlanarScan, Sweep
from specmap_cli.core.settings import RegistrationConfig
from specmap_cli.registration.guess import (
    UNKNOWN,
    ExpectedMotion,
    MotionModel,
    Reliance,
    direction_of,
    fixed_directions,
)
from specmap_cli.registration.local_map import Fit
from tests.registration.drives import circle, expecting, guess_of
from tests.strategies import poses


def sweep(stamp_s: float = 0.0, odometry: Pose2 | None = None, times: bool = False) -> Sweep:
    """A sweep whose ranges do not matter."""
    made = circle(0, np.ones(4), odometry)
    beam_times_s = np.linspace(0.0, 0.1, 4) if times else None
    planar = dataclasses.replace(made.planar, beam_times_s=beam_times_s)
    return dataclasses.replace(made, stamp_ns=round(stamp_s * 1e9), planar=planar)


def after(last: Pose2, now: Sweep) -> ExpectedMotion:
    """What is expected of `now` when the last two motions were `last`."""
    model = MotionModel(RegistrationConfig())
    model.expect(sweep(odometry=IDENTITY))
    model.conclude(last)
    model.conclude(last)
    return model.expect(now)


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
def test_odometry_too_far_on_is_a_reset(distance_m: float, gap_s: float, jumped: bool) -> None:
    before = Pose2(0.1, 0.0, 0.02)
    expected = after(before, sweep(gap_s, Pose2(distance_m, 0.0, 0.0)))
    assert (expected.jumped, expected.measured) == (jumped, not jumped)
    assert expected.motion == (before if jumped else Pose2(distance_m, 0.0, 0.0))
    assert expected.interval_s == max(0.0, gap_s)


@pytest.mark.parametrize(
    ("seen_m", "read_m", "left_m"), [(0.2, 0.8, 0.2), (0.2, 0.02, 0.02), (0.01, 0.2, 0.2)]
)
def test_odometry_that_hung(seen_m: float, read_m: float, left_m: float) -> None:
    """It makes up for it; wheels stood, and the robot was pushed; at rest walls err by a little."""
    model = MotionModel(RegistrationConfig())
    for _ in range(4):
        model.expect(sweep(odometry=IDENTITY))
        model.conclude(Pose2(seen_m, 0.0, 0.0))
    expected = model.expect(sweep(odometry=Pose2(read_m, 0.0, 0.0)))
    assert expected.motion.x == pytest.approx(left_m)
    assert expected.increment.x == read_m


@given(poses, poses)
def test_what_is_carried_on_is_bounded(one: Pose2, other: Pose2) -> None:
    model = MotionModel(RegistrationConfig())
    model.conclude(one)
    model.conclude(other)
    expected = model.expect(sweep())
    most = np.array([0.5, 0.2, 0.8])
    assert np.array_equal(expected.carried, np.clip(other, -most, most))
    assert (np.abs(expected.during) <= most).all()
    assert expected.motion == expected.carried


def test_errors_that_alternate_are_not_de_skewed_with() -> None:
    model = MotionModel(RegistrationConfig())
    swing = Pose2(0.02, -0.01, 0.1)
    model.conclude(swing)
    model.conclude(Pose2(*(-value for value in swing)))
    assert model.expect(sweep()).during == IDENTITY
    assert after(swing, sweep()).during == swing


@pytest.mark.parametrize(
    ("intervals_s", "gap_s", "carried_m"),
    [
        ([0.1] * 30, 0.5, 1.0),
        ([0.1] * 30, 1.1, 0.2),  # a robot that is not seen does not go on for ever
        ([0.3] + [0.1] * 29, 0.24, 0.4),  # one hole is no burst
        ([0.1] * 30, 0.2, 0.2),
        ([0.02, 0.02, 0.26] * 10, 0.5, 0.2),  # stamps in bursts
        ([0.1] * 20, 0.5, 0.2),  # too few to tell
    ],
)
def test_in_a_hole_the_robot_goes_on_as_before(
    intervals_s: list[float], gap_s: float, carried_m: float
) -> None:
    model, now_s = MotionModel(RegistrationConfig()), 0.0
    for interval_s in intervals_s:
        now_s += interval_s
        model.expect(sweep(now_s))
        model.conclude(Pose2(0.2, 0.0, 0.0))
    expected = model.expect(sweep(now_s + gap_s))
    assert expected.carried.x == pytest.approx(carried_m)
    assert expected.hole == (carried_m > 0.2)
    assert not expected.shortened


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
def test_a_shortened_motion_is_told_where_used(last: Pose2, now: Sweep, shortened: bool) -> None:
    assert after(last, now).shortened == shortened


BOTH = (True, True)


def learnt(motion: Pose2, away: Pose2, reliance: Reliance = UNKNOWN) -> Reliance:
    """The reliance after sixty registrations that were all as far from odometry."""
    for _ in range(60):
        reliance = reliance.after(motion, away, away, BOTH)
    return reliance


@given(poses, poses)
@example(Pose2(0.75, 0.0, 0.0), IDENTITY)
def test_an_unknown_odometry_is_held_to_what_wheels_err(motion: Pose2, away: Pose2) -> None:
    """In its place or its turn: by a little at rest, and by a share of what it measured."""
    way_m = math.hypot(motion.x, motion.y)
    place = math.hypot(away.x, away.y) / (0.05 + 0.2 * way_m)
    turn = abs(away.theta) / (0.03 + 0.3 * abs(motion.theta) + 0.03 * way_m)
    assert UNKNOWN.slacks(motion, away) == pytest.approx(max(place, turn))
    assert UNKNOWN.trusted


def test_bad_odometry_widens_the_slack_and_loses_trust() -> None:
    step = Pose2(0.5, 0.0, 0.0)
    bad = learnt(step, Pose2(0.3, 0.0, 0.0))  # two slacks
    assert not bad.trusted
    assert bad.slacks(step, Pose2(0.4, 0.0, 0.0)) < 1.0
    assert not bad.slacks(step, Pose2(0.46, 0.0, 0.0)) < 1.0  # never more than three slacks
    assert not bad.slacks(step, Pose2(0.0, 0.16, 0.0)) < 1.0  # it errs along the way alone
    again = learnt(step, IDENTITY, bad)
    assert again.trusted  # what was long ago is forgotten
    assert len(again.along) == len(again.turn) == 60


def test_a_fifth_of_wrong_registrations_does_not_spoil_the_measure() -> None:
    step, reliance = Pose2(0.5, 0.0, 0.0), UNKNOWN
    for k in range(60):
        away = Pose2(0.9 if k % 7 == 0 else 0.01, 0.0, 0.0)
        reliance = reliance.after(step, away, away, BOTH)
    assert reliance.trusted
    assert not reliance.slacks(step, Pose2(0.2, 0.0, 0.0)) < 1.0


def test_a_pose_that_odometry_pulled_does_not_flatter_it() -> None:
    """Walls that err twice as much: a fifth of the deviation stays, and odometry's own is found."""
    step, reliance = Pose2(0.5, 0.0, 0.0), UNKNOWN
    for away_m in np.random.default_rng(1).normal(0.0, math.hypot(0.05, 0.1), 60).tolist():
        away, aligned = Pose2(0.2 * away_m, 0.0, 0.0), Pose2(away_m, 0.0, 0.0)
        reliance = reliance.after(step, away, aligned, BOTH)
    assert reliance.limits.along_m == pytest.approx(1.0, rel=0.25)  # it would be 0.5, or 2.2


@given(st.floats(-math.pi, math.pi), st.floats(-2.0, 2.0), st.floats(0.1, 3.0))
def test_along_and_across_are_of_the_way_driven(heading: float, turn: float, way_m: float) -> None:
    """Sideways, backwards or on an arc: a deviation along the way is one along the way."""
    motion = Pose2(way_m * math.cos(heading), way_m * math.sin(heading), turn)
    seen_from_end = motion.inverse() @ Pose2(2 * motion.x, 2 * motion.y, turn)
    assert np.allclose(np.array(direction_of(motion)) * way_m, seen_from_end[:2], atol=1e-9)
    longer = Pose2(0.1 * seen_from_end.x / way_m, 0.1 * seen_from_end.y / way_m, 0.0)
    reliance = UNKNOWN.after(motion, longer, longer, BOTH)
    assert reliance.along[0] == pytest.approx(0.1 / (0.05 + 0.2 * way_m))
    assert reliance.across[0] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("away", "motion", "near"),
    [
        (Pose2(0.099, 0.0, 0.119), IDENTITY, True),
        (Pose2(0.101, 0.0, 0.0), IDENTITY, False),
        (Pose2(0.0, 0.0, 0.121), IDENTITY, False),
        (Pose2(0.29, 0.0, 0.0), Pose2(1.0, 0.0, 0.0), True),
    ],
)
def test_a_carried_motion_errs_as_robots_speed_up(away: Pose2, motion: Pose2, near: bool) -> None:
    start = Pose2(2.0, 1.0, 0.5)

    def agrees(reliance: Reliance, *, measured: bool, slacks: float = 1.0) -> bool:
        guess = guess_of(start, expecting(motion, measured=measured), reliance)
        return guess.agrees(Fit(pose=(start @ away).matrix(), score=0.5), slacks)

    worthless = learnt(Pose2(0.5, 0.0, 0.0), Pose2(0.9, 0.9, 0.9))
    for reliance in (UNKNOWN, worthless):  # odometry's worth does not matter without it
        assert agrees(reliance, measured=False) == near
    assert agrees(worthless, measured=True, slacks=3.0)


AHEAD, ASIDE = Pose2(0.5, 0.0, 0.0), Pose2(0.0, 0.5, 0.0)


def scan_of(half_x: float, half_y: float, noise_m: float = 0.0) -> PlanarScan:
    """A laser amid a box; what lies beyond 8 m returns nothing."""
    bearings = np.linspace(-math.pi, math.pi, 360, endpoint=False)
    to_end = half_x / np.maximum(np.abs(np.cos(bearings)), 1e-9)
    ranges = np.minimum(to_end, half_y / np.maximum(np.abs(np.sin(bearings)), 1e-9))
    ranges += np.random.default_rng(0).normal(0.0, noise_m, 360) if noise_m else 0.0
    return PlanarScan(0, bearings, np.where(ranges < 8.0, ranges, np.inf), 8.0, full_circle=True)


@pytest.mark.parametrize("noise_m", [0.0, 0.003])
@pytest.mark.parametrize(
    ("half_x", "half_y", "motion", "fixed"),
    [
        (3.0, 2.0, AHEAD, (True, True)),
        (50.0, 1.0, AHEAD, (False, True)),
        (50.0, 1.0, ASIDE, (True, False)),
        (1.0, 50.0, AHEAD, (True, False)),
        (50.0, 1.0, IDENTITY, (False, True)),
    ],
)
def test_a_corridor_fixes_the_place_across_it_only(
    half_x: float, half_y: float, motion: Pose2, fixed: tuple[bool, bool], noise_m: float
) -> None:
    assert fixed_directions(scan_of(half_x, half_y, noise_m), IDENTITY, motion) == fixed


@pytest.mark.parametrize("reading", [np.inf, np.nan])
def test_a_mounting_turns_the_directions_and_without_walls_none_is_fixed(reading: float) -> None:
    scan = scan_of(50.0, 1.0)
    assert fixed_directions(scan, Pose2(0.2, 0.1, math.pi / 2), AHEAD) == (True, False)
    blank = dataclasses.replace(scan, ranges=np.full(360, reading))
    assert fixed_directions(blank, IDENTITY, AHEAD) == (False, False)
