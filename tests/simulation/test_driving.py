"""Drives keep to the robot's limits on any path."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from specmap_cli.core.geometry import FloatArray, path_length, step_lengths
from specmap_cli.simulation.tours import Drive, Limits, drive
from tests.strategies import seeds

USUAL = Limits(speed_mps=0.7, turn_rate_radps=1.2, acceleration_mps2=0.5)


def rates(driven: Drive) -> tuple[FloatArray, FloatArray]:
    """Metres and radians a second between the poses of a drive."""
    seconds = np.diff(driven.times_s)
    return step_lengths(driven.poses) / seconds, np.abs(np.diff(driven.poses[:, 2])) / seconds


def winding(seed: int, points: int, step_m: float) -> FloatArray:
    """A path (N, 2) of equal steps whose heading wanders, now and then by a sharp corner."""
    rng = np.random.default_rng(seed)
    turns = np.where(rng.random(points) < 0.1, rng.uniform(-3.1, 3.1, points), 0.1)
    headings = np.cumsum(turns * rng.choice([-1, 1], points))
    steps = step_m * np.column_stack([np.cos(headings), np.sin(headings)])
    return np.concatenate([[[0.0, 0.0]], np.cumsum(steps, axis=0)])


@given(seeds, st.integers(2, 60), st.sampled_from([0.02, 0.3, 4.0]))
def test_a_drive_keeps_speed_and_turn_rate_and_passes_every_point(
    seed: int, points: int, step_m: float
) -> None:
    path = winding(seed, points, step_m)
    driven = drive(path, USUAL)
    speeds, turns = rates(driven)
    assert (np.diff(driven.times_s) > 0).all()
    assert speeds.max() <= USUAL.speed_mps + 1e-9
    assert turns.max() <= USUAL.turn_rate_radps + 1e-9
    away, _ = cKDTree(driven.poses[:, :2]).query(path)
    assert away.max() < 1e-9
    assert path_length(driven.poses) == pytest.approx(path_length(path))


@pytest.mark.parametrize("length", [0.1, 0.98, 3.0, 50.0])
def test_a_straight_way_is_driven_as_fast_as_physics_lets(length: float) -> None:
    """Closed form: a triangle of speed over time, or a trapezium once the limit is reached."""
    v, a = USUAL.speed_mps, USUAL.acceleration_mps2
    peak = min(v, np.sqrt(a * length))
    for points in (2, 2000):
        path = np.column_stack([np.linspace(0.0, length, points), np.zeros(points)])
        expected = length / peak + peak / a
        assert drive(path, USUAL).duration_s == pytest.approx(expected, rel=2e-3)


def test_braking_and_speeding_up_stay_within_the_acceleration() -> None:
    path = winding(4, 4000, 0.05)
    driven = drive(path, USUAL)
    speeds, _ = rates(driven)
    middles = 0.5 * (driven.times_s[:-1] + driven.times_s[1:])
    # speeds are averages between points, so that the first of a standstill looks like a jump
    gentle = np.abs(np.diff(speeds)) <= USUAL.acceleration_mps2 * np.diff(middles) + 1e-6
    assert gentle.mean() > 0.9


def test_the_robot_looks_where_it_drives_and_turns_in_place_at_corners() -> None:
    corner = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [1.0, 0.0]])
    driven = drive(corner, Limits(1.0, 1.0, 0.5))
    moving = step_lengths(driven.poses) > 1e-9
    headings = driven.poses[1:][moving][:, 2]
    np.testing.assert_allclose(headings, [0.0, np.pi / 2, -np.pi / 2], atol=1e-9)
    # the ease of a turn is 1.5 times as steep in its middle as on average
    turning_s = 1.5 * (np.pi / 2 + np.pi)
    assert driven.duration_s == pytest.approx(3 * 2 * np.sqrt(1.0 / 0.5) + turning_s)


def test_a_gentle_bend_is_rounded_without_a_stop() -> None:
    path = np.array([[0.0, 0.0], [2.0, 0.0], [4.0, 0.6]])
    driven = drive(path, USUAL)
    assert len(driven.times_s) == 3
    assert driven.poses[1, 2] == pytest.approx(0.5 * np.arctan2(0.6, 2.0))


@pytest.mark.parametrize("places", [1, 2, 5])
def test_a_path_of_one_place_is_a_robot_that_stands(places: int) -> None:
    driven = drive(np.array([[2.0, 3.0]] * places), USUAL)
    assert driven.duration_s == 0.0
    np.testing.assert_array_equal(driven.at(np.array([0.0, 9.0])), [[2.0, 3.0, 0.0]] * 2)


def test_repeated_points_change_nothing() -> None:
    path = winding(5, 30, 0.2)
    twice = np.repeat(path, 2, axis=0)
    np.testing.assert_array_equal(drive(twice, USUAL).poses, drive(path, USUAL).poses)
    np.testing.assert_array_equal(drive(twice, USUAL).times_s, drive(path, USUAL).times_s)


def test_before_the_start_and_after_the_end_the_robot_stands() -> None:
    driven = drive(np.array([[0.0, 0.0], [1.0, 1.0]]), USUAL)
    ends = driven.at(np.array([-5.0, 0.0, driven.duration_s, 1e6]))
    np.testing.assert_array_equal(ends[0], ends[1])
    np.testing.assert_array_equal(ends[2], ends[3])
    np.testing.assert_allclose(ends[:, 2], np.pi / 4)
