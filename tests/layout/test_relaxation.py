"""The layout of a drifting robot in a building with a loop: consistent again, and carried along."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from specmap_cli.core.config import RelaxationConfig
from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2, compose, invert
from specmap_cli.core.records import PlanarScan, PosedScan, Trajectory
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.grids.ray_casting import cast_ranges
from specmap_cli.layout.motion_edges import observability, step_information
from specmap_cli.layout.relaxation import (
    Constraint,
    carried,
    chosen_nodes,
    corrected,
    keyframe_rows,
    relax,
)

CONFIG = RelaxationConfig()
STIFF = np.diag([1 / 0.04**2, 1 / 0.04**2, 1 / 0.01**2])


def building() -> GridMap:
    """A ring of corridor, 17 m x 13 m and 2 m wide, with rooms of all sizes off it."""
    cells = np.full((300, 380), OCCUPIED, dtype=np.uint8)
    cells[30:270, 30:350] = FREE
    cells[70:230, 70:310] = OCCUPIED
    for bottom, top, left, right in (
        (66, 110, 90, 130),  # off the lower corridor
        (66, 140, 170, 190),
        (66, 90, 220, 300),
        (190, 234, 80, 180),  # off the upper one
        (210, 234, 240, 260),
        (120, 160, 60, 110),  # off the left one
        (4, 34, 60, 100),  # outwards
        (4, 34, 200, 215),
        (10, 34, 250, 330),
        (266, 290, 100, 160),
        (266, 296, 280, 300),
        (120, 150, 346, 376),
        (200, 260, 346, 366),
        (90, 130, 8, 34),
    ):
        cells[bottom:top, left:right] = FREE
    return GridMap(cells, 0.05)


def round_trip(laps: float) -> FloatArray:
    """True poses every 10 cm along the middle of the ring."""
    corners = np.array([[2.5, 2.5], [16.5, 2.5], [16.5, 12.5], [2.5, 12.5]])
    poses, lap = [], 0.0
    while lap < laps:
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            heading = float(np.arctan2(*(b - a)[::-1]))
            steps = int(np.hypot(*(b - a)) / 0.1)
            poses += [(*(a + (b - a) * k / steps), heading) for k in range(steps)]
            lap += 0.25
            if lap >= laps:
                break
    return np.array(poses)


@pytest.fixture(scope="module")
def drive() -> tuple[FloatArray, list[PlanarScan]]:
    """True poses of 1.5 laps and the scans taken there."""
    grid, truth = building(), round_trip(1.5)
    bearings = np.linspace(-np.pi, np.pi, 120, endpoint=False)
    distance = grid.obstacle_distance()
    scans = []
    rng = np.random.default_rng(0)
    for k, (x, y, heading) in enumerate(truth):
        ranges = cast_ranges(distance, grid, np.array([[x, y]]), bearings + heading, 10.0)[0]
        scans.append(PlanarScan(k * 10**8, bearings, ranges + rng.normal(0, 0.01, 120), 12.0, True))
    return truth, scans


def drifted(truth: FloatArray, bias: float = 0.0003) -> FloatArray:
    """Tracked poses: each step turns a little too far."""
    steps = compose(invert(truth[:-1]), truth[1:])
    steps[:, 2] += bias
    poses = [truth[0]]
    for step in steps:
        poses.append(compose(poses[-1], step))
    return np.array(poses)


def stored(tracked: FloatArray, scans: list[PlanarScan]) -> KeyframeStore:
    store = KeyframeStore()
    for k, (pose, scan) in enumerate(zip(tracked, scans, strict=True)):
        store.append(PosedScan(k, scan.stamp_ns, Pose2(*pose.tolist()), scan, IDENTITY))
    return store


@pytest.fixture
def store(drive: tuple[FloatArray, list[PlanarScan]]) -> Iterator[KeyframeStore]:
    truth, scans = drive
    with stored(drifted(truth), scans) as store:
        yield store


def worst(poses: FloatArray, truth: FloatArray) -> float:
    """Largest error of the place, seen from the first pose."""
    seen = compose(invert(poses[0]), poses)
    true = compose(invert(truth[0]), truth)
    return float(np.hypot(*(seen - true)[:, :2].T).max())


def test_a_drifted_lap_is_straightened_by_nearby_passes(
    drive: tuple[FloatArray, list[PlanarScan]], store: KeyframeStore
) -> None:
    truth, _ = drive
    before = worst(store.poses, truth)
    layout = relax(store, [], [], CONFIG)
    assert before > 1.5
    assert worst(layout.poses, truth) < 0.35
    assert len(layout.kept) >= 5
    assert all(link.kind == "nearby" for link in layout.kept)
    again = relax(store, [], [], CONFIG)
    assert np.array_equal(layout.poses, again.poses)


def test_a_closure_repairs_any_drift_and_a_wrong_one_is_dropped(
    drive: tuple[FloatArray, list[PlanarScan]],
) -> None:
    truth, scans = drive
    tracked = drifted(truth, 0.002)  # a seventh of a turn too many over the lap
    last = len(truth) - 1
    right = [
        Constraint(i, j, Pose2(*compose(invert(truth[i]), truth[j]).tolist()), STIFF)
        for i, j in ((5, last - 230), (60, last - 170), (100, last - 120), (200, last - 20))
    ]
    wrong = Constraint(30, last - 60, Pose2(9.0, -4.0, 2.0), STIFF)
    with stored(tracked, scans) as store:
        assert worst(store.poses, truth) > 5.0
        layout = relax(store, [*right, wrong], [], CONFIG)
    near = [0, 100, 200, last - 200, last - 100, last]
    assert worst(layout.poses[near], truth[near]) < 1.0
    assert [(link.source, link.target) for link in layout.dropped] == [(30, last - 60)]
    assert any("1 loop closures contradict" in line for line in layout.warnings)


def test_a_part_placed_anywhere_is_found_by_its_walls(
    drive: tuple[FloatArray, list[PlanarScan]],
) -> None:
    """Tracking breaks in the second lap; the guess across the gap is metres and a turn off."""
    truth, scans = drive
    at = 560
    kidnapped = np.array(truth)
    kidnapped[at:] = compose(np.array([3.0, -2.0, 0.9]), truth[at:])
    with stored(kidnapped, scans) as store:
        layout = relax(store, [], [at], CONFIG)
    assert worst(layout.poses, truth) < 0.3
    assert layout.warnings == []
    assert layout.loose == []


def test_a_part_that_fits_nowhere_is_said(drive: tuple[FloatArray, list[PlanarScan]]) -> None:
    truth, scans = drive
    elsewhere = np.vstack([truth[:60], truth[300:360]])
    with stored(elsewhere, [*scans[:60], *scans[300:360]]) as store:
        layout = relax(store, [], [60], CONFIG)
    assert any("a guess only" in line for line in layout.warnings)
    assert layout.loose == [60]


def test_a_part_tied_only_to_itself_is_still_loose(
    drive: tuple[FloatArray, list[PlanarScan]],
) -> None:
    truth, scans = drive
    elsewhere = np.vstack([truth[:60], truth[300:360]])
    inside = Pose2(*compose(invert(elsewhere[65]), elsewhere[110]).tolist())
    with stored(elsewhere, [*scans[:60], *scans[300:360]]) as store:
        layout = relax(store, [Constraint(65, 110, inside, STIFF)], [60], CONFIG)
    assert [(link.source, link.target) for link in layout.kept] == [(65, 110)]
    assert layout.loose == [60]


def test_without_relaxation_the_poses_are_those_tracked(store: KeyframeStore) -> None:
    layout = relax(store, [], [], RelaxationConfig(enabled=False))
    assert np.array_equal(layout.poses, store.poses)
    assert layout.kept == []


def test_empty_and_single_stores_are_laid_out(
    drive: tuple[FloatArray, list[PlanarScan]],
) -> None:
    truth, scans = drive
    with stored(truth[:0], []) as none, stored(truth[:1], scans[:1]) as one:
        assert relax(none, [], [], CONFIG).poses.shape == (0, 3)
        assert np.array_equal(relax(one, [], [0], CONFIG).poses, one.poses)


def test_nodes_are_a_step_apart_and_hold_what_must_be() -> None:
    poses = np.column_stack([np.arange(100) * 0.05, np.zeros(100), np.zeros(100)])
    nodes = chosen_nodes(poses, {17, 50}, CONFIG).tolist()
    assert {0, 17, 50, 99} <= set(nodes)
    assert np.diff(nodes).max() * 0.05 <= CONFIG.node_m + 0.05 + 1e-9
    assert len(nodes) < 25


def test_poses_between_anchors_follow_the_last_one() -> None:
    tracked = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]])
    anchors, relaxed = np.array([1, 3]), np.array([[5.0, 5, np.pi / 2], [7, 7, 0]])
    moved = carried(tracked, anchors, relaxed)
    assert np.allclose(moved[:, :2], [[5, 4], [5, 5], [5, 6], [7, 7]])


def test_every_scan_of_the_trajectory_moves_with_its_keyframe(store: KeyframeStore) -> None:
    """Stamps repeat and step back; scans between keyframes come along."""
    layout = relax(store, [], [], CONFIG)
    tracked = np.repeat(store.poses, 2, axis=0)
    tracked[1::2] = compose(tracked[1::2], np.array([0.02, 0.0, 0.0]))
    stamps = np.repeat(np.array(store.stamps_ns), 2)
    trajectory = Trajectory(stamps, tracked)
    rows = keyframe_rows(trajectory, store)
    assert np.array_equal(rows, np.arange(0, len(stamps), 2))
    result = corrected(trajectory, store, layout)
    assert np.allclose(result.poses[::2], layout.poses)
    assert np.allclose(
        compose(invert(result.poses[::2]), result.poses[1::2]), [0.02, 0.0, 0.0], atol=1e-9
    )


def test_a_bare_corridor_leaves_the_way_along_it_open() -> None:
    x = np.linspace(-5, 5, 100)
    walls = np.vstack([np.column_stack([x, x * 0 - 1]), np.column_stack([-x, x * 0 + 1])])
    fisher = observability(walls)
    assert fisher[0, 0] < 1e-6 * fisher[1, 1]
    sigma = np.sqrt(np.diag(np.linalg.inv(step_information(Pose2(0.3, 0, 0), walls))))
    assert sigma[0] > 0.25
    assert sigma[1] < 0.05
    end = np.column_stack([x * 0 + 5, np.linspace(-1, 1, 100)])
    closed = step_information(Pose2(0.3, 0, 0), np.vstack([walls, end]))
    assert np.sqrt(np.linalg.inv(closed)[0, 0]) < 0.05
