"""What odometry has been worth: a cautious start, narrower or wider by what registration found."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.geometry import IDENTITY, Pose2
from specmap_cli.registration.guess import MotionGuess
from specmap_cli.registration.local_map import Fit
from specmap_cli.registration.motion import UNKNOWN, ExpectedMotion, Reliance, direction_of
from tests.strategies import seeds

BOTH = (True, True)


def learnt(motion: Pose2, away: Pose2, times: int, fixed: tuple[bool, bool] = BOTH) -> Reliance:
    """The reliance after so many registrations that were all as far from odometry."""
    reliance = UNKNOWN
    for _ in range(times):
        reliance = reliance.after(motion, away, fixed)
    return reliance


@pytest.mark.parametrize(
    ("motion", "away", "allowed"),
    [
        # at rest odometry may err by 5 cm and 0.03 rad
        (IDENTITY, Pose2(0.049, 0.0, 0.0), True),
        (IDENTITY, Pose2(0.0, -0.051, 0.0), False),
        (IDENTITY, Pose2(0.0, 0.0, -0.029), True),
        (IDENTITY, Pose2(0.0, 0.0, 0.031), False),
        # and by a share of what it measured, however long the step
        (Pose2(0.4, 0.0, 0.0), Pose2(0.129, 0.0, 0.0), True),
        (Pose2(0.4, 0.0, 0.0), Pose2(0.131, 0.0, 0.0), False),
        (Pose2(0.0, 0.0, -0.4), Pose2(0.0, 0.0, 0.149), True),
        (Pose2(0.0, 0.0, -0.4), Pose2(0.0, 0.0, 0.151), False),
        (Pose2(5.0, 0.0, 0.0), Pose2(0.0, 1.04, 0.17), True),
        (Pose2(5.0, 0.0, 0.0), Pose2(0.0, 1.06, 0.0), False),
        (Pose2(0.0, 0.0, 2.0), Pose2(0.0, 0.0, 0.62), True),
    ],
)
def test_an_unknown_odometry_is_held_to_what_wheels_err(
    motion: Pose2, away: Pose2, allowed: bool
) -> None:
    assert (UNKNOWN.slacks(motion, away) < 1.0) == allowed
    assert UNKNOWN.trusted


def test_exact_odometry_narrows_the_slack_to_half_and_no_further() -> None:
    step = Pose2(0.5, 0.0, 0.0)
    few, many = (learnt(step, IDENTITY, times) for times in (20, 200))
    before = UNKNOWN.slack(step)
    assert few.slack(step).along_m == pytest.approx(before.along_m)  # the prior wears off slowly
    for narrow, wide in zip(
        (many.slack(step).along_m, many.slack(step).across_m, many.slack(step).turn_rad),
        (before.along_m, before.across_m, before.turn_rad),
        strict=True,
    ):
        assert narrow == pytest.approx(wide / 2)


def test_bad_odometry_widens_the_slack_and_loses_trust() -> None:
    step = Pose2(0.5, 0.0, 0.0)
    bad = learnt(step, Pose2(0.3, 0.0, 0.0), 60)  # two slacks
    assert not bad.trusted
    assert bad.slacks(step, Pose2(0.4, 0.0, 0.0)) < 1.0
    assert not bad.slacks(step, Pose2(0.46, 0.0, 0.0)) < 1.0  # never more than three slacks
    assert not bad.slacks(step, Pose2(0.0, 0.16, 0.0)) < 1.0  # it errs along the way alone
    again = bad
    for _ in range(60):
        again = again.after(step, IDENTITY, BOTH)
    assert again.trusted  # what was long ago is forgotten


def test_a_fifth_of_wrong_registrations_does_not_spoil_the_measure() -> None:
    step, reliance = Pose2(0.5, 0.0, 0.0), UNKNOWN
    for k in range(60):
        reliance = reliance.after(step, Pose2(0.9 if k % 7 == 0 else 0.01, 0.0, 0.0), BOTH)
    assert reliance.trusted
    assert not reliance.slacks(step, Pose2(0.2, 0.0, 0.0)) < 1.0


@pytest.mark.parametrize("fixed", [(False, True), (True, False), (False, False)])
def test_directions_that_walls_do_not_fix_say_nothing(fixed: tuple[bool, bool]) -> None:
    reliance = learnt(Pose2(0.5, 0.0, 0.0), Pose2(0.3, 0.3, 0.0), 30, fixed)
    assert len(reliance.along) == 30 * fixed[0]
    assert len(reliance.across) == 30 * fixed[1]
    assert len(reliance.turn) == 30


@given(st.floats(-math.pi, math.pi), st.floats(-2.0, 2.0), st.floats(0.1, 3.0))
def test_along_and_across_are_those_of_the_way_driven(
    heading: float, turn: float, way_m: float
) -> None:
    """Sideways, backwards or on an arc: a deviation along the way is one along the way."""
    motion = Pose2(way_m * math.cos(heading), way_m * math.sin(heading), turn)
    seen_from_end = motion.inverse() @ Pose2(2 * motion.x, 2 * motion.y, turn)
    assert np.allclose(np.array(direction_of(motion)) * way_m, seen_from_end[:2], atol=1e-9)
    longer = Pose2(0.1 * seen_from_end.x / way_m, 0.1 * seen_from_end.y / way_m, 0.0)
    reliance = UNKNOWN.after(motion, longer, BOTH)
    assert reliance.along[0] == pytest.approx(0.1 / (0.05 + 0.2 * way_m))
    assert reliance.across[0] == pytest.approx(0.0, abs=1e-9)


@given(seeds)
def test_values_are_not_changed_and_memory_is_bounded(seed: int) -> None:
    rng = np.random.default_rng(seed)
    reliance, lengths = UNKNOWN, []
    for _ in range(80):
        after = reliance.after(Pose2(*rng.normal(size=3)), Pose2(*rng.normal(size=3)), BOTH)
        assert after is not reliance
        reliance = after
        lengths.append(len(reliance.along))
    assert UNKNOWN.along == ()
    assert max(lengths) == 60
    assert 0.5 <= reliance.limits.along_m <= 3.0


def expecting(motion: Pose2, *, measured: bool) -> ExpectedMotion:
    return ExpectedMotion(
        motion=motion,
        carried=motion,
        during=motion,
        interval_s=0.1,
        measured=measured,
        jumped=False,
        shortened=False,
    )


@pytest.mark.parametrize(
    ("away", "motion", "near"),
    [
        (Pose2(0.099, 0.0, 0.119), IDENTITY, True),
        (Pose2(0.101, 0.0, 0.0), IDENTITY, False),
        (Pose2(0.0, 0.0, 0.121), IDENTITY, False),
        (Pose2(0.29, 0.0, 0.0), Pose2(1.0, 0.0, 0.0), True),
    ],
)
def test_a_motion_carried_on_errs_by_how_a_robot_speeds_up(
    away: Pose2, motion: Pose2, near: bool
) -> None:
    start = Pose2(2.0, 1.0, 0.5)

    def agrees(reliance: Reliance, *, measured: bool, slacks: float = 1.0) -> bool:
        guess = MotionGuess(
            pose=start.matrix(),
            before=(start @ motion.inverse()).matrix(),
            expected=expecting(motion, measured=measured),
            by_motion=start,
            reliance=reliance,
        )
        return guess.agrees(Fit(pose=(start @ away).matrix(), score=0.5), slacks)

    worthless = learnt(Pose2(0.5, 0.0, 0.0), Pose2(0.9, 0.9, 0.9), 60)
    for reliance in (UNKNOWN, worthless):  # odometry's worth does not matter without it
        assert agrees(reliance, measured=False) == near
    assert agrees(worthless, measured=True, slacks=3.0)


def test_slacks_count_how_far_a_result_is_off_by_place_or_turn() -> None:
    step = Pose2(0.75, 0.0, 0.0)  # an unknown odometry errs by 0.2 m and 0.0525 rad
    assert UNKNOWN.slacks(step, IDENTITY) == 0.0
    assert UNKNOWN.slacks(step, Pose2(0.4, 0.0, 0.0)) == pytest.approx(2.0)
    assert UNKNOWN.slacks(step, Pose2(0.3, 0.4, 0.0)) == pytest.approx(2.5)
    assert UNKNOWN.slacks(step, Pose2(0.4, 0.0, -0.2100)) == pytest.approx(4.0)


def test_a_way_may_be_trusted_where_turns_are_not() -> None:
    step = Pose2(0.5, 0.0, 0.0)
    turning_badly = learnt(step, Pose2(0.0, 0.0, 0.2), 60)
    assert turning_badly.trusted_place
    assert not turning_badly.trusted
    assert not learnt(step, Pose2(0.3, 0.0, 0.0), 60).trusted_place
    assert turning_badly.place_slacks(step, Pose2(0.15, 0.0, 2.0)) == pytest.approx(2.0)
