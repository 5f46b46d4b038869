"""Poses between those that were relaxed follow these."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.geometry import FloatArray, compose, invert, wrap_angles
from specmap_cli.core.records import Trajectory
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.relaxation import relax
from specmap_cli.layout.result import bridged, corrected, propagated, rows_of
from tests.layout.driving import CONFIG
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
        assert abs(wrap_angles(moved[k, 2:] - expected[2])[0]) < 1e-9


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
    assert np.allclose(
        compose(invert(result.poses[::2]), result.poses[1::2]), [0.02, 0.0, 0.0], atol=1e-9
    )
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
    """Tracking took the robot on straight; it turned up 2 m to the left and 1 m farther.

    Those of a robot at rest are spread by scans.
    """
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
