"""De-skewing undoes exactly the motion of a sweep taken while driving an arc."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2, compose
from specmap_cli.core.records import PlanarScan
from specmap_cli.registration.sweep_view import deskewed, moved_returns, usable_times

PERIOD_S = 0.1


def arc(motion: Pose2, share: float, parts: int = 1000) -> Pose2:
    """The pose after a share of a motion at constant speed and turn, by small steps."""
    turn = motion.theta
    half = turn / 2
    scale = half / np.sin(half) if abs(half) > 1e-9 else 1.0
    c, s = np.cos(-half), np.sin(-half)
    forward = np.array([c * motion.x - s * motion.y, s * motion.x + c * motion.y]) * scale
    step = np.array([*(forward / parts), turn / parts])
    pose = np.zeros(3)
    for _ in range(round(share * parts)):
        pose = compose(pose, np.array([step[0], step[1], step[2]]))
    return Pose2(*pose.tolist())


@given(st.floats(-0.3, 0.3), st.floats(-0.05, 0.05), st.floats(-0.6, 0.6))
def test_returns_of_a_moving_robot_come_back_to_where_they_are(
    x: float, y: float, turn: float
) -> None:
    motion = Pose2(x, y, turn)
    world = np.array([[2.0, 1.0], [-3.0, 0.5], [0.0, -4.0]])
    times = np.array([0.0, 0.05, 0.1])
    seen = np.array(
        [
            arc(motion, t / PERIOD_S, 400).inverse().apply(p[None, :])[0]
            for t, p in zip(times, world, strict=True)
        ]
    )
    found = moved_returns(seen, times, motion, PERIOD_S)
    assert np.allclose(found, world, atol=2e-3)


@functools.cache
def skewed_room(motion: Pose2, laser: Pose2, beams: int = 360) -> PlanarScan:
    """A full-circle scan, in the round room of radius 3 m about the stamp's base, while moving."""
    bearings = np.linspace(-np.pi, np.pi, beams, endpoint=False)
    times = np.linspace(0.0, PERIOD_S, beams, endpoint=False)
    ranges = np.empty(beams)
    for k, (bearing, t) in enumerate(zip(bearings, times, strict=True)):
        at = arc(motion, t / PERIOD_S, 200) @ laser
        d = np.array([np.cos(bearing + at.theta), np.sin(bearing + at.theta)])
        o = np.array([at.x, at.y])
        ranges[k] = -o @ d + np.sqrt((o @ d) ** 2 - o @ o + 9.0)
    return PlanarScan(
        stamp_ns=5,
        bearings=bearings,
        ranges=ranges,
        range_max=10.0,
        full_circle=True,
        beam_times_s=times,
    )


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
    found = deskewed(gaps, IDENTITY, Pose2(0.1, 0.0, 0.2), PERIOD_S)
    assert np.isinf(found.ranges).sum() == 120
    assert np.isnan(found.ranges).sum() == 120


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


def test_a_robot_at_rest_changes_nothing() -> None:
    scan = skewed_room(IDENTITY, IDENTITY)
    assert deskewed(scan, IDENTITY, IDENTITY, PERIOD_S) is scan


def test_a_burst_of_stamps_never_tears_a_scan_apart() -> None:
    """Two stamps a millisecond apart do not make the sweep a hundred times faster."""
    scan = skewed_room(IDENTITY, IDENTITY)
    motion = Pose2(0.2, 0.0, 0.3)
    burst = deskewed(scan, IDENTITY, motion, 0.001)
    steady = deskewed(scan, IDENTITY, motion, 0.1 * 359 / 360)
    assert np.allclose(burst.ranges, steady.ranges)


def test_heights_of_a_cloud_stay() -> None:
    points = np.random.default_rng(1).normal(size=(50, 3))
    moved = moved_returns(points, np.linspace(0, 0.1, 50), Pose2(0.5, 0.1, 0.2), PERIOD_S)
    assert np.array_equal(moved[:, 2], points[:, 2])
    assert np.allclose(moved[0], points[0])
    assert np.allclose(moved[-1, :2], Pose2(0.5, 0.1, 0.2).apply(points[-1:, :2])[0])


@given(st.floats(-0.4, 0.4), st.floats(-0.1, 0.1), st.floats(-0.5, 0.5), st.floats(0.1, 1.0))
def test_a_sweep_is_moved_by_its_share_of_the_time_between_sweeps(
    x: float, y: float, turn: float, share: float
) -> None:
    """A sweep that lasts a share of the interval, against the arc in small steps."""
    motion = Pose2(x, y, turn)
    points = np.array([[3.0, 1.0], [-2.0, 2.0]])
    moved = moved_returns(points, np.array([0.0, share * PERIOD_S]), motion, PERIOD_S)
    assert np.allclose(moved[0], points[0])
    assert np.allclose(moved[1], arc(motion, share, 200).apply(points[1:])[0], atol=5e-3)


def test_a_part_of_a_circle_stays_about_its_bearings() -> None:
    """No bearing of a 270-degree laser jumps by a turn, not even across +-pi."""
    bearings = np.linspace(0.5, 5.2, 200)
    scan = PlanarScan(
        stamp_ns=5,
        bearings=bearings,
        ranges=np.full(200, 4.0),
        range_max=10.0,
        full_circle=False,
        beam_times_s=np.linspace(0.0, PERIOD_S, 200),
    )
    found = deskewed(scan, IDENTITY, Pose2(0.1, 0.0, -0.3), PERIOD_S)
    assert np.abs(found.bearings - bearings).max() < 0.35
    assert (np.diff(found.bearings) >= 0).all()
    assert (found.stamp_ns, found.range_max, found.full_circle) == (5, 10.0, False)


@pytest.mark.parametrize(
    ("motion", "same"),
    [
        (Pose2(0.0009, 0.0, 0.00009), True),
        (Pose2(0.002, 0.0, 0.0), False),
        (Pose2(0.0, 0.0, 0.0002), False),
    ],
)
def test_only_a_motion_that_a_sweep_can_show_moves_it(motion: Pose2, same: bool) -> None:
    scan = skewed_room(IDENTITY, IDENTITY)
    assert (deskewed(scan, IDENTITY, motion, PERIOD_S) is scan) == same


def test_straight_and_hardly_turning_motions_agree() -> None:
    """The limit of a small turn is taken without a division by zero."""
    points, times = np.array([[1.0, 2.0], [3.0, -1.0]]), np.array([0.0, PERIOD_S])
    straight = moved_returns(points, times, Pose2(0.3, 0.1, 0.0), PERIOD_S)
    for turn in (1e-12, -1e-10, 1e-8):
        bent = moved_returns(points, times, Pose2(0.3, 0.1, turn), PERIOD_S)
        assert np.allclose(bent, straight, atol=1e-6)
