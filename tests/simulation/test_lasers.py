"""Simulated lasers and odometry err as they are told to, and not otherwise."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.geometry import FloatArray, Pose2, compose, invert
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.simulation.driving import Drive, drive
from specmap_cli.simulation.lasers import (
    Laser,
    OdometryErrors,
    drifting_odometry,
    laser_bearings,
)
from specmap_cli.simulation.worlds import World

LEFT, RIGHT, BOTTOM, TOP = 1.0, 6.0, 0.5, 4.5
STILL = Drive(np.zeros(1), np.array([[3.0, 2.0, 0.7]]))
RNG_SEED = 11


@pytest.fixture(scope="module")
def hall() -> World:
    """One empty room of 5 m x 4 m."""
    cells = np.full((100, 140), OCCUPIED, dtype=np.uint8)
    cells[10:90, 20:120] = FREE
    return World.of(GridMap(cells, 0.05))


def true_ranges(x: float, y: float, angles: FloatArray) -> FloatArray:
    """Distances to the walls of `hall` in closed form."""
    c, s = np.cos(angles), np.sin(angles)
    to_x = np.where(c > 0, RIGHT - x, LEFT - x) / np.where(np.abs(c) < 1e-12, 1e-12, c)
    to_y = np.where(s > 0, TOP - y, BOTTOM - y) / np.where(np.abs(s) < 1e-12, 1e-12, s)
    return np.minimum(np.abs(to_x), np.abs(to_y))


def measure(laser: Laser, world: World, times: int = 1) -> FloatArray:
    rng = np.random.default_rng(RNG_SEED)
    return np.array(list(laser.scans(world, STILL, 0.1 * np.arange(times, dtype=np.float64), rng)))


def test_without_errors_ranges_are_those_of_the_mounted_laser(hall: World) -> None:
    mounting = Pose2(0.3, -0.1, np.pi / 2)
    laser = Laser(laser_bearings(np.radians(270), 181), 20.0, mounting)
    at = Pose2(3.0, 2.0, 0.7) @ mounting
    expected = true_ranges(at.x, at.y, laser.bearings + at.theta)
    np.testing.assert_allclose(measure(laser, hall)[0], expected, atol=1e-5)


def test_noise_has_the_asked_spread_and_no_bias(hall: World) -> None:
    laser = Laser(laser_bearings(2 * np.pi, 360), 20.0, Pose2(0, 0, 0), noise_m=0.02, step_m=0.001)
    errors = measure(laser, hall, 40) - true_ranges(3.0, 2.0, laser.bearings + 0.7)
    assert abs(errors.mean()) < 4 * 0.02 / np.sqrt(errors.size)
    assert errors.std() == pytest.approx(0.02, rel=0.05)
    np.testing.assert_allclose(
        np.round(measure(laser, hall) / 0.001), measure(laser, hall) / 0.001, atol=1e-3
    )


def test_dropouts_and_far_walls_are_beams_without_a_return(hall: World) -> None:
    bearings = laser_bearings(2 * np.pi, 360)
    dropped = measure(Laser(bearings, 20.0, Pose2(0, 0, 0), dropouts=0.2), hall, 40)
    assert np.isinf(dropped).mean() == pytest.approx(0.2, abs=0.02)
    short = measure(Laser(bearings, 2.1, Pose2(0, 0, 0)), hall)[0]
    expected = true_ranges(3.0, 2.0, bearings + 0.7)
    np.testing.assert_array_equal(np.isinf(short), expected > 2.1)


def test_beams_of_a_sweep_are_cast_from_where_the_robot_then_is(hall: World) -> None:
    turning = Drive(np.array([0.0, 1.0]), np.array([[3.0, 2.0, 0.0], [3.5, 2.5, 2.0]]))
    laser = Laser(laser_bearings(np.pi, 91), 20.0, Pose2(0.1, 0.0, 0.0), sweep_s=0.1)
    rng = np.random.default_rng(RNG_SEED)
    ranges = next(laser.scans(hall, turning, np.array([0.4]), rng))

    def off_walls(map_from_base: FloatArray) -> FloatArray:
        map_from_laser = compose(map_from_base, np.array([0.1, 0.0, 0.0]))
        angles = laser.bearings + map_from_laser[..., 2]
        x = map_from_laser[..., 0] + ranges * np.cos(angles)
        y = map_from_laser[..., 1] + ranges * np.sin(angles)
        to_walls = np.stack([x - LEFT, x - RIGHT, y - BOTTOM, y - TOP])
        return np.asarray(np.abs(to_walls).min(axis=0), dtype=np.float64)

    assert off_walls(turning.at(0.4 + laser.beam_times_s)).max() < 1e-4
    assert off_walls(turning.at(np.array(0.4))).max() > 0.1


def test_a_full_circle_has_no_bearing_twice() -> None:
    full = laser_bearings(2 * np.pi, 8)
    np.testing.assert_allclose(np.diff(full), np.pi / 4)
    assert full[-1] == pytest.approx(np.pi - np.pi / 4)
    half = laser_bearings(np.pi, 5)
    np.testing.assert_allclose(half, [-np.pi / 2, -np.pi / 4, 0, np.pi / 4, np.pi / 2])


def zigzag() -> FloatArray:
    path = np.array([[0, 0], [4, 0], [4, 3], [1, 3], [1, 1], [3, 1]], dtype=np.float64)
    driven = drive(path + 5.0, 0.5, 1.0)
    return driven.at(np.arange(0.0, driven.duration_s, 0.1))


@given(st.integers(0, 1000))
def test_odometry_without_errors_is_the_truth_seen_from_the_start(seed: int) -> None:
    poses = zigzag()
    found = drifting_odometry(poses, OdometryErrors().times(0.0), np.random.default_rng(seed))
    np.testing.assert_allclose(compose(found, invert(found)), np.zeros_like(found), atol=1e-9)
    expected = compose(invert(poses[0]), poses)
    np.testing.assert_allclose(found[:, :2], expected[:, :2], atol=1e-9)
    np.testing.assert_allclose(np.cos(found[:, 2] - expected[:, 2]), 1.0, atol=1e-12)


def test_random_odometry_errors_spread_with_the_root_of_the_way_at_any_rate() -> None:
    errors = OdometryErrors(0.05, 0.03, 0.0, 0.0, 0.0, 0.0)
    for step in (0.01, 0.1):
        straight = np.zeros((round(4.0 / step) + 1, 3))
        straight[:, 0] = np.arange(len(straight)) * step
        ends = np.array(
            [drifting_odometry(straight, errors, np.random.default_rng(s))[-1] for s in range(400)]
        )
        assert ends[:, 2].std() == pytest.approx(0.03 * 2.0, rel=0.15)
        assert ends[:, 2].mean() == pytest.approx(0.0, abs=0.012)
        assert ends[:, 0].std() == pytest.approx(0.05 * 2.0, rel=0.15)


def test_calibration_errors_scale_way_and_turns() -> None:
    errors = OdometryErrors(0.0, 0.0, 0.0, 0.1, 0.05, 0.0)
    poses = np.array([[0, 0, 0], [2, 0, 0], [2, 0, np.pi / 2], [2, 1, np.pi / 2]], dtype=np.float64)
    end = drifting_odometry(poses, errors, np.random.default_rng(0))[-1]
    assert end[2] == pytest.approx(1.05 * np.pi / 2)
    assert end[0] == pytest.approx(2.2 + 1.1 * np.cos(1.05 * np.pi / 2))
    veering = drifting_odometry(
        poses[:2], OdometryErrors(0, 0, 0, 0, 0, 0.02), np.random.default_rng(0)
    )
    assert veering[-1, 2] == pytest.approx(0.04)
