"""What a sweep offers to registration: cut to range, in the base frame, thinned evenly."""

import dataclasses
import functools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2, compose
from specmap_cli.core.records import PlanarScan, Sweep
from specmap_cli.core.settings import RegistrationConfig
from specmap_cli.registration.guess import MotionModel
from specmap_cli.registration.sweep_view import (
    SweepView,
    deskewed,
    moved_returns,
    usable_times,
    view_of,
)
from tests.registration.drives import circle
from tests.strategies import seeds


def seen(sweep: Sweep, last: Pose2 | None = None, **settings: float) -> SweepView:
    config = RegistrationConfig.model_validate(settings)
    model = MotionModel(config)
    model.expect(dataclasses.replace(sweep, stamp_ns=sweep.stamp_ns - 10**8))
    for _ in range(2 if last else 0):
        model.conclude(last or Pose2(0.0, 0.0, 0.0))
    expected = model.expect(sweep)
    during, interval_s = expected.during, expected.interval_s
    return view_of(sweep, during, interval_s, config)


def rows(points: FloatArray) -> set[tuple[float, ...]]:
    return set(map(tuple, points.tolist()))


def cells(points: FloatArray, side_m: float) -> set[tuple[float, ...]]:
    """The grid cells that hold points, by a plain loop."""
    return {tuple(float(np.floor(value / side_m)) for value in point) for point in points}


def test_only_returns_in_range_are_walls() -> None:
    """Not the robot itself, nor what is beyond max_range_m, nor what is no return."""
    view = seen(circle(0, np.array([0.05, 0.051, 4.0, 4.001, np.inf, np.nan])), max_range_m=4.0)
    for points in (view.walls, view.probe, view.cloud[:, :2]):
        assert sorted(np.hypot(*points.T)) == pytest.approx([0.051, 4.0])
    # some drivers round: 9.995 of 10 m says that nothing came back
    assert len(seen(circle(0, np.array([9.995, 10.0, 9.98, 5.0]))).walls) == 2


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


def cloud_sweep(cloud: FloatArray, times_s: FloatArray | None = None) -> Sweep:
    return dataclasses.replace(circle(0, np.full(64, 5.0)), cloud=cloud, cloud_times_s=times_s)


@given(seeds)
def test_a_cloud_is_thinned_in_space(seed: int) -> None:
    cloud = np.random.default_rng(seed).uniform(-2.0, 2.0, (300, 3)) + (4.0, 0.0, 0.0)
    view = seen(cloud_sweep(cloud), cloud_voxel_m=0.5)
    assert rows(view.sparse) <= rows(view.cloud) <= rows(cloud)
    assert len(view.cloud) == len(cells(cloud, 0.5))
    assert len(view.sparse) == len(cells(view.cloud, 1.0))
    assert len(view.walls) == len(cells(circle(0, np.full(64, 5.0)).planar.hits(), 0.05))


def test_a_dense_cloud_is_aligned_with_the_most_points() -> None:
    cloud = np.random.default_rng(0).uniform(-4.0, 4.0, (12000, 3)) + (6.0, 0.0, 0.0)
    view = seen(cloud_sweep(cloud), cloud_voxel_m=0.4)
    assert 1000 < len(view.cloud) <= 2000
    assert len(view.sparse) <= 1000
    assert len(view.dense) == len(cells(cloud, 0.2))
    assert rows(view.sparse) <= rows(view.cloud) <= rows(view.dense) <= rows(cloud)
    thrice = seen(cloud_sweep(np.repeat(cloud, 3, axis=0)), cloud_voxel_m=0.4)
    for name in ("cloud", "sparse", "dense"):  # of one point three times one is taken
        assert np.array_equal(getattr(thrice, name), getattr(view, name)), name


def test_scan_and_cloud_are_de_skewed_with_the_motion_during_the_sweep() -> None:
    times = np.linspace(0.0, 0.1, 64)
    motion = Pose2(0.2, 0.0, 0.0)
    sweep = cloud_sweep(np.column_stack([np.full(64, 3.0), np.arange(64.0) / 8, times]), times)
    timed = dataclasses.replace(sweep.planar, beam_times_s=times)
    view = seen(dataclasses.replace(sweep, planar=timed), motion)
    assert view.planar.beam_times_s is None
    assert np.allclose(view.cloud[:, 0], 3.0 + 2.0 * view.cloud[:, 2], atol=1e-9)
    assert view.planar.hits().mean(axis=0) == pytest.approx([0.1, 0.0], abs=0.1)
    assert seen(sweep, motion).planar is sweep.planar  # its beams share one time


PERIOD_S = 0.1


def arc(motion: Pose2, share: float, parts: int = 200) -> Pose2:
    """The pose after a share of a motion at constant speed and turn, by small steps."""
    half = motion.theta / 2
    scale = half / np.sin(half) if abs(half) > 1e-9 else 1.0
    c, s = np.cos(half), np.sin(half)
    forward = np.array([c * motion.x + s * motion.y, c * motion.y - s * motion.x]) * scale
    step, pose = np.array([*forward, motion.theta]) * share / parts, np.zeros(3)
    for _ in range(parts):
        pose = compose(pose, step)
    return Pose2(*pose.tolist())


@given(st.floats(-0.4, 0.4), st.floats(-0.1, 0.1), st.floats(-0.6, 0.6), st.floats(0.1, 1.0))
def test_returns_come_back_where_they_are(x: float, y: float, turn: float, share: float) -> None:
    """During a sweep that lasts a share of the interval; heights of a cloud stay."""
    motion, shares = Pose2(x, y, turn), share * np.array([0.0, 0.5, 1.0])
    world = np.array([[2.0, 1.0], [-3.0, 0.5], [0.0, -4.0]])
    at = [arc(motion, each, 400) for each in shares.tolist()]
    seen = np.concatenate([p.inverse().apply(w[None]) for p, w in zip(at, world, strict=True)])
    cloud = np.column_stack([seen, [0.5, 1.5, -1.0]])
    found = moved_returns(cloud, shares * PERIOD_S, motion, PERIOD_S)
    assert np.allclose(found[:, :2], world, atol=2e-3)
    assert np.array_equal(found[:, 2], cloud[:, 2])


@functools.cache
def skewed_room(motion: Pose2, laser: Pose2) -> PlanarScan:
    """A full-circle scan, in the round room of radius 3 m about the stamp's base, while moving."""
    bearings = np.linspace(-np.pi, np.pi, 360, endpoint=False)
    times = np.linspace(0.0, PERIOD_S, 360, endpoint=False)
    x, y, turn = np.array([arc(motion, t / PERIOD_S) @ laser for t in times.tolist()]).T
    along = x * np.cos(bearings + turn) + y * np.sin(bearings + turn)
    ranges = -along + np.sqrt(along**2 - x**2 - y**2 + 9.0)
    return PlanarScan(5, bearings, ranges, 10.0, full_circle=True, beam_times_s=times)


def radii(scan: PlanarScan, laser: Pose2) -> FloatArray:
    """Distances of the returns from the base."""
    return np.asarray(np.hypot(*laser.apply(scan.hits()).T))


@pytest.mark.parametrize("laser", [IDENTITY, Pose2(0.3, -0.2, 1.5)])
def test_a_round_room_is_round_again(laser: Pose2) -> None:
    motion = Pose2(0.2, 0.0, 0.3)
    scan = skewed_room(motion, laser)
    found = deskewed(scan, laser, motion, PERIOD_S)
    assert np.ptp(radii(scan, laser)) > 0.1
    assert np.ptp(radii(found, laser)) < 0.01
    assert (np.diff(found.bearings) >= 0).all()
    assert np.ptp(found.bearings) <= 2 * np.pi
    assert found.beam_times_s is None


def test_beams_without_return_stay_without() -> None:
    scan = skewed_room(IDENTITY, IDENTITY)
    ranges = np.array(scan.ranges)
    ranges[::3], ranges[1::3] = np.inf, np.nan
    gaps = dataclasses.replace(scan, ranges=ranges)
    found = deskewed(gaps, IDENTITY, Pose2(0.1, 0.0, 0.2), PERIOD_S).ranges
    assert (np.isinf(found).sum(), np.isnan(found).sum()) == (120, 120)


@pytest.mark.parametrize(
    "times",
    [
        None,
        np.zeros(360),
        np.full(360, np.nan),
        np.r_[np.linspace(0, 0.1, 359), np.inf],
        np.linspace(0, 0.1, 100),
    ],
)
def test_unusable_times_change_nothing(times: FloatArray | None) -> None:
    scan = dataclasses.replace(skewed_room(IDENTITY, IDENTITY), beam_times_s=times)
    motion = Pose2(0.2, 0.0, 0.3)
    assert deskewed(scan, IDENTITY, motion, PERIOD_S) is scan
    points = np.random.default_rng(0).normal(size=(360, 3))
    assert moved_returns(points, times, motion, PERIOD_S) is points
    assert not usable_times(times, 360)


def test_a_burst_of_stamps_never_tears_a_scan_apart() -> None:
    """Two stamps a millisecond apart do not make the sweep a hundred times faster."""
    scan, motion = skewed_room(IDENTITY, IDENTITY), Pose2(0.2, 0.0, 0.3)
    burst, steady = (deskewed(scan, IDENTITY, motion, s) for s in (0.001, 0.1 * 359 / 360))
    assert np.allclose(burst.ranges, steady.ranges)


def test_a_part_of_a_circle_stays_about_its_bearings() -> None:
    """No bearing of a 270-degree laser jumps by a turn, not even across +-pi."""
    bearings = np.linspace(0.5, 5.2, 200)
    ranges, times = np.full(200, 4.0), np.linspace(0.0, PERIOD_S, 200)
    scan = PlanarScan(5, bearings, ranges, 10.0, full_circle=False, beam_times_s=times)
    found = deskewed(scan, IDENTITY, Pose2(0.1, 0.0, -0.3), PERIOD_S)
    assert np.abs(found.bearings - bearings).max() < 0.35
    assert (np.diff(found.bearings) >= 0).all()
    assert (found.stamp_ns, found.range_max, found.full_circle) == (5, 10.0, False)
