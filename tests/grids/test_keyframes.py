"""Keyframes: the robot must move for one, and their scans stay out of memory."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.config import GridConfig, KeyframeConfig
from specmap_cli.core.geometry import IDENTITY, Pose2
from specmap_cli.core.records import PlanarScan, PosedScan
from specmap_cli.grids.keyframes import KeyframeSelector, KeyframeStore, integrate_keyframes
from specmap_cli.grids.occupancy import OccupancyGrid
from tests.strategies import planar_scans, poses

CONFIG = KeyframeConfig(distance_m=0.1, angle_rad=0.05)
NOTHING = PlanarScan(0, np.array([0.0]), np.array([np.inf]), 10.0, False)


def at(x: float, theta: float = 0.0, lost: bool = False, restarted: bool = False) -> PosedScan:
    pose = Pose2(x, 0.0, theta)
    return PosedScan(0, 0, pose, NOTHING, IDENTITY, lost=lost, restarted=restarted)


def test_a_scan_counts_when_the_robot_moved_or_turned_since_the_last_that_did() -> None:
    selector = KeyframeSelector(CONFIG)
    way = [at(0.0), at(0.06), at(0.11), at(0.17), at(0.17, 0.06), at(0.17, 0.04), at(0.17, -0.01)]
    assert [selector.accepts(scan) for scan in way] == [True, False, True, False, True, False, True]


def test_a_robot_that_stands_still_adds_nothing() -> None:
    selector = KeyframeSelector(CONFIG)
    accepted = [
        selector.accepts(at(1e-3 * (i % 7), 3.14159 if i % 2 else -3.14159)) for i in range(99)
    ]
    assert sum(accepted) == 1


def test_lost_scans_never_count_and_the_first_after_them_always_does() -> None:
    selector = KeyframeSelector(CONFIG)
    way = [at(0.0, lost=True), at(0.0), at(5.0, lost=True), at(0.01), at(0.02, restarted=True)]
    assert [selector.accepts(scan) for scan in way] == [False, True, False, False, True]


@given(st.lists(st.tuples(planar_scans(beams=16), poses, poses), min_size=1, max_size=5))
def test_what_is_stored_is_read_back(taken: list[tuple[PlanarScan, Pose2, Pose2]]) -> None:
    with KeyframeStore() as store:
        for index, (scan, pose, mounting) in enumerate(taken):
            posed = PosedScan(index, scan.stamp_ns, pose, scan, mounting)
            assert store.append(posed) == index
        assert len(store) == len(taken)
        np.testing.assert_array_equal(store.poses, np.array([pose for _, pose, _ in taken]))
        np.testing.assert_array_equal(store.poses_of([0, len(taken) - 1]), store.poses[[0, -1]])
        assert store.stamps_ns == [scan.stamp_ns for scan, _, _ in taken]
        for number in reversed(range(len(taken))):
            scan, pose, mounting = taken[number]
            found = store.scan(number)
            np.testing.assert_array_equal(found.ranges, scan.ranges.astype(np.float32))
            np.testing.assert_allclose(found.bearings, scan.bearings, atol=1e-6)
            assert (found.stamp_ns, found.range_max) == (scan.stamp_ns, scan.range_max)
            assert found.full_circle == scan.full_circle
            assert store.pose(number) == pose
            assert store.base_from_laser(number) == mounting
            np.testing.assert_allclose(
                store.points(number, 3.0), mounting.apply(scan.hits(3.0)), atol=1e-4
            )


def test_a_store_may_be_read_while_it_grows() -> None:
    with KeyframeStore() as store:
        for number in range(5):
            ranges = np.full(3 + number, float(number))
            scan = PlanarScan(number, np.linspace(-1, 1, 3 + number), ranges, 10.0, False)
            store.append(replace(at(number), planar=scan))
            for earlier in range(number + 1):
                assert store.scan(earlier).ranges.tolist() == [earlier] * (3 + earlier)


def test_an_empty_store_has_empty_arrays() -> None:
    with KeyframeStore() as store:
        assert store.poses.shape == (0, 3)
        assert store.poses_of([]).shape == (0, 3)
        assert len(store) == 0


def test_scans_do_not_stay_in_memory() -> None:
    beams, scans = 2000, 1000
    bearings = np.linspace(-3, 3, beams)
    scan = PlanarScan(0, bearings, np.full(beams, 5.0), 10.0, False)
    tracemalloc.start()
    with KeyframeStore() as store:
        for number in range(scans):
            store.append(replace(at(number), planar=scan))
        for number in range(scans):
            store.scan(number)
        held, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert held < scans * 1000  # of the 16,000 bytes a scan
    assert peak < scans * 1000 + 10 * scan.ranges.nbytes


def test_a_closed_store_is_gone() -> None:
    store = KeyframeStore()
    store.append(at(0.0))
    store.close()
    with pytest.raises(ValueError, match="closed"):
        store.scan(0)


@given(st.lists(st.tuples(planar_scans(beams=24), poses, poses), min_size=1, max_size=3))
def test_a_grid_of_keyframes_is_that_of_their_scans(
    taken: list[tuple[PlanarScan, Pose2, Pose2]],
) -> None:
    config = GridConfig(resolution_m=0.1, footprint_m=0.3)
    direct = OccupancyGrid(config)
    with KeyframeStore() as store:
        for scan, pose, mounting in taken:
            store.append(PosedScan(0, 0, pose, scan, mounting))
        numbers = list(range(len(taken)))[::-1]
        for number in numbers:
            pose = store.pose(number)
            direct.integrate(store.scan(number), pose @ store.base_from_laser(number))
            direct.mark_free_disc(pose.x, pose.y, 0.3)
        found = integrate_keyframes(store, numbers, store.poses_of(numbers), config).snapshot()
    expected = direct.snapshot()
    np.testing.assert_array_equal(found.cells, expected.cells)
    assert found.origin == expected.origin
