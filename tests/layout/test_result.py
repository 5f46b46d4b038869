"""Poses between those that were relaxed follow these; the frame of a map follows the walls."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.geometry import FloatArray, Pose2, compose, invert, wrap_angle
from specmap_cli.core.records import Sweep, Trajectory
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.relaxation import relax
from specmap_cli.layout.result import (
    Layout,
    along_walls,
    bridged,
    corrected,
    propagated,
    rows_of,
    wall_direction,
)
from tests.layout.driving import CONFIG, stored
from tests.strategies import pose_arrays


@given(pose_arrays(8), pose_arrays(8), st.sets(st.integers(0, 7), min_size=1))
def test_each_pose_keeps_its_motion_since_the_last_relaxed_one(
    tracked: FloatArray, new: FloatArray, chosen: set[int]
) -> None:
    rows = np.array(sorted(chosen))
    moved = propagated(tracked, rows, new[rows])
    for k in range(8):
        last = max((a for a in chosen if a <= k), default=min(chosen))
        expected = compose(new[last], compose(invert(tracked[last]), tracked[k]))
        assert np.allclose(moved[k, :2], expected[:2], atol=1e-6)
        assert abs(wrap_angle(float(moved[k, 2] - expected[2]))) < 1e-9


@given(pose_arrays(5))
def test_without_a_relaxed_pose_nothing_moves(tracked: FloatArray) -> None:
    free = propagated(tracked, np.zeros(0, dtype=np.int64), np.zeros((0, 3)))
    assert np.array_equal(free, tracked)
    free[0] = 99.0
    assert tracked[0, 0] <= 50.0, "a copy"


def test_every_scan_of_the_trajectory_moves_with_its_keyframe(store: KeyframeStore) -> None:
    """Stamps repeat and step back; scans between keyframes come along."""
    layout = relax(store, [], {}, CONFIG)
    tracked = np.repeat(store.poses, 2, axis=0)
    tracked[1::2] = compose(tracked[1::2], np.array([0.02, 0.0, 0.0]))
    stamps, tilt = np.repeat(np.array(store.stamps_ns), 2), np.full((len(tracked), 3), 0.1)
    trajectory = Trajectory(stamps_ns=stamps, poses=tracked, tilt=tilt)
    rows = rows_of(trajectory, store.stamps_ns, store.poses)
    assert np.array_equal(rows, np.arange(0, len(stamps), 2))
    result = corrected(trajectory, store, layout.poses)
    assert np.allclose(result.poses[::2], layout.poses)
    motions = compose(invert(result.poses[::2]), result.poses[1::2])
    assert np.allclose(motions, [0.02, 0.0, 0.0], atol=1e-9)
    assert np.array_equal(result.stamps_ns, stamps)
    assert result.tilt is tilt, "height, roll and pitch stay"


def test_a_trajectory_may_end_before_the_keyframes_do(store: KeyframeStore) -> None:
    stamps = np.array(store.stamps_ns)
    few = Trajectory(stamps_ns=stamps[:5], poses=store.poses[:5])
    assert rows_of(few, store.stamps_ns, store.poses).tolist() == [0, 1, 2, 3, 4]
    others = Trajectory(stamps_ns=stamps + 1, poses=store.poses)
    assert rows_of(others, store.stamps_ns, store.poses).tolist() == []


STRAIGHT = np.column_stack([np.arange(8.0), np.zeros((8, 2))])


@pytest.mark.parametrize("forward_m", [1.0, 0.0])
def test_guesses_lead_from_the_scan_before_to_the_one_after(forward_m: float) -> None:
    """Tracking went straight on; it turned up 2 m aside, 1 m farther. At rest scans spread it."""
    tracked = STRAIGHT * forward_m
    lost = np.isin(np.arange(8), [2, 3, 4])
    relaxed = np.array(tracked)
    relaxed[5:] += (1.0, 2.0, 0.4)
    found = bridged(relaxed, tracked, lost)
    np.testing.assert_array_equal(found[~lost], relaxed[~lost])
    share = np.array([0.25, 0.5, 0.75])
    np.testing.assert_allclose(found[lost], tracked[lost] + share[:, None] * (1.0, 2.0, 0.4))


@pytest.mark.parametrize("rows", [slice(0, 3), slice(5, 8), slice(0, 8), slice(0, 0)])
def test_guesses_without_an_end_stay(rows: slice) -> None:
    lost = np.zeros(8, dtype=np.bool_)
    lost[rows] = True
    moved = STRAIGHT + (3.0, 1.0, 0.0)
    np.testing.assert_array_equal(bridged(moved, STRAIGHT, lost), moved)


@pytest.fixture(scope="module")
def toured(flat_tour: list[tuple[Sweep, Pose2]]) -> Iterator[tuple[KeyframeStore, FloatArray]]:
    """Some scans of the flat, and the true poses; the walls of the plan lie along its axes."""
    scans, poses = zip(*flat_tour[::40], strict=True)
    with stored(np.array(poses), [sweep.planar for sweep in scans]) as store:
        yield store, store.poses


@given(st.floats(-44.0, 44.0))
def test_walls_end_up_along_axes(toured: tuple[KeyframeStore, FloatArray], degrees: float) -> None:
    store, truth = toured
    recorded = compose(np.array([3.0, -2.0, math.radians(degrees)]), truth)
    layout = along_walls(Layout(poses=recorded), store, CONFIG)
    turned = wrap_angle(float(layout.poses[0, 2] - recorded[0, 2]))
    assert math.degrees(turned) == pytest.approx(-degrees, abs=0.3)
    turn = np.array([0.0, 0.0, turned])
    np.testing.assert_allclose(layout.poses, compose(turn, recorded), atol=1e-9)
    asked = CONFIG.model_copy(update={"follow_walls": False})
    as_recorded = Layout(poses=recorded)
    assert along_walls(as_recorded, store, asked) is as_recorded


@given(st.integers(0, 10_000), st.floats(-0.7, 0.7))
def test_the_direction_of_most_walls_counts_in_any_quarter(seed: int, direction: float) -> None:
    rng = np.random.default_rng(seed)
    quarters = rng.integers(0, 4, 300) * (math.pi / 2.0)
    walls = direction + quarters + rng.normal(0.0, 0.01, 300)
    others = rng.uniform(-math.pi, math.pi, 60)
    found = wall_direction(np.concatenate([walls, others]), np.ones(360))
    assert found == pytest.approx(direction, abs=0.01)


@pytest.mark.parametrize("count", [0, 3600])
def test_where_no_direction_stands_out_nothing_is_turned(count: int) -> None:
    directions = np.linspace(-math.pi, math.pi, count, endpoint=False)
    assert wall_direction(directions, np.ones(count)) == 0.0
