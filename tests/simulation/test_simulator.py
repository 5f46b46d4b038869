"""The simulator: options, and tours whose scans agree with their truth."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree

from specmap_cli.core.errors import UsageError
from specmap_cli.core.geometry import Pose2, compose, invert, path_length
from specmap_cli.core.records import Sweep
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.simulation import simulator
from specmap_cli.simulation.simulator import SimulationOptions, simulate_sweeps, simulated_tour

BRIEF = SimulationOptions(beams=30, rate_hz=4, max_duration_s=5.0, seed=2)
EXACT: dict[str, Any] = {"noise_m": 0.0, "range_step_m": 0.0, "odometry_drift": 0.0}


def brief(**changes: Any) -> SimulationOptions:
    return BRIEF.model_copy(update=changes)


def test_errors_of_a_sensor_leave_the_route_and_the_other_sensor_as_they_are(flat: GridMap) -> None:
    exact, noisy, drifting = (
        simulated_tour(flat, brief(max_duration_s=None, noise_m=noise, odometry_drift=drift))
        for noise, drift in ((0.0, 1.0), (0.3, 1.0), (0.05, 3.0))
    )
    np.testing.assert_array_equal(exact.truth.poses, drifting.truth.poses)
    np.testing.assert_array_equal(exact.odometry.poses, noisy.odometry.poses)


def test_the_scans_of_a_tour_are_the_same_every_time(flat: GridMap) -> None:
    tour = simulated_tour(flat, brief(dropouts=0.2))
    for (sweep, pose), (again, pose_again) in zip(tour.scans(), tour.scans(), strict=True):
        np.testing.assert_array_equal(sweep.planar.ranges, again.planar.ranges)
        assert (pose, sweep.odom_from_base) == (pose_again, again.odom_from_base)


def test_returns_lie_on_walls_seen_from_the_true_pose(
    flat: GridMap, flat_tour: list[tuple[Sweep, Pose2]]
) -> None:
    walls = cKDTree(flat.centres_of(np.argwhere(flat.occupied)))
    for sweep, map_from_base in flat_tour[::40]:
        hits = (map_from_base @ sweep.base_from_laser).apply(sweep.planar.hits())
        away, _ = walls.query(hits)
        # half a cell's diagonal, and five times the noise
        assert away.max() < 0.5 * np.sqrt(2.0) * 0.05 + 5 * 0.01
        assert len(hits) > 100


def test_exact_odometry_is_the_true_motion(flat: GridMap) -> None:
    sweeps = list(simulate_sweeps(flat, brief(**EXACT, odometry_rate_hz=1000)))
    odometry = np.array([sweep.odom_from_base for sweep, _ in sweeps], dtype=np.float64)
    truth = np.array([pose for _, pose in sweeps])
    moved = compose(invert(odometry[:-1]), odometry[1:])
    np.testing.assert_allclose(moved, compose(invert(truth[:-1]), truth[1:]), atol=1e-4)
    assert np.hypot(*(truth[-1] - truth[0])[:2]) > 0.5


def test_stamps_are_whole_microseconds_at_the_rate(flat: GridMap) -> None:
    sweeps = [sweep for sweep, _ in simulate_sweeps(flat, brief(rate_hz=3))]
    assert [sweep.index for sweep in sweeps] == list(range(16))
    assert sweeps[0].stamp_ns == simulator.START_NS == simulator.stamp_of(0.0)
    for before, after in pairwise(sweep.stamp_ns for sweep in sweeps):
        assert after % 1000 == 0
        assert abs(after - before - 10**9 / 3) <= 1000


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


@pytest.mark.parametrize("rate", [0.5, 7.0, 200.0])
def test_odometry_begins_before_the_first_scan_and_ends_after_the_last(
    flat: GridMap, rate: float
) -> None:
    tour = simulated_tour(flat, brief(odometry_rate_hz=rate))
    stamps = [stamp for stamp, _ in tour.odometry_messages()]
    assert stamps[0] < simulator.START_NS
    assert stamps[-1] >= simulator.stamp_of(tour.duration_s)
    np.testing.assert_allclose(np.diff(stamps), 1e9 / rate, atol=1000)


@pytest.mark.parametrize("sweep_s", [0.0, 0.2])
def test_the_mounting_the_range_and_times_of_beams_reach_the_sweeps(
    flat: GridMap, sweep_s: float
) -> None:
    mounting = {"laser_x_m": 0.2, "laser_y_m": -0.1, "laser_yaw_deg": 90.0}
    for sweep, _ in simulate_sweeps(flat, brief(**mounting, range_max_m=3.0, sweep_s=sweep_s)):
        assert sweep.base_from_laser == Pose2(0.2, -0.1, np.pi / 2)
        assert sweep.planar.range_max == 3.0
        finite = sweep.planar.ranges[np.isfinite(sweep.planar.ranges)]
        assert finite.max(initial=0.0) <= 3.0
        times = sweep.planar.beam_times_s
        assert (times is None) is (sweep_s == 0.0)
        assert times is None or (times[0], times[-1], len(times)) == (0.0, sweep_s, 30)


def test_options_of_the_drive_reach_the_robot(flat: GridMap) -> None:
    usual = simulated_tour(flat, brief(max_duration_s=None)).truth.duration_s
    for slower in ({"speed_mps": 0.3}, {"turn_rate_degps": 30.0}, {"acceleration_mps2": 0.1}):
        assert simulated_tour(flat, brief(max_duration_s=None, **slower)).truth.duration_s > usual


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"beams": 1}, "beams: .*greater than or equal to 8.*found 1"),
        ({"speed_mps": float("nan")}, "speed_mps: .*finite"),
        ({"acceleration_mps2": 0.0}, "acceleration_mps2: .*greater than 0.*found 0.0"),
        ({"comfort_m": -1.0}, "comfort_m: .*greater than 0.*found -1.0"),
        ({"dropouts": 1.0}, "dropouts: .*less than 1.*found 1.0"),
        ({"laps": 1.5}, "laps: .*integer.*found 1.5"),
        ({"lapse": 3}, "lapse: .*found 3"),
        ({"sweep_s": 0.3, "rate_hz": 5}, "sweep_s is longer than the 0.2 s between scans"),
    ],
)
def test_options_out_of_range_are_one_line(values: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message) as caught:
        simulator.simulation_options(**values)
    assert "\n" not in str(caught.value)


def test_a_lidar_must_stand_below_the_ceiling_and_its_clouds_are_no_planar_scans(
    flat: GridMap,
) -> None:
    with pytest.raises(UsageError, match="laser_height_m is not below ceiling_m, 2 m"):
        simulator.simulation_options(rings=8, laser_height_m=2.0, ceiling_m=2.0)
    assert simulator.simulation_options(laser_height_m=2.0, ceiling_m=2.0).rings == 1
    with pytest.raises(UsageError, match="rings: a 3D lidar has clouds"):
        next(simulate_sweeps(flat, brief(rings=8)))
    lidar = simulated_tour(flat, brief(rings=4, vertical_fov_deg=30.0)).lidar
    assert lidar is not None
    np.testing.assert_allclose(np.degrees(lidar.elevations), [-15, -5, 5, 15])
