"""A street of boxes, seen by a lidar of many rings on a fast vehicle: ray casting in space."""

from dataclasses import replace

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import Sweep
from specmap_cli.core.settings import LogConfig
from specmap_cli.logs.clouds import CloudFlattener
from tests.registration.drives import sweep_of

HEIGHT_M, REACH_M = 1.8, 60.0  # of the lidar above the road; of its rays
RINGS, COLUMNS = 64, 900
STEP_M = 0.8


def boxes() -> FloatArray:
    """(B, 2, 3) corners of houses, parked cars and posts along a road of 160 m."""
    rng = np.random.default_rng(5)
    found = []
    for side in (-1.0, 1.0):
        x = -60.0
        while x < 160.0:
            length, gap, back = rng.uniform((8.0, 2.0, 9.0), (20.0, 6.0, 14.0))
            found.append((x, side * back, 0.0, x + length, side * (back + 8.0), 9.0))
            car = x + rng.uniform(0.0, 6.0)
            found.append((car, side * 4.0, 0.2, car + 4.2, side * 5.8, 1.5))
            post = car + rng.uniform(5.0, 8.0)
            found.append((post, side * 7.0, 0.0, post + 0.3, side * 7.3, 6.0))
            x += length + gap
    corners = np.array(found).reshape(-1, 2, 3)
    return np.stack([corners.min(axis=1), corners.max(axis=1)], axis=1)


def cloud_at(pose: Pose2, world: FloatArray) -> FloatArray:
    """The returns (N, 3), in the lidar's frame, from the road, and from boxes' sides and tops."""
    azimuth = np.linspace(-np.pi, np.pi, COLUMNS, endpoint=False)
    slope = np.tan(np.radians(np.linspace(-24.8, 2.0, RINGS)))[:, None]
    heading = np.column_stack([np.cos(azimuth + pose.theta), np.sin(azimuth + pose.theta)])
    with np.errstate(divide="ignore"):
        reach = np.where(slope < 0.0, -HEIGHT_M / slope, np.inf) * np.ones(COLUMNS)
    middle = world[:, :, :2].mean(axis=1) - (pose.x, pose.y)
    for low, high in world[np.hypot(*middle.T) < REACH_M]:
        sides = (np.stack([low[:2], high[:2]])[:, None] - (pose.x, pose.y)) / heading
        near, far = sides.min(axis=0).max(axis=1), sides.max(axis=0).min(axis=1)
        met = (near <= far) & (near > 0.0)
        height = HEIGHT_M + slope * near
        wall = met & (height >= low[2]) & (height <= high[2])
        top = np.where(slope < 0.0, (high[2] - HEIGHT_M) / np.minimum(slope, -1e-9), np.inf)
        reach = np.where(wall, np.minimum(reach, near), reach)
        reach = np.where(met & (top > near) & (top <= far), np.minimum(reach, top), reach)
    hit = reach <= REACH_M
    reach = reach + np.random.default_rng(round(1e3 * pose.x)).normal(0.0, 0.01, reach.shape)
    reach = np.where(hit, reach, 0.0)
    x, y = reach * np.cos(azimuth), reach * np.sin(azimuth)
    return np.column_stack([x[hit], y[hit], (reach * slope)[hit]])


def way(steps: int) -> list[Pose2]:
    """Poses a step apart along the road: from rest to full speed in two seconds, then on."""
    x = np.cumsum(np.minimum(np.arange(steps) / 20.0, 1.0) * STEP_M)
    rows = np.column_stack([x, 1.2 * np.sin(x / 12.0), np.arctan(0.1 * np.cos(x / 12.0))])
    return [Pose2(*row) for row in rows.tolist()]


def drive(poses: list[Pose2]) -> list[Sweep]:
    """The sweeps at 10 Hz, without odometry."""
    flattener = CloudFlattener(np.eye(4), -HEIGHT_M, LogConfig())
    world, sweeps = boxes(), []
    for k, pose in enumerate(poses):
        cloud = cloud_at(pose, world)
        planar = flattener.flatten(cloud, (k + 1) * 10**8)
        sweeps.append(replace(sweep_of(k, planar, flattener.mount, None), cloud=cloud))
    return sweeps
