"""The simulator: its lasers, planar and 3D, its odometry, its options, and tours of all of them."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.errors import UsageError
from specmap_cli.core.geometry import FloatArray, Pose2, compose, invert, path_length
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.simulation import simulator
from specmap_cli.simulation.simulator import (
    Cloud,
    Laser,
    Lidar,
    OdometryErrors,
    SimulationOptions,
    drifting_odometry,
    simulated_tour,
)
from specmap_cli.simulation.tours import Drive, drive
from specmap_cli.simulation.worlds import World

LEFT, RIGHT, BOTTOM, TOP = 1.0, 6.0, 0.5, 4.5
RNG_SEED = 11
HEIGHT, CEILING = 0.6, 2.4
AT = Pose2(3.0, 2.0, 0.7)
STILL = Drive(np.zeros(1), np.array([AT]))


@pytest.fixture(scope="module")
def hall() -> World:
    """One empty room of 5 m x 4 m."""
    cells = np.full((100, 140), OCCUPIED, dtype=np.uint8)
    cells[10:90, 20:120] = FREE
    return World.of(GridMap(cells, 0.05))


def true_ranges(x: float | FloatArray, y: float | FloatArray, angles: FloatArray) -> FloatArray:
    """Distances to the walls of `hall` in closed form."""
    c, s = np.cos(angles), np.sin(angles)
    to_x = np.where(c > 0, RIGHT - x, LEFT - x) / np.where(np.abs(c) < 1e-12, 1e-12, c)
    to_y = np.where(s > 0, TOP - y, BOTTOM - y) / np.where(np.abs(s) < 1e-12, 1e-12, s)
    return np.minimum(np.abs(to_x), np.abs(to_y))


def laser_of(field_of_view: float, beams: int, **changes: Any) -> Laser:
    """A laser without errors, in the middle of the robot unless told otherwise."""
    bearings = simulator.laser_bearings(field_of_view, beams)
    laser = Laser(bearings=bearings, range_max_m=20.0, base_from_laser=Pose2(0.0, 0.0, 0.0))
    return replace(laser, **changes)


def errors_of(**errors: float) -> OdometryErrors:
    """Wheels that err in the ways named only."""
    return replace(OdometryErrors().times(0.0), **errors)


def measure(laser: Laser, world: World, times: int = 1, driven: Drive = STILL) -> FloatArray:
    rng = np.random.default_rng(RNG_SEED)
    return np.array(list(laser.scans(world, driven, 0.1 * np.arange(times, dtype=np.float64), rng)))


def test_without_errors_ranges_are_those_of_the_mounted_laser(hall: World) -> None:
    mounting = Pose2(0.3, -0.1, np.pi / 2)
    laser = laser_of(np.radians(270), 181, base_from_laser=mounting)
    at = Pose2(3.0, 2.0, 0.7) @ mounting
    expected = true_ranges(at.x, at.y, laser.bearings + at.theta)
    np.testing.assert_allclose(measure(laser, hall)[0], expected, atol=1e-5)


def test_dropouts_and_far_walls_give_no_return_and_ranges_are_rounded(hall: World) -> None:
    dropped = measure(laser_of(2 * np.pi, 360, dropouts=0.2, step_m=0.001), hall, 40)
    assert np.isinf(dropped).mean() == pytest.approx(0.2, abs=0.02)
    steps = dropped[np.isfinite(dropped)] / 0.001
    np.testing.assert_allclose(np.round(steps), steps, atol=1e-3)
    laser = laser_of(2 * np.pi, 360, range_max_m=2.1)
    far = true_ranges(3.0, 2.0, laser.bearings + 0.7) > 2.1
    np.testing.assert_array_equal(np.isinf(measure(laser, hall)[0]), far)


def test_beams_of_a_sweep_are_cast_from_where_the_robot_then_is(hall: World) -> None:
    turning = Drive(np.array([0.0, 1.0]), np.array([[3.0, 2.0, 0.0], [3.5, 2.5, 2.0]]))
    laser = laser_of(np.pi, 91, base_from_laser=Pose2(0.1, 0.0, 0.0), sweep_s=0.1)
    rng = np.random.default_rng(RNG_SEED)
    ranges, off = next(laser.scans(hall, turning, np.array([0.4]), rng)), []
    for times in (0.4 + laser.beam_times_s, np.full(91, 0.4)):
        x, y, theta = compose(turning.at(times), np.array([0.1, 0.0, 0.0])).T
        off.append(np.abs(ranges - true_ranges(x, y, laser.bearings + theta)).max())
    assert off[0] < 1e-4
    assert off[1] > 0.1


@given(st.integers(0, 1000))
def test_odometry_without_errors_is_the_truth_seen_from_the_start(seed: int) -> None:
    path = np.array([[0, 0], [4, 0], [4, 3], [1, 3], [1, 1], [3, 1]], dtype=np.float64)
    driven = drive(path + 5.0, 0.5, 1.0, 0.5)
    poses = driven.at(np.arange(0.0, driven.duration_s, 0.1))
    found = drifting_odometry(poses, OdometryErrors().times(0.0), np.random.default_rng(seed))
    expected = compose(invert(poses[0]), poses)
    np.testing.assert_allclose(found[:, :2], expected[:, :2], atol=1e-9)
    np.testing.assert_allclose(np.cos(found[:, 2] - expected[:, 2]), 1.0, atol=1e-12)


@pytest.mark.parametrize(("turning", "step"), [(0.03, 0.01), (0.03, 0.1), (0.0, 0.05)])
def test_odometry_errors_spread_with_the_root_of_the_way(turning: float, step: float) -> None:
    """And wheels slip less sideways than along."""
    errors = errors_of(translation_per_m=0.05, rotation_per_m=turning)
    straight = np.arange(round(4.0 / step) + 1)[:, None] * np.array([step, 0.0, 0.0])
    drawn = map(np.random.default_rng, range(400))
    x, y, theta = np.array([drifting_odometry(straight, errors, rng)[-1] for rng in drawn]).T
    assert theta.std() == pytest.approx(turning * 2.0, rel=0.15)
    assert theta.mean() == pytest.approx(0.0, abs=0.012)
    assert x.std() == pytest.approx(0.05 * 2.0, rel=0.15)
    if not turning:
        assert y.std() == pytest.approx(0.5 * x.std(), rel=0.15)


def test_calibration_errors_scale_way_and_turns() -> None:
    errors = errors_of(distance_scale=0.1, turn_scale=0.05)
    poses = np.array([[0, 0, 0], [2, 0, 0], [2, 0, np.pi / 2], [2, 1, np.pi / 2]], dtype=np.float64)
    end = drifting_odometry(poses, errors, np.random.default_rng(0))[-1]
    assert end[2] == pytest.approx(1.05 * np.pi / 2)
    assert end[0] == pytest.approx(2.2 + 1.1 * np.cos(1.05 * np.pi / 2))
    veering = drifting_odometry(poses[:2], errors_of(veer_per_m=0.02), np.random.default_rng(0))
    assert veering[-1, 2] == pytest.approx(0.04)


def lidar_of(rings: int = 9, **changes: Any) -> Lidar:
    """A lidar of 60 columns and 80 degrees up and down, without errors unless told otherwise."""
    level = laser_of(2 * np.pi, 60, **changes)
    elevations = np.radians(np.linspace(-40.0, 40.0, rings))
    return Lidar(level=level, elevations=elevations, height_m=HEIGHT, ceiling_m=CEILING)


def cloud_of(lidar: Lidar, world: World) -> Cloud:
    (cloud,) = lidar.clouds(world, STILL, np.zeros(1), np.random.default_rng(4))
    return cloud


def test_every_beam_ends_on_the_first_surface_and_columns_come_as_they_turn(hall: World) -> None:
    lidar = lidar_of(sweep_s=0.1)
    points, times_s = cloud_of(lidar, hall)
    places = np.column_stack([AT.apply(points[:, :2]), points[:, 2] + HEIGHT])
    low, high = np.array([LEFT, BOTTOM, 0.0]), np.array([RIGHT, TOP, CEILING])
    assert np.minimum(np.abs(places - low), np.abs(places - high)).min(axis=1).max() < 1e-5
    assert ((places > low - 1e-5) & (places < high + 1e-5)).all()
    assert (places[:, 2].min(), places[:, 2].max()) == pytest.approx((0.0, CEILING), abs=1e-6)
    columns = points.reshape(60, 9, 3)
    bearings = np.arctan2(columns[:, 0, 1], columns[:, 0, 0])
    np.testing.assert_allclose(bearings, simulator.laser_bearings(2 * np.pi, 60), atol=1e-6)
    level = columns[:, 4]  # is what the planar laser sees
    (ranges,) = lidar.level.scans(hall, STILL, np.zeros(1), np.random.default_rng(4))
    np.testing.assert_allclose(np.hypot(level[:, 0], level[:, 1]), ranges, atol=1e-6)
    np.testing.assert_array_equal(level[:, 2], 0.0)
    assert times_s is not None
    np.testing.assert_allclose(times_s, np.repeat(np.linspace(0, 0.1, 60), 9))
    assert cloud_of(lidar_of(), hall).times_s is None


def brief(**changes: Any) -> SimulationOptions:
    usual = SimulationOptions(beams=30, rate_hz=4, max_duration_s=5.0, seed=2)
    return usual.model_copy(update=changes)


def test_the_scans_of_a_tour_are_the_same_every_time(flat: GridMap) -> None:
    tour = simulated_tour(flat, brief(dropouts=0.2))
    for (sweep, pose), (again, pose_again) in zip(tour.scans(), tour.scans(), strict=True):
        np.testing.assert_array_equal(sweep.planar.ranges, again.planar.ranges)
        assert (pose, sweep.odom_from_base) == (pose_again, again.odom_from_base)


@pytest.mark.parametrize(("longest", "scans"), [(0.01, 1), (0.25, 2), (3.0, 13), (None, 0)])
def test_a_longest_duration_ends_the_recording_else_the_tour_does(
    flat: GridMap, longest: float | None, scans: int
) -> None:
    tour = simulated_tour(flat, brief(max_duration_s=longest))
    if longest is not None:
        assert len(list(tour.scans())) == len(tour.scan_times_s) == scans
        assert tour.duration_s == (scans - 1) / 4
    else:
        assert tour.truth.duration_s - 0.25 < tour.duration_s <= tour.truth.duration_s
        assert tour.distance_m == pytest.approx(path_length(tour.truth.poses), rel=0.02)


@pytest.mark.parametrize("sweep_s", [0.0, 0.2])
def test_mounting_range_and_times_of_beams_reach_the_sweeps(flat: GridMap, sweep_s: float) -> None:
    mounting = {"laser_x_m": 0.2, "laser_y_m": -0.1, "laser_yaw_deg": 90.0}
    options = brief(**mounting, range_max_m=3.0, sweep_s=sweep_s)
    for sweep, _ in simulated_tour(flat, options).scans():
        assert sweep.base_from_laser == Pose2(0.2, -0.1, np.pi / 2)
        assert sweep.planar.range_max == 3.0
        assert sweep.planar.ranges[np.isfinite(sweep.planar.ranges)].max(initial=0.0) <= 3.0
        times = sweep.planar.beam_times_s
        assert (times is None) is (sweep_s == 0.0)
        assert times is None or (times[0], times[-1], len(times)) == (0.0, sweep_s, 30)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"beams": 1}, "beams: must be 8 or more, found 1"),
        ({"speed_mps": float("nan")}, "speed_mps: must be a finite number"),
        ({"acceleration_mps2": 0.0}, "acceleration_mps2: must be more than 0, found 0.0"),
        ({"comfort_m": -1.0}, "comfort_m: must be more than 0, found -1.0"),
        ({"dropouts": 1.0}, "dropouts: must be less than 1, found 1.0"),
        ({"laps": 1.5}, "laps: must be a whole number, found 1.5"),
        ({"lapse": 3}, "lapse: .*found 3"),
        ({"sweep_s": 0.3, "rate_hz": 5}, "sweep_s is longer than the 0.2 s between scans"),
        ({"rings": 8, "ceiling_m": 0.6}, "laser_height_m is not below ceiling_m, 0.6 m"),
    ],
)
def test_options_out_of_range_are_one_line(values: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message) as caught:
        simulator.simulation_options(**values)
    assert "\n" not in str(caught.value)


def test_only_a_lidar_must_stand_below_the_ceiling(flat: GridMap) -> None:
    assert simulator.simulation_options(ceiling_m=0.6).rings == 1
    lidar = simulated_tour(flat, brief(rings=4, vertical_fov_deg=30.0)).lidar
    assert lidar is not None
    np.testing.assert_allclose(np.degrees(lidar.elevations), [-15, -5, 5, 15])


def test_scans_in_a_row_are_those_cast_one_by_one(hall: World) -> None:
    """They are cast in batches, of which no scan must know."""
    turning = Drive(np.array([0.0, 20.0]), np.array([[2.0, 1.5, 0.0], [5.0, 3.5, 9.0]]))
    laser, times = laser_of(np.pi, 19), np.arange(0.0, 20.0, 0.1)
    rng = np.random.default_rng(RNG_SEED)
    together = list(laser.scans(hall, turning, times, rng))
    assert len(together) == len(times)
    for k in (0, 63, 64, 65, 128, 199):
        (alone,) = laser.scans(hall, turning, times[k : k + 1], rng)
        np.testing.assert_array_equal(together[k], alone)


@pytest.mark.parametrize("rate", [0.5, 7.0, 200.0])
def test_odometry_begins_before_and_ends_after_the_scans(flat: GridMap, rate: float) -> None:
    tour = simulated_tour(flat, brief(odometry_rate_hz=rate))
    stamps = [stamp for stamp, _ in tour.odometry_messages()]
    assert stamps[0] < simulator.START_NS
    assert stamps[-1] >= simulator.stamp_of(tour.duration_s)
    np.testing.assert_allclose(np.diff(stamps), 1e9 / rate, atol=1000)
