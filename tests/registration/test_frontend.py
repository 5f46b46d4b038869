"""The front end on simulated drives: accurate, honest about what is lost, always bounded."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import pytest

from specmap_cli.core.config import RegistrationConfig
from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2, compose, invert, wrap_angles
from specmap_cli.core.records import PlanarScan, PosedScan, Sweep
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.grids.ray_casting import cast_ranges
from specmap_cli.registration import FrontEnd
from specmap_cli.registration.motion import MotionModel

LASER = Pose2(0.2, -0.1, 0.5)


@pytest.fixture(scope="module")
def world() -> GridMap:
    """Two rooms of 5 m x 4 m that differ, joined by a door, and a third one far away."""
    cells = np.full((120, 700), OCCUPIED, dtype=np.uint8)
    cells[10:90, 10:110] = FREE
    cells[10:90, 114:214] = FREE
    cells[40:58, 108:116] = FREE
    cells[10:30, 60:80] = OCCUPIED
    cells[70:90, 150:190] = OCCUPIED
    cells[10:25, 200:214] = OCCUPIED
    cells[10:110, 500:650] = FREE
    cells[60:110, 560:580] = OCCUPIED
    return GridMap(cells, 0.05)


def path() -> FloatArray:
    """True base poses every 8 cm from the first room into the second."""
    x = np.arange(1.5, 9.0, 0.08)
    y = 2.4 + 0.25 * np.sin(2 * (x - 1.5))
    heading = np.arctan2(np.gradient(y), np.gradient(x))
    return np.column_stack([x, y, heading])


def sweeps(
    world: GridMap,
    truth: FloatArray,
    field_of_view: float = 2 * np.pi,
    beams: int = 240,
    reach: float = 10.0,
    odometry: bool = True,
) -> list[Sweep]:
    """What a laser mounted askew sees from the poses, and slightly wrong odometry."""
    full = field_of_view > 6.2
    half = field_of_view / 2
    bearings = np.linspace(-half, half, beams, endpoint=not full)
    distance, rng = world.obstacle_distance(), np.random.default_rng(0)
    odom, result = np.array([3.0, -2.0, 1.0]), []
    steps = compose(invert(truth[:-1]), truth[1:])
    for k, pose in enumerate(truth):
        laser = Pose2(*pose.tolist()) @ LASER
        origin = np.array([[laser.x, laser.y]])
        ranges = cast_ranges(distance, world, origin, bearings + laser.theta, reach)[0]
        ranges += rng.normal(0, 0.01, beams)
        stamp = (k + 1) * 10**8
        scan = PlanarScan(stamp, bearings, ranges, reach, full)
        if k:
            odom = compose(odom, steps[k - 1] * (1.05, 1.0, 1.0) + rng.normal(0, 0.004, 3))
        pose2 = Pose2(*odom.tolist()) if odometry else None
        result.append(Sweep(k, stamp, scan, LASER, pose2))
    return result


def run(items: Sequence[Sweep], **settings: float) -> tuple[FrontEnd, list[PosedScan]]:
    front_end = FrontEnd(RegistrationConfig.model_validate(settings))
    return front_end, [front_end.register(sweep) for sweep in items]


def worst(scans: Sequence[PosedScan], truth: FloatArray) -> tuple[float, float]:
    """Largest error of place and heading, seen from the first pose."""
    found = np.array([scan.map_from_base for scan in scans])
    away = compose(invert(compose(invert(truth[0]), truth)), compose(invert(found[0]), found))
    return float(np.hypot(*away[:, :2].T).max()), float(np.abs(away[:, 2]).max())


@pytest.mark.parametrize("odometry", [True, False])
@pytest.mark.parametrize(
    ("view", "beams", "reach"),
    [(np.pi, 180, 10.0), (1.5 * np.pi, 720, 10.0), (2 * np.pi, 240, 10.0), (2 * np.pi, 360, 4.0)],
)
def test_tracks_lasers_of_all_kinds(
    world: GridMap, view: float, beams: int, reach: float, odometry: bool
) -> None:
    truth = path()
    front_end, scans = run(sweeps(world, truth, view, beams, reach, odometry))
    metres, radians = worst(scans, truth)
    assert metres < 0.08
    assert radians < 0.03
    assert front_end.counts["registered"] == len(scans)
    assert front_end.counts["lost"] == front_end.counts["breaks"] == 0
    assert not any(scan.restarted for scan in scans)
    assert min(scan.score for scan in scans) > 0.5


def test_two_runs_are_identical(world: GridMap) -> None:
    items = sweeps(world, path()[:40])
    first, second = (run(items)[1] for _ in range(2))
    assert [a.map_from_base for a in first] == [b.map_from_base for b in second]


def test_a_kidnapped_robot_is_noticed_and_goes_on_from_a_guess(world: GridMap) -> None:
    there = path()[:40]
    elsewhere = np.column_stack([np.linspace(26, 29, 30), np.full(30, 2.0), np.zeros(30)])
    items = sweeps(world, np.vstack([there, elsewhere]))
    blind = []
    for sweep in items[40:]:  # odometry knows nothing of the move
        assert items[39].odom_from_base is not None
        assert items[40].odom_from_base is not None
        assert sweep.odom_from_base is not None
        since = items[40].odom_from_base.inverse() @ sweep.odom_from_base
        moved = items[39].odom_from_base @ since
        blind.append(dataclasses.replace(sweep, odom_from_base=moved))
    front_end, scans = run([*items[:40], *blind])
    lost = [scan.index for scan in scans if scan.lost]
    assert lost == [40, 41, 42, 43, 44]
    assert [scan.index for scan in scans if scan.restarted] == [45]
    assert front_end.counts["breaks"] == 1
    assert worst(scans[45:], np.array(elsewhere[5:]))[0] < 0.08
    jumps = np.hypot(*np.diff([scan.map_from_base[:2] for scan in scans], axis=0).T)
    assert jumps.max() < 0.3


def test_blank_scans_keep_the_odometry_pose(world: GridMap) -> None:
    items = sweeps(world, path()[:30])
    for k in (10, 11):
        blank = dataclasses.replace(items[k].planar, ranges=np.full(240, np.inf))
        items[k] = dataclasses.replace(items[k], planar=blank)
    front_end, scans = run(items)
    assert [scan.index for scan in scans if scan.lost] == [10, 11]
    assert worst(scans, path()[:30])[0] < 0.1
    assert front_end.counts["breaks"] == 0


def test_a_log_without_walls_is_lost_but_survived() -> None:
    bearings = np.linspace(-np.pi, np.pi, 90, endpoint=False)
    items = [
        Sweep(k, k, PlanarScan(k, bearings, np.full(90, np.nan), 10.0, True), IDENTITY)
        for k in range(20)
    ]
    front_end, scans = run(items)
    assert front_end.counts["lost"] == 20
    assert all(scan.map_from_base == IDENTITY for scan in scans)


def test_random_scans_never_make_the_pose_fly_off() -> None:
    rng = np.random.default_rng(3)
    bearings = np.linspace(-np.pi, np.pi, 120, endpoint=False)
    items = [
        Sweep(k, k * 10**8, PlanarScan(k, bearings, rng.uniform(0.2, 9, 120), 10.0, True), IDENTITY)
        for k in range(60)
    ]
    _, scans = run(items)
    poses = np.array([scan.map_from_base for scan in scans])
    assert np.isfinite(poses).all()
    steps = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    assert steps.max() < 3.0


def test_an_odometry_reset_is_no_motion(world: GridMap) -> None:
    truth = path()[:40]
    items = sweeps(world, truth)
    items[20:] = [
        dataclasses.replace(s, odom_from_base=Pose2(500.0, 0.0, 0.0) @ s.odom_from_base)
        for s in items[20:]
        if s.odom_from_base is not None
    ]
    front_end, scans = run(items)
    assert front_end.counts["odometry_jumps"] == 1
    assert worst(scans, truth)[0] < 0.08


def test_wrong_heading_increments_in_a_turn_are_survived(world: GridMap) -> None:
    """Wheels and laser out of step: one increment 15 degrees too far, the next back."""
    truth = path()
    items = sweeps(world, truth)
    for k in (30, 50, 70):
        odom = items[k].odom_from_base
        assert odom is not None
        items[k] = dataclasses.replace(items[k], odom_from_base=odom @ Pose2(0.0, 0.0, 0.26))
    front_end, scans = run(items)
    assert worst(scans, truth)[0] < 0.08
    assert front_end.counts["lost"] == 0


def test_stamps_in_bursts_and_backwards_do_not_matter(world: GridMap) -> None:
    truth = path()[:50]
    items = sweeps(world, truth, odometry=False)
    stamps = [
        10**9 + (k // 3) * 10**8 + (k % 3) - (5 * 10**7 if k % 7 == 0 else 0) for k in range(50)
    ]
    items = [dataclasses.replace(s, stamp_ns=t) for s, t in zip(items, stamps, strict=True)]
    assert worst(run(items)[1], truth)[0] < 0.08


def test_a_resting_robot_without_odometry_does_not_begin_to_swing(world: GridMap) -> None:
    """Each error of the estimated motion comes back through de-skewing, and must die out."""
    truth = np.tile(path()[10], (60, 1))
    items = []
    for sweep in sweeps(world, truth, odometry=False):
        timed = dataclasses.replace(sweep.planar, beam_times_s=np.linspace(0.0, 0.1, 240))
        items.append(dataclasses.replace(sweep, planar=timed))
    _, scans = run(items)
    assert worst(scans, truth)[0] < 0.03


def cloud_of(world: GridMap, pose: FloatArray) -> FloatArray:
    """Walls from floor to ceiling and the floor itself, as a 3D lidar 0.5 m up would see them."""
    bearings = np.linspace(-np.pi, np.pi, 180, endpoint=False)
    distance = world.obstacle_distance()
    ranges = cast_ranges(distance, world, pose[None, :2], bearings + pose[2], 15.0)[0]
    rings = [
        np.column_stack(
            [ranges * np.cos(bearings), ranges * np.sin(bearings), 0.5 + ranges * np.tan(slope)]
        )
        for slope in np.radians([-10, -5, 0, 5, 10, 15])
    ]
    points = np.concatenate(rings)
    low = points[:, 2] < 0.0
    points[low] *= (0.5 / (0.5 - points[low, 2]))[:, None] * (1, 1, 0)
    return points


def test_a_3d_lidar_is_tracked_in_space(world: GridMap) -> None:
    truth = path()[::3]
    items = []
    for k, sweep in enumerate(sweeps(world, truth)):
        cloud = cloud_of(world, truth[k])
        items.append(dataclasses.replace(sweep, cloud=cloud))
    _, scans = run(items)
    metres, radians = worst(scans, truth)
    assert metres < 0.1
    assert radians < 0.03
    for scan in scans:
        assert scan.map_from_base_3d is not None
        assert Pose2.from_matrix(scan.map_from_base_3d) == scan.map_from_base
        assert abs(scan.map_from_base_3d[2, 3]) < 0.15  # six rings say little about height
        assert scan.map_from_base_3d[2, 2] > np.cos(0.05)


def test_the_motion_model_clips_what_it_carries_on() -> None:
    model = MotionModel()
    model.conclude(Pose2(3.0, -2.0, 2.0))
    carried = model.carried_on()
    assert (carried.x, carried.y, carried.theta) == (0.5, -0.2, 0.8)
    scan = PlanarScan(0, np.zeros(1), np.ones(1), 1.0, False)
    first = model.predict(Sweep(0, 10, scan, IDENTITY, Pose2(1, 1, 0)))
    assert not first.measured
    second = model.predict(Sweep(1, 5, scan, IDENTITY, Pose2(1.5, 1, 0)))
    assert second.measured
    assert second.motion.x == pytest.approx(0.5)
    assert second.interval_s == 0.0
    assert np.abs(wrap_angles(np.array([second.motion.theta])))[0] < 1e-12
