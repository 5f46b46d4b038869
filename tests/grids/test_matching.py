"""Answers of the search: within the prior, all that differ, the best first."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given

from specmap_cli.core.geometry import FloatArray, Pose2, wrap_angle
from specmap_cli.grids.matching import Prior, answers
from specmap_cli.grids.score_field import ScoreField
from tests.strategies import few, seeds


def scatter(seed: int) -> FloatArray:
    """Random walls of a small place."""
    return np.random.default_rng(seed).uniform(-4.0, 4.0, (60, 2))


@few(8)
@given(seeds)
def test_a_place_within_the_prior_is_the_first_answer(seed: int) -> None:
    rng, points = np.random.default_rng(seed), scatter(seed)
    there = Pose2(*rng.uniform((-9.0, -9.0, -3.0), (9.0, 9.0, 3.0)).tolist())
    field = ScoreField.from_points(there.apply(points), 0.1, 0.15)
    off = rng.uniform(-1.0, 1.0, 3) * (5.0, 1.0, 0.4)
    guess = Pose2(there.x + off[0], there.y + off[1], there.theta + off[2])
    prior = Prior(guess, np.diag([2.0, 0.6, 0.2]) ** 2)
    found = answers(field, points, prior, 0.3, 0.04)
    assert np.hypot(found[0].pose.x - there.x, found[0].pose.y - there.y) < 0.5
    assert abs(wrap_angle(found[0].pose.theta - there.theta)) < 0.06
    assert [one.score for one in found] == sorted((one.score for one in found), reverse=True)


def test_two_places_alike_are_two_answers_and_the_prior_leaves_one() -> None:
    points = scatter(3)
    field = ScoreField.from_points(np.concatenate([points, points + (0.0, 12.0)]), 0.1, 0.15)
    wide = Prior(Pose2(0.0, 6.0, 0.0), np.diag([0.3, 3.0, 0.05]) ** 2)
    first, second = sorted(one.pose.y for one in answers(field, points, wide, 0.3, 0.04)[:2])
    assert [first, second] == pytest.approx([0.0, 12.0], abs=0.4)
    narrow = Prior(Pose2(0.0, 11.0, 0.0), np.diag([0.3, 1.0, 0.05]) ** 2)
    assert all(one.pose.y > 7.0 for one in answers(field, points, narrow, 0.3, 0.04))
    anywhere = answers(field, points, Prior(Pose2(0.0, 0.0, 0.0)), 0.3, 0.04)
    assert {round(one.pose.y / 12.0) for one in anywhere[:2]} == {0, 1}


def test_where_no_wall_is_there_is_no_answer() -> None:
    field = ScoreField.from_points(scatter(1), 0.1, 0.15)
    prior = Prior(Pose2(90.0, 0.0, 0.0), np.diag([0.3, 0.3, 0.05]) ** 2)
    assert answers(field, scatter(1), prior, 0.3, 0.04) == []


def test_a_guess_turns_as_far_as_its_error() -> None:
    angles = Prior(Pose2(10.0, 5.0, 0.5), np.diag([4.0, 0.01, 0.1**2])).angles(0.05)
    assert angles.min() == pytest.approx(0.2, abs=0.051)
    assert angles.max() == pytest.approx(0.8, abs=0.051)
    unknown = Prior(Pose2(0.0, 0.0, 0.0), np.diag([1.0, 1.0, 100.0]))
    assert np.ptp(unknown.angles(0.1)) == pytest.approx(2 * np.pi, abs=0.2)
