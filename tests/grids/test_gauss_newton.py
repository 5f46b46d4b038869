"""The last centimetres of a match, against SciPy's interpolation and its minimiser."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import RegularGridInterpolator
from scipy.optimize import minimize

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.grids.score_field import SIGMA_M, Sample, ScoreField, approach, descend
from tests.strategies import few, seeds

small = st.floats(-0.06, 0.06)


def cost(field: ScoreField, points: FloatArray, pose: Pose2) -> float:
    """Sum (1 - M(p))^2."""
    return float(((1.0 - Sample.of(field, points.T, pose).values) ** 2).sum())


def random_field(seed: int) -> ScoreField:
    values = np.random.default_rng(seed).random((9, 13), dtype=np.float32)
    return ScoreField(values, 0.5, (-1.0, 2.0))


@given(seeds)
def test_values_between_cell_centres_are_scipy_s(seed: int) -> None:
    field = random_field(seed)
    rng = np.random.default_rng(seed + 1)
    pose, points = Pose2(*rng.uniform(-1, 1, 3).tolist()), rng.uniform(-3, 9, (50, 2))
    height, width = field.values.shape
    centres = (
        2.0 + 0.5 * (np.arange(height) + 0.5),
        -1.0 + 0.5 * (np.arange(width) + 0.5),
    )
    oracle = RegularGridInterpolator(centres, field.values, bounds_error=False, fill_value=0.0)
    values = Sample.of(field, points.T, pose).values
    np.testing.assert_allclose(values, oracle(pose.apply(points)[:, ::-1]), atol=1e-6)


@given(seeds)
def test_the_derivative_is_that_of_finite_differences(seed: int) -> None:
    field = random_field(seed)
    rng = np.random.default_rng(seed + 1)
    pose, points = Pose2(*rng.uniform(-1, 1, 3).tolist()), rng.uniform(0, 5, (50, 2))
    jacobian = Sample.of(field, points.T, pose).equations()[:3]
    step = 1e-5
    for axis in range(3):
        ahead, behind = (np.array(pose) + sign * step * np.eye(3)[axis] for sign in (1, -1))
        numeric = (
            Sample.of(field, points.T, Pose2(*ahead.tolist())).values
            - Sample.of(field, points.T, Pose2(*behind.tolist())).values
        ) / (2 * step)
        smooth = np.abs(numeric - jacobian[axis]) < 0.02
        assert smooth.mean() >= 0.95  # all but those that pass from cell to cell in the step


@given(small, small, small)
@few(15)
def test_the_descent_ends_where_scipy_s_does(
    field: ScoreField, room: FloatArray, dx: float, dy: float, turn: float
) -> None:
    guess, points = Pose2(dx, dy, turn), room[::5]
    found = descend(field, points, guess, 20, 0.3)
    best = minimize(
        lambda pose: cost(field, points, Pose2(*pose)),
        np.array(guess),
        method="Nelder-Mead",
        options={"initial_simplex": np.array(guess) + 0.02 * np.vstack([np.zeros(3), np.eye(3)])},
    )
    assert cost(field, points, found) <= best.fun + 0.01


@given(seeds, st.floats(0.0, 0.5), st.integers(0, 6))
def test_the_descent_never_makes_it_worse_nor_leaves_its_reach(
    field: ScoreField, room: FloatArray, seed: int, reach: float, iterations: int
) -> None:
    guess = Pose2(*np.random.default_rng(seed).uniform(-1.0, 1.0, 3).tolist())
    found = descend(field, room[::5], guess, iterations, reach)
    assert (guess.inverse() @ found).distance <= reach + 1e-9
    assert cost(field, room[::5], found) <= cost(field, room[::5], guess) + 1e-9
    if not iterations:
        assert found == pytest.approx(guess)


@pytest.mark.parametrize("points", [0, 1, 2])
def test_too_few_points_leave_the_guess_as_it_is(field: ScoreField, points: int) -> None:
    guess = Pose2(0.1, 0.2, 0.3)
    assert descend(field, np.zeros((points, 2)), guess, 20, 0.3) == guess
    assert approach(field, np.zeros((points, 2)), guess, SIGMA_M) == guess


def test_a_field_of_one_cell_moves_nothing() -> None:
    speck = ScoreField(np.ones((1, 1), dtype=np.float32), 0.1, (0.0, 0.0))
    guess = Pose2(0.01, 0.02, 0.0)
    assert descend(speck, np.random.default_rng(0).random((9, 2)), guess, 20, 0.3) == guess


def test_a_single_wall_draws_the_pose_across_it_and_not_along() -> None:
    wall = np.column_stack([np.linspace(-4, 4, 200), np.full(200, 0.025)])
    field = ScoreField.from_points(wall)
    found = descend(field, wall[50:150], Pose2(0.2, 0.08, 0.03), 20, 0.3)
    assert found.y == pytest.approx(0.0, abs=0.01)
    assert found.theta == pytest.approx(0.0, abs=0.005)
    assert found.x == pytest.approx(0.2, abs=0.05)


@given(small, small, small)
def test_the_way_ends_some_millimetres_from_the_match(
    field: ScoreField, room: FloatArray, dx: float, dy: float, turn: float
) -> None:
    found = approach(field, room[::5], Pose2(dx, dy, turn), SIGMA_M)
    best = descend(field, room[::5], found, 30, 0.3)
    assert math.dist(found[:2], best[:2]) < 0.01
    assert found.theta == pytest.approx(best.theta, abs=0.005)


def test_the_way_follows_what_half_a_sigma_tells_apart() -> None:
    wall = np.column_stack([np.linspace(-4.0, 4.0, 400), np.full(400, 0.025)])
    double = np.vstack([wall, wall + (0.0, 0.15)])  # its second one, a sigma and a half behind it
    field = ScoreField.from_points(double)
    near = approach(field, wall[100:300], Pose2(0.0, 0.03, 0.0), SIGMA_M)
    assert near.y == pytest.approx(0.0, abs=0.01)


def test_along_a_bare_corridor_the_way_stays_at_the_guess() -> None:
    rng = np.random.default_rng(0)
    x = rng.uniform(-4.0, 4.0, 300)
    walls = np.column_stack([x, np.where(x * 1e3 % 1.0 < 0.5, 0.025, 2.025)])
    field = ScoreField.from_points(walls)
    seen = walls[np.abs(x) < 3.0] + rng.normal(0.0, 0.01, 2)
    found = approach(field, seen, Pose2(0.3, 0.05, 0.02), SIGMA_M)
    assert found.x == pytest.approx(0.3, abs=0.05)
    assert found.y == pytest.approx(0.0, abs=0.02)
