"""What a sweep offers to registration: cut to range, in the base frame, thinned evenly."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import KDTree

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import Sweep
from specmap_cli.core.settings import RegistrationConfig
from specmap_cli.registration.motion import MotionModel
from specmap_cli.registration.sweep_view import SweepView, view_of
from tests.registration.drives import circle
from tests.strategies import seeds
from tests.turning import configured


def seen(sweep: Sweep, last: Pose2 | None = None, **settings: float) -> SweepView:
    """The view of a sweep after a motion."""
    config = configured(RegistrationConfig, "registration", settings)
    model = MotionModel(config)
    model.expect(dataclasses.replace(sweep, stamp_ns=sweep.stamp_ns - 10**8))
    for _ in range(2 if last else 0):
        model.conclude(last or Pose2(0.0, 0.0, 0.0))
    return view_of(sweep, model.expect(sweep), config)


def rows(points: FloatArray) -> set[tuple[float, ...]]:
    return set(map(tuple, points.tolist()))


def cells(points: FloatArray, side_m: float) -> set[tuple[float, ...]]:
    """The grid cells that hold points, by a plain loop."""
    return {tuple(float(np.floor(value / side_m)) for value in point) for point in points}


@pytest.mark.parametrize(
    ("range_m", "kept"),
    [
        (0.05, False),  # the robot itself
        (0.051, True),
        (4.0, True),
        (4.001, False),  # beyond max_range_m
        (np.inf, False),
        (np.nan, False),
    ],
)
def test_only_returns_in_range_are_walls(range_m: float, kept: bool) -> None:
    ranges = np.full(8, np.nan)
    ranges[3] = range_m
    view = seen(circle(0, ranges), max_range_m=4.0)
    assert len(view.walls) == len(view.probe) == len(view.cloud) == kept


def test_readings_at_the_largest_range_are_no_returns() -> None:
    """Some drivers round: 9.995 of 10 m says that nothing came back."""
    ranges = np.array([9.995, 10.0, 9.98, 5.0])
    assert len(seen(circle(0, ranges)).walls) == 2


def test_points_are_in_the_base_frame_of_a_laser_mounted_askew() -> None:
    ranges = np.full(4, np.nan)
    ranges[2] = 2.0  # straight ahead of the laser
    sweep = dataclasses.replace(circle(0, ranges), base_from_laser=Pose2(0.3, -0.1, np.pi / 2))
    assert np.allclose(seen(sweep).walls, [[0.3, 1.9]])
    assert np.allclose(seen(sweep).cloud, [[0.3, 1.9, 0.0]])


@given(seeds, st.integers(1, 400))
def test_thinning_keeps_one_return_a_cell_and_every_cell(seed: int, beams: int) -> None:
    ranges = np.random.default_rng(seed).uniform(0.1, 9.0, beams)
    view = seen(circle(0, ranges))
    hits = circle(0, ranges).planar.hits()
    assert rows(view.walls) <= rows(hits)
    assert rows(view.probe) <= rows(view.walls)
    assert cells(view.walls, 0.05) == cells(hits, 0.05)
    assert len(view.walls) == len(cells(hits, 0.05))
    assert len(view.probe) == len(cells(view.walls, 0.1))
    assert rows(view.cloud[:, :2]) == rows(view.walls)
    assert rows(view.sparse[:, :2]) == rows(view.probe)
    assert not view.cloud[:, 2].any()


@pytest.mark.parametrize("most", [50, 200, 600])
def test_a_dense_scan_is_thinned_evenly_to_the_most_allowed(most: int) -> None:
    ranges = np.random.default_rng(1).uniform(7.0, 9.0, 6000)
    view = seen(circle(0, ranges), max_points=most)
    assert most / 4 < len(view.walls) <= most
    far, _ = KDTree(view.walls).query(circle(0, ranges).planar.hits())
    assert far.max() < 16.0 / np.sqrt(most)  # no part of the scan is left out


def cloud_sweep(cloud: FloatArray, times_s: FloatArray | None = None) -> Sweep:
    sweep = circle(0, np.full(64, 5.0))
    return dataclasses.replace(sweep, cloud=cloud, cloud_times_s=times_s)


def test_a_cloud_is_cut_by_its_distance_over_ground() -> None:
    cloud = np.array([[0.03, 0.0, 2.0], [3.0, 0.0, 9.0], [0.0, 40.0, 1.0], [0.0, 40.1, 0.0]])
    assert rows(seen(cloud_sweep(cloud)).cloud) == rows(cloud[1:3])
    assert rows(seen(cloud_sweep(cloud), cloud_range_m=10.0).cloud) == rows(cloud[1:2])


@given(seeds)
def test_a_cloud_is_thinned_in_space(seed: int) -> None:
    cloud = np.random.default_rng(seed).uniform(-2.0, 2.0, (300, 3)) + (4.0, 0.0, 0.0)
    view = seen(cloud_sweep(cloud), cloud_voxel_m=0.5)
    assert rows(view.sparse) <= rows(view.cloud) <= rows(cloud)
    assert len(view.cloud) == len(cells(cloud, 0.5))
    assert len(view.sparse) == len(cells(view.cloud, 1.0))
    assert len(view.walls) == len(cells(circle(0, np.full(64, 5.0)).planar.hits(), 0.05))


@given(seeds)
def test_a_dense_cloud_is_aligned_with_no_more_than_the_most_points(seed: int) -> None:
    cloud = np.random.default_rng(seed).uniform(-4.0, 4.0, (3000, 3)) + (6.0, 0.0, 0.0)
    view = seen(cloud_sweep(cloud), cloud_voxel_m=0.4, max_cloud_points=500)
    assert 500 / 4 < len(view.cloud) <= 500
    assert len(view.sparse) <= 250
    assert len(view.dense) == len(cells(cloud, 0.2))
    assert rows(view.sparse) <= rows(view.cloud) <= rows(view.dense) <= rows(cloud)


def test_scan_and_cloud_are_de_skewed_with_the_motion_during_the_sweep() -> None:
    times = np.linspace(0.0, 0.1, 64)
    motion = Pose2(0.2, 0.0, 0.0)
    sweep = cloud_sweep(np.column_stack([np.full(64, 3.0), np.arange(64.0) / 8, times]), times)
    timed = dataclasses.replace(sweep.planar, beam_times_s=times)
    view = seen(dataclasses.replace(sweep, planar=timed), motion)
    assert view.planar.beam_times_s is None
    assert np.allclose(view.cloud[:, 0], 3.0 + 2.0 * view.cloud[:, 2], atol=1e-9)
    centre = view.planar.hits().mean(axis=0)
    assert centre == pytest.approx([0.1, 0.0], abs=0.1)
    assert seen(sweep, motion).planar is sweep.planar  # its beams share one time
