"""Simulated drives for the front end: true paths, what a laser saw along them, how it was found."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2, compose, invert
from specmap_cli.core.records import PlanarScan, PosedScan, Sweep
from specmap_cli.core.settings import RegistrationConfig
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.registration import Aligner, FrontEnd, SensorKind
from specmap_cli.registration.guess import UNKNOWN, ExpectedMotion, MotionGuess, Reliance
from specmap_cli.registration.local_map import LocalMap, Scene
from specmap_cli.registration.sweep_view import SweepView
from tests.casting import ranges_at
from tests.turning import configured

Setting = float | str | tuple[float, ...]
LASER = Pose2(0.2, -0.1, 0.5)


def path() -> FloatArray:
    """True base poses every 8 cm from the first room into the second."""
    x = np.arange(1.5, 9.0, 0.08)
    y = 2.4 + 0.25 * np.sin(2 * (x - 1.5))
    return np.column_stack([x, y, np.arctan2(np.gradient(y), np.gradient(x))])


def sweeps(
    world: GridMap,
    truth: FloatArray,
    field_of_view: float = 2 * np.pi,
    beams: int = 240,
    reach: float = 10.0,
    odometry: bool = True,
    seed: int = 0,
) -> list[Sweep]:
    """What a laser mounted askew sees from the poses, and slightly wrong odometry."""
    full = field_of_view > 6.2
    half = field_of_view / 2
    bearings = np.linspace(-half, half, beams, endpoint=not full)
    lasers = compose(truth, np.array(LASER))
    seen, rng = ranges_at(world, lasers, bearings, reach), np.random.default_rng(seed)
    odom, result = np.array([3.0, -2.0, 1.0]), []
    steps = compose(invert(truth[:-1]), truth[1:])
    for k, ranges in enumerate(seen):
        ranges += rng.normal(0, 0.01, beams)
        if k:
            odom = compose(odom, steps[k - 1] * (1.05, 1.0, 1.0) + rng.normal(0, 0.004, 3))
        scan = PlanarScan((k + 1) * 10**8, bearings, ranges, reach, full_circle=full)
        result.append(sweep_of(k, scan, LASER, Pose2(*odom.tolist()) if odometry else None))
    return result


def sweep_of(k: int, scan: PlanarScan, laser: Pose2, odometry: Pose2 | None) -> Sweep:
    return Sweep(
        index=k, stamp_ns=scan.stamp_ns, planar=scan, base_from_laser=laser, odom_from_base=odometry
    )


def circle(k: int, ranges: FloatArray, odometry: Pose2 | None = None) -> Sweep:
    """A full-circle sweep of these ranges, the k-th at 10 Hz, by a laser amid the base."""
    bearings = np.linspace(-np.pi, np.pi, len(ranges), endpoint=False)
    scan = PlanarScan(k * 10**8, bearings, ranges, 10.0, full_circle=True)
    return sweep_of(k, scan, IDENTITY, odometry)


def odometry_of(sweep: Sweep) -> Pose2:
    assert sweep.odom_from_base is not None
    return sweep.odom_from_base


def with_odometry(sweep: Sweep, changed: Callable[[Pose2], Pose2]) -> Sweep:
    return replace(sweep, odom_from_base=changed(odometry_of(sweep)))


def with_ranges(sweep: Sweep, ranges: FloatArray) -> Sweep:
    return replace(sweep, planar=replace(sweep.planar, ranges=ranges))


def with_clouds(world: GridMap, truth: FloatArray) -> list[Sweep]:
    """What a 3D lidar sees from the poses."""
    posed = zip(sweeps(world, truth), truth, strict=True)
    return [replace(sweep, cloud=cloud_of(world, pose)) for sweep, pose in posed]


def run(items: Sequence[Sweep], **settings: Setting) -> tuple[FrontEnd, list[PosedScan]]:
    front_end = FrontEnd(configured(RegistrationConfig, "registration", settings))
    return front_end, [front_end.register(sweep) for sweep in items]


def worst(scans: Sequence[PosedScan], truth: FloatArray) -> tuple[float, float]:
    """Largest error of place and heading, seen from the first pose."""
    found = np.array([scan.map_from_base for scan in scans])
    away = compose(invert(compose(invert(truth[0]), truth)), compose(invert(found[0]), found))
    return float(np.hypot(*away[:, :2].T).max()), float(np.abs(away[:, 2]).max())


def cloud_of(world: GridMap, pose: FloatArray) -> FloatArray:
    """Walls from floor to ceiling and the floor itself, as a 3D lidar 0.5 m up would see them."""
    bearings = np.linspace(-np.pi, np.pi, 180, endpoint=False)
    ranges = ranges_at(world, pose[None], bearings, 15.0)[0]
    x, y = ranges * np.cos(bearings), ranges * np.sin(bearings)
    slopes = np.tan(np.radians([-10, -5, 0, 5, 10, 15]))
    points = np.concatenate([np.column_stack([x, y, 0.5 + ranges * slope]) for slope in slopes])
    low = points[:, 2] < 0.0
    points[low] *= (0.5 / (0.5 - points[low, 2]))[:, None] * (1, 1, 0)
    return points


def turned(x: float, yaw: float, roll: float) -> FloatArray:
    """A pose (4, 4) in space."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("ZYX", [yaw, 0.0, roll]).as_matrix()
    pose[0, 3] = x
    return pose


def expecting(
    motion: Pose2 = IDENTITY, carried: Pose2 = IDENTITY, *, measured: bool = True
) -> ExpectedMotion:
    """A motion that odometry measured, or one that is carried on, with nothing unusual."""
    return ExpectedMotion(
        motion=motion,
        increment=motion,
        carried=carried,
        during=IDENTITY,
        interval_s=0.1,
        measured=measured,
        jumped=False,
        shortened=False,
        hole=False,
    )


def guess_of(
    place: Pose2, expected: ExpectedMotion, reliance: Reliance = UNKNOWN, motion: Pose2 = IDENTITY
) -> MotionGuess:
    """A guess at a place, which the expected motion leads to."""
    return MotionGuess(
        pose=place.matrix(),
        before=(place @ expected.motion.inverse()).matrix(),
        expected=expected,
        by_motion=motion,
        reliance=reliance,
    )


def view_of_points(points: FloatArray, looked_m: float = 40.0) -> SweepView:
    """A view whose points (N, 2) are all there is, of a laser that looked so far all round."""
    cloud = np.column_stack([points, np.zeros(len(points))])
    return SweepView(
        planar=circle(0, np.full(90, looked_m)).planar,
        cloud=cloud,
        sparse=cloud[::2],
        walls=points,
        probe=points[::2],
        dense=cloud,
        base_from_laser=IDENTITY,
        reach_m=np.inf,
    )


def scene_of(
    seen: FloatArray, known: FloatArray, aligner: Aligner, looked_m: float = 40.0, **settings: float
) -> Scene:
    """Points (N, 2) seen where the map's only keyframe saw the `known` (M, 2), so far all round."""
    config = configured(RegistrationConfig, "registration", settings)
    sensor = SensorKind(in_space=False, voxel_m=config.voxel_m, range_m=config.max_range_m)
    local = LocalMap(aligner, sensor, config)
    local.insert(view_of_points(known, looked_m), np.eye(4))
    return Scene(view=view_of_points(seen), local=local, config=config)


def scene_in(world: GridMap, aligner: Aligner, **settings: float) -> Scene:
    """The first sweep of `path` seen twice."""
    points = LASER.apply(sweeps(world, path()[:2])[0].planar.hits())
    return scene_of(points, points, aligner, **settings)
