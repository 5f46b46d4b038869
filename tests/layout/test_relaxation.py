"""The layout of a drifting robot in a building with a loop: consistent again, and told."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from specmap_cli.core.geometry import FloatArray, Pose2, compose, invert
from specmap_cli.core.records import PlanarScan
from specmap_cli.core.settings import RelaxationConfig
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.relaxation import Constraint, relax
from tests.layout.driving import STIFF, drifted, stored, true_constraint, worst
from tests.turning import turned

CONFIG = RelaxationConfig()


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
        true_constraint(truth, i, j)
        for i, j in ((5, last - 230), (60, last - 170), (100, last - 120), (200, last - 20))
    ]
    wrong = Constraint(30, last - 60, Pose2(9.0, -4.0, 2.0), STIFF)
    with stored(tracked, scans) as store:
        assert worst(store.poses, truth) > 5.0
        layout = relax(store, [*right, wrong], [], CONFIG)
    near = [0, 100, 200, last - 200, last - 100, last]
    assert worst(layout.poses[near], truth[near]) < 1.0
    assert [(link.source, link.target) for link in layout.dropped] == [(30, last - 60)]
    assert [edge.kind for edge in layout.dropped] == ["closure"]


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
    assert (layout.dropped, layout.loose) == ((), ())
    assert layout.loose == ()


def test_a_part_that_fits_nowhere_is_said(drive: tuple[FloatArray, list[PlanarScan]]) -> None:
    truth, scans = drive
    elsewhere = np.vstack([truth[:60], truth[300:360]])
    with stored(elsewhere, [*scans[:60], *scans[300:360]]) as store:
        layout = relax(store, [], [60], CONFIG)
    assert [store.stamps_ns[start] for start in layout.loose] == [30 * 10**9]
    assert layout.loose == (60,)


def test_a_part_tied_only_to_itself_is_still_loose(
    drive: tuple[FloatArray, list[PlanarScan]],
) -> None:
    truth, scans = drive
    elsewhere = np.vstack([truth[:60], truth[300:360]])
    inside = Pose2(*compose(invert(elsewhere[65]), elsewhere[110]).tolist())
    with stored(elsewhere, [*scans[:60], *scans[300:360]]) as store:
        layout = relax(store, [Constraint(65, 110, inside, STIFF)], [60], CONFIG)
    assert [(link.source, link.target) for link in layout.kept] == [(65, 110)]
    assert layout.loose == (60,)


def test_without_relaxation_the_poses_are_those_tracked(store: KeyframeStore) -> None:
    layout = relax(store, [], [], RelaxationConfig(enabled=False))
    assert np.array_equal(layout.poses, store.poses)
    assert layout.kept == ()


def test_empty_and_single_stores_are_laid_out(
    drive: tuple[FloatArray, list[PlanarScan]],
) -> None:
    truth, scans = drive
    with stored(truth[:0], []) as none, stored(truth[:1], scans[:1]) as one:
        assert relax(none, [], [], CONFIG).poses.shape == (0, 3)
        assert np.array_equal(relax(one, [], [0], CONFIG).poses, one.poses)


def test_two_wrong_closures_are_told_in_one_line(
    drive: tuple[FloatArray, list[PlanarScan]],
) -> None:
    truth, scans = drive
    wrong = [Constraint(30, k, Pose2(9.0, -4.0, 2.0), STIFF) for k in (600, 650)]
    with stored(truth, scans) as store:
        layout = relax(store, wrong, [], CONFIG)
    assert [edge.kind for edge in layout.dropped].count("closure") == 2
    assert {(edge.source, edge.target) for edge in layout.dropped} == {(30, 600), (30, 650)}
    assert worst(layout.poses, truth) < 0.1


def test_a_wrong_closure_leaves_the_others_alone(
    drive: tuple[FloatArray, list[PlanarScan]],
) -> None:
    """It only splits the path at its ends, which are nodes of the right ones here."""
    truth, scans = drive
    right = [true_constraint(truth, i, j) for i, j in ((5, 490), (100, 590), (200, 690))]
    wrong = Constraint(5, 590, Pose2(2.0, -1.0, 1.0), STIFF)
    with stored(drifted(truth), scans) as store:
        with_wrong, without = (relax(store, c, [], CONFIG) for c in ([*right, wrong], right))
    assert [(edge.source, edge.target) for edge in with_wrong.dropped] == [(5, 590)]
    assert without.dropped == ()
    assert np.allclose(with_wrong.poses, without.poses, atol=1e-6)


def test_the_frame_of_the_map_does_not_matter(
    drive: tuple[FloatArray, list[PlanarScan]],
) -> None:
    (truth, scans), motion = drive, np.array([40.0, -25.0, 2.5])
    right = [true_constraint(truth, 100, 590)]
    layouts = []
    for tracked in (drifted(truth), compose(motion, drifted(truth))):
        with stored(tracked, scans) as store:
            layouts.append(relax(store, right, [], CONFIG))
    plain, moved = layouts
    assert [(e.source, e.target) for e in plain.kept] == [(e.source, e.target) for e in moved.kept]
    expected = compose(motion, plain.poses)
    assert np.abs(moved.poses[:, :2] - expected[:, :2]).max() < 5e-3


def test_the_layout_holds_what_it_was_made_of(store: KeyframeStore) -> None:
    before = store.poses
    constraints = [true_constraint(before, 7, 21)]
    layout = relax(store, constraints, [0], CONFIG)
    assert np.array_equal(store.poses, before)
    assert {0, 7, 21, len(store) - 1} <= set(layout.nodes.tolist())
    assert len(layout.odometry) == len(layout.nodes) - 1
    assert {edge.kind for edge in layout.odometry} == {"odometry"}, "keyframe 0 is no break"
    assert layout.loose == ()
    assert np.allclose(layout.poses[0], before[0])
    motion = compose(invert(layout.poses[:-1]), layout.poses[1:])
    tracked = compose(invert(before[:-1]), before[1:])
    inside = ~np.isin(np.arange(1, len(before)), layout.nodes)
    assert np.allclose(motion[inside], tracked[inside], atol=1e-9), "between nodes it is rigid"
    with pytest.raises(dataclasses.FrozenInstanceError):
        layout.poses = before  # type: ignore[misc]


def test_limits_that_were_hit_are_told(drive: tuple[FloatArray, list[PlanarScan]]) -> None:
    truth, scans = drive
    elsewhere = np.vstack([truth[:60], truth[300:360]])
    with stored(drifted(elsewhere, 0.003), [*scans[:60], *scans[300:360]]) as store:
        with turned("layout.solving", _SOLVE_ITERATIONS=1), turned("layout.strays", STRAY_TRIES=2):
            layout = relax(store, [true_constraint(elsewhere, 3, 50)], [60], CONFIG)
        usual = relax(store, [true_constraint(elsewhere, 3, 50)], [60], CONFIG)
    assert layout.limits["stray_tries"] == 1
    assert layout.limits["solve_iterations"] >= 1
    assert usual.limits == {}


def test_closures_are_all_there_is_without_passes(
    drive: tuple[FloatArray, list[PlanarScan]],
) -> None:
    truth, scans = drive
    without_passes = turned("layout.nearby_passes", LOOPS_PER_NODE=0)
    with stored(drifted(truth), scans) as store, without_passes:
        alone = relax(store, [], [], CONFIG)
        tied = relax(store, [true_constraint(truth, 100, 590)], [], CONFIG)
    tracked = drifted(truth)
    assert np.allclose(alone.poses, tracked, atol=1e-6)
    assert alone.kept == ()
    assert [(edge.source, edge.target, edge.kind) for edge in tied.kept] == [(100, 590, "closure")]
    gap = compose(invert(tied.poses[100]), tied.poses[590])
    assert np.hypot(*(gap - compose(invert(truth[100]), truth[590]))[:2]) < 0.1
    assert np.hypot(*(compose(invert(tracked[100]), tracked[590]) - gap)[:2]) > 0.5
