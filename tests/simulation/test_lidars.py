"""Simulated 3D lidars: where their beams end, in which order, and with which errors."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.simulation.lasers import Cloud, Laser, Lidar, laser_bearings, ring_elevations
from specmap_cli.simulation.tours import Drive
from specmap_cli.simulation.worlds import World

LEFT, RIGHT, BOTTOM, TOP = 1.0, 6.0, 0.5, 4.5
HEIGHT, CEILING = 0.6, 2.4
AT = Pose2(3.0, 2.0, 0.7)
STILL = Drive(np.zeros(1), np.array([AT]))


@pytest.fixture(scope="module")
def hall() -> World:
    """One empty room of 5 m x 4 m."""
    cells = np.full((100, 140), OCCUPIED, dtype=np.uint8)
    cells[10:90, 20:120] = FREE
    return World.of(GridMap(cells, 0.05))


def lidar_of(rings: int = 9, **changes: Any) -> Lidar:
    """A lidar of 60 columns and 80 degrees up and down, without errors unless told otherwise."""
    level = Laser(
        bearings=laser_bearings(2 * np.pi, 60),
        range_max_m=20.0,
        base_from_laser=Pose2(0.0, 0.0, 0.0),
    )
    return Lidar(
        level=replace(level, **changes),
        elevations=ring_elevations(np.radians(80), rings),
        height_m=HEIGHT,
        ceiling_m=CEILING,
    )


def cloud_of(lidar: Lidar, world: World) -> Cloud:
    (cloud,) = lidar.clouds(world, STILL, np.zeros(1), np.random.default_rng(4))
    return cloud


def off_surfaces(points: FloatArray) -> FloatArray:
    """How far points (N, 3) of the lidar's frame are from the room's nearest surface."""
    x, y = AT.apply(points[:, :2]).T
    z = points[:, 2] + HEIGHT
    planes = [x - LEFT, x - RIGHT, y - BOTTOM, y - TOP, z, z - CEILING]
    return np.asarray(np.abs(planes).min(axis=0))


def test_every_beam_ends_on_the_first_surface_it_meets(hall: World) -> None:
    points = cloud_of(lidar_of(), hall).points
    assert len(points) == 9 * 60
    assert off_surfaces(points).max() < 1e-5
    x, y = AT.apply(points[:, :2]).T
    z = points[:, 2] + HEIGHT
    assert x.min() > LEFT - 1e-5
    assert x.max() < RIGHT + 1e-5
    assert y.min() > BOTTOM - 1e-5
    assert y.max() < TOP + 1e-5
    assert z.min() == pytest.approx(0.0, abs=1e-6)
    assert z.max() == pytest.approx(CEILING, abs=1e-6)


def test_the_level_ring_is_the_planar_laser(hall: World) -> None:
    lidar = lidar_of()
    points = cloud_of(lidar, hall).points.reshape(60, 9, 3)[:, 4]
    (ranges,) = lidar.level.scans(hall, STILL, np.zeros(1), np.random.default_rng(4))
    np.testing.assert_allclose(np.hypot(points[:, 0], points[:, 1]), ranges, atol=1e-6)
    np.testing.assert_array_equal(points[:, 2], 0.0)


def test_elevations_are_centred_on_level() -> None:
    np.testing.assert_allclose(np.degrees(ring_elevations(np.radians(30), 4)), [-15, -5, 5, 15])


def test_noise_is_along_the_beam_and_of_the_asked_spread(hall: World) -> None:
    exact, noisy = (cloud_of(lidar_of(64, noise_m=noise), hall).points for noise in (0.0, 0.02))
    ranges = np.sqrt((exact**2).sum(axis=1))
    off = noisy - exact
    along = (off * exact).sum(axis=1) / ranges
    np.testing.assert_allclose(off, along[:, None] * exact / ranges[:, None], atol=1e-6)
    assert along.std() == pytest.approx(0.02, rel=0.05)
    assert abs(along.mean()) < 4 * 0.02 / np.sqrt(len(along))


def test_beams_without_a_return_are_left_out_with_their_times(hall: World) -> None:
    lidar = lidar_of(dropouts=0.3, sweep_s=0.1)
    cloud = cloud_of(lidar, hall)
    assert cloud.times_s is not None
    assert len(cloud.points) == len(cloud.times_s)
    assert len(cloud.points) == pytest.approx(0.7 * 540, rel=0.1)
    near = cloud_of(lidar_of(range_max_m=1.5), hall).points
    assert 0 < len(near) < 540
    assert np.sqrt((near**2).sum(axis=1)).max() <= 1.5


def test_points_come_as_the_columns_turn(hall: World) -> None:
    cloud = cloud_of(lidar_of(sweep_s=0.1), hall)
    assert cloud.times_s is not None
    np.testing.assert_allclose(cloud.times_s, np.repeat(np.linspace(0, 0.1, 60), 9))
    bearings = np.arctan2(cloud.points[:, 1], cloud.points[:, 0]).reshape(60, 9)
    np.testing.assert_allclose(bearings[:, 0], laser_bearings(2 * np.pi, 60), atol=1e-6)
    assert cloud_of(lidar_of(), hall).times_s is None
