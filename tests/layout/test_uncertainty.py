"""Errors of steps added up along a path, against what many random paths come to."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.geometry import FloatArray, compose, invert
from specmap_cli.layout.uncertainty import Uncertainty, misfit, surprise
from tests.layout.driving import SOFT, between, graph_by_hand, true_link
from tests.strategies import pose_arrays


def bend(count: int = 40) -> FloatArray:
    """Poses half a metre apart along a curve."""
    poses = np.zeros((count, 3))
    for k in range(1, count):
        poses[k] = compose(poses[k - 1], np.array([0.5, 0.0, 0.05]))
    return poses


def sampled(poses: FloatArray, i: int, j: int, runs: int = 4000) -> FloatArray:
    """Errors (runs, 3) of pose j seen from i, of paths whose steps err as SOFT says."""
    rng = np.random.default_rng(1)
    sigma = np.sqrt(np.diag(np.linalg.inv(SOFT))) / 5  # small, where the first order is enough
    steps = compose(invert(poses[:-1]), poses[1:])
    seen = np.tile(poses[i], (runs, 1))
    for k in range(i, j):
        seen = compose(compose(seen, steps[k]), rng.normal(0, 1, (runs, 3)) * sigma)
    return compose(invert(compose(invert(poses[i]), poses[j])), compose(invert(poses[i]), seen))


@pytest.mark.parametrize(("i", "j"), [(0, 39), (5, 6), (10, 30)])
def test_it_is_what_random_paths_come_to(i: int, j: int) -> None:
    poses = bend()
    graph = graph_by_hand(poses)
    spread = Uncertainty.along(poses, graph.odometry, 0.0)
    expected = np.cov(sampled(poses, i, j).T) * 25
    found = spread.between(np.array([i]), np.array([j]))[0]
    assert np.allclose(found, expected, rtol=0.1, atol=0.05 * np.abs(expected).max())


def test_the_way_back_is_known_as_well_and_a_place_from_itself_exactly() -> None:
    poses = bend()
    spread = Uncertainty.along(poses, graph_by_hand(poses).odometry, 0.1)
    there = spread.between(np.array([3, 7]), np.array([30, 7]))
    back = spread.between(np.array([30]), np.array([3]))
    assert np.array_equal(there[1], np.zeros((3, 3)))
    assert there[0][2, 2] == pytest.approx(back[0][2, 2])


def test_an_error_that_goes_on_grows_with_the_way() -> None:
    poses = bend()
    motions = graph_by_hand(poses).odometry
    plain, steady = (Uncertainty.along(poses, motions, share) for share in (0.0, 0.02))
    i, j = np.array([0]), np.array([30])
    length = sum(link.source_from_target.distance for link in motions[:30])
    gained = (steady.between(i, j) - plain.between(i, j))[0]
    assert gained == pytest.approx(np.diag([(0.02 * length) ** 2, (0.02 * length) ** 2, 0.0]))


@given(pose_arrays(2))
def test_what_fits_misses_nothing(poses: FloatArray) -> None:
    measured = np.array([true_link(poses, 0, 1).source_from_target])
    missed = misfit(poses, np.array([0]), np.array([1]), measured)
    assert np.abs(missed).max() < 1e-9
    assert between(poses, 0, 1) == pytest.approx(tuple(measured[0]))


@given(st.floats(0.1, 3.0), st.floats(-2.0, 2.0))
def test_surprise_counts_sigmas(sigma: float, away: float) -> None:
    error = np.array([[away * sigma, 0.0, 0.0]])
    found = surprise(error, np.eye(3)[None] * sigma**2)
    assert found[0] == pytest.approx(away**2, abs=1e-9)


def test_a_turn_that_goes_on_moves_what_is_far_aside() -> None:
    """0.002 rad a metre over 10 m: the end, seen from the start, is half of 0.02 rad aside."""
    poses = np.array([(0.5 * k, 0.0, 0.0) for k in range(21)])
    motions = graph_by_hand(poses).odometry
    plain, veering = (Uncertainty.along(poses, motions, 0.0, veer) for veer in (0.0, 0.002))
    i, j = np.array([0]), np.array([20])
    gained = (veering.between(i, j) - plain.between(i, j))[0]
    assert np.diag(gained) == pytest.approx([0.1**2, 0.1**2, 0.02**2])
