"""The layout of a drifting robot in a building with a loop: consistent again, and told."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import cast

import numpy as np
import pytest

from specmap_cli.core.geometry import Pose2, compose, invert
from specmap_cli.core.settings import RelaxationConfig
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.audit import Agreement, Views
from specmap_cli.layout.path_graph import Bridge, graph_of
from specmap_cli.layout.pose_graph import Link
from specmap_cli.layout.relaxation import chosen, close, relax
from specmap_cli.layout.result import Candidate, Layout
from specmap_cli.layout.walls import Walls
from tests.layout.driving import (
    CONFIG,
    Drive,
    as_tracked,
    closure,
    closures_alone,
    drifted,
    graph_by_hand,
    laid_out,
    link,
    moved_from,
    round_trip,
    stored,
    true_link,
    worst,
)

AT = 500  # where tracking breaks


@pytest.fixture
def alone() -> Iterator[None]:
    with closures_alone():
        yield


def ends_of(links: tuple[Link, ...]) -> list[tuple[int, int, str]]:
    return [(one.source, one.target, one.kind) for one in links]


def elsewhere(drive: Drive, *closures: Link) -> Layout:
    """The layout of two stretches that have no wall in common, with a break between."""
    truth, scans = drive
    poses = np.vstack([truth[:60], truth[300:360]])
    return laid_out(poses, [*scans[:60], *scans[300:360]], closures, {60: None})


def test_a_drifted_lap_is_straightened_by_nearby_passes(drive: Drive, store: KeyframeStore) -> None:
    truth, _ = drive
    layout = relax(store, [], {}, CONFIG)
    assert worst(store.poses, truth) > 1.5
    assert worst(layout.poses, truth) < 0.35
    assert len(layout.kept) >= 5
    assert {one.kind for one in layout.kept} == {"nearby"}
    assert np.array_equal(layout.poses, relax(store, [], {}, CONFIG).poses)


def test_a_closure_repairs_any_drift_and_a_wrong_one_is_dropped(drive: Drive) -> None:
    truth, scans = drive
    tracked = drifted(truth, 0.002)  # a seventh of a turn too many over the lap
    last = len(truth) - 1
    at = ((5, last - 230), (60, last - 170), (100, last - 120), (200, last - 20))
    wrong = link(30, last - 60, (9.0, -4.0, 2.0), "closure")
    with stored(tracked, scans) as store:
        assert worst(store.poses, truth) > 5.0
        layout = relax(store, [*(closure(truth, *ends) for ends in at), wrong], {}, CONFIG)
    near = [0, 100, 200, last - 200, last - 100, last]
    assert worst(layout.poses[near], truth[near]) < 1.0
    assert layout.dropped == (wrong,)
    assert layout.choice == "relaxed"
    assert layout.parts == ()


@pytest.mark.parametrize(
    ("motion", "at", "bridge"),
    [
        ((3.0, -2.0, 0.9), 560, None),  # in the second lap, by a guess metres and a turn off
        ((0.4, 0.3, 0.02), 500, Bridge(0.5, 0.05)),  # within the error of odometry
    ],
)
def test_what_follows_a_break_is_brought_to_its_walls(
    drive: Drive, motion: tuple[float, float, float], at: int, bridge: Bridge | None
) -> None:
    truth, scans = drive
    layout = laid_out(moved_from(at, truth, motion), scans, breaks={at: bridge})
    assert worst(layout.poses, truth) < (0.3 if bridge is None else 0.2)
    assert (layout.dropped, layout.loose) == ((), ())


def test_a_part_that_fits_nowhere_or_is_tied_only_to_itself_is_loose(drive: Drive) -> None:
    assert elsewhere(drive).loose == (60,)
    inside = closure(np.vstack([drive[0][:60], drive[0][300:360]]), 65, 110)
    layout = elsewhere(drive, inside)
    assert ends_of(layout.kept) == ends_of((inside,))
    assert layout.loose == (60,)


def test_without_relaxation_the_poses_are_those_tracked(drive: Drive, store: KeyframeStore) -> None:
    layout = relax(store, [], {}, RelaxationConfig(enabled=False))
    assert np.array_equal(layout.poses, store.poses)
    assert layout.kept == ()
    truth, scans = drive
    with stored(truth[:0], []) as none, stored(truth[:1], scans[:1]) as one:
        assert relax(none, [], {}, CONFIG).poses.shape == (0, 3)
        assert np.array_equal(relax(one, [], {0: None}, CONFIG).poses, one.poses)


def test_a_wrong_closure_leaves_the_others_alone(drive: Drive) -> None:
    """It only splits the path at its ends, which are nodes of the right ones here."""
    truth, scans = drive
    right = [closure(truth, i, j) for i, j in ((5, 490), (100, 590), (200, 690))]
    wrong = link(5, 590, (2.0, -1.0, 1.0), "closure")
    laid = (laid_out(drifted(truth), scans, each) for each in ([*right, wrong], right))
    with_wrong, without = laid
    assert (with_wrong.dropped, without.dropped) == ((wrong,), ())
    assert with_wrong.why == {(5, 590): "outlier"}
    assert np.allclose(with_wrong.poses, without.poses, atol=0.01)


def test_the_frame_of_the_map_does_not_matter_to_a_layout(drive: Drive) -> None:
    (truth, scans), motion = drive, np.array([40.0, -25.0, 2.5])
    known = [closure(truth, 100, 590), link(5, 590, (2.0, -1.0, 1.0), "closure")]
    both = (drifted(truth), compose(motion, drifted(truth)))
    plain, moved = (laid_out(tracked, scans, known) for tracked in both)
    assert plain.dropped == moved.dropped == (known[1],)
    assert ends_of(plain.kept) == ends_of(moved.kept)
    expected = compose(motion, plain.poses)
    assert np.abs(moved.poses[:, :2] - expected[:, :2]).max() < 5e-3


def test_the_layout_holds_what_it_was_made_of(store: KeyframeStore) -> None:
    before = store.poses
    layout = relax(store, [closure(before, 7, 21)], {0: None}, CONFIG)
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


@pytest.mark.usefixtures("alone")
def test_one_closure_does_not_move_a_piece_that_odometry_bridged(drive: Drive) -> None:
    """The bridge is good to 2 cm; a wrong closure asks for four metres."""
    truth, scans = drive
    wrong = closure(truth, 60, 540, Pose2(4.0, 0.0, 0.0))
    layout = laid_out(truth, scans, [wrong], {AT: Bridge(0.02, 0.005)})
    unknown = laid_out(truth, scans, [wrong], {AT: None})
    assert worst(layout.poses, truth) < 0.1
    assert worst(unknown.poses, truth) < 0.1, "nor on one closure's word where nothing is known"
    assert (layout.loose, unknown.loose) == ((), (AT,))
    assert {one.kind for one in layout.odometry} == {"odometry", "bridge"}
    assert [one.first for one in unknown.parts] == [AT]


@pytest.mark.usefixtures("alone")
def test_two_closures_that_agree_move_a_piece_of_which_nothing_is_known(drive: Drive) -> None:
    truth, scans = drive
    right = [closure(truth, 60, 540), closure(truth, 200, 690)]
    with stored(moved_from(AT, truth, (2.0, -3.0, 0.7)), scans) as store:
        both = relax(store, right, {AT: None}, CONFIG)
        one = relax(store, right[:1], {AT: None}, CONFIG)
    assert worst(both.poses, truth) < 0.2
    assert both.loose == ()
    (move,) = both.parts
    assert (move.first, move.votes) == (AT, 2)
    assert move.moved_m == pytest.approx(0.96, abs=0.05)
    assert one.loose == (AT,)
    assert ends_of(one.dropped) == ends_of((right[0],)), "alone it is not enough"


@pytest.mark.usefixtures("alone")
@pytest.mark.parametrize("away", [(3.0, 1.0), (0.0, 1.5)])
def test_a_wrong_closure_that_drift_would_allow_brings_walls_into_free_space(
    drive: Drive, store: KeyframeStore, away: tuple[float, float]
) -> None:
    graph = graph_of(store, [60, 540], {})
    wrong = closure(drive[0], 60, 540, Pose2(*away, 0.0))
    draft, (found,) = close(graph, as_tracked(graph), [wrong], Walls(store, graph))
    assert (draft.loops, found.reason) == ((wrong,), "drift")
    assert found.away_m > 1.0
    layout = relax(store, [wrong], {}, CONFIG)
    assert layout.choice != "relaxed"
    assert (layout.kept, layout.dropped) == ((), (wrong,))


@pytest.mark.usefixtures("alone")
def test_what_is_worse_than_the_path_as_tracked_is_not_taken(drive: Drive) -> None:
    """Three wrong closures that agree, over a path that was perfect."""
    truth, scans = drive
    off = Pose2(0.8, 0.8, 0.0)
    wrong = [closure(truth, i, j, off) for i, j in ((60, 540), (130, 610), (200, 690))]
    layout = laid_out(truth, scans, wrong)
    assert layout.choice in {"tracked", "passes"}
    assert worst(layout.poses, truth) < 0.05
    assert layout.kept == ()
    assert set(layout.dropped) == set(wrong)
    assert set(layout.why.values()) == {"walls"}


class Trusting:
    """Views that see nothing wrong in any layout they are asked of."""

    def agreement(self, *_: object) -> Agreement:
        return Agreement(agree=1000)


def test_what_the_passes_say_anyway_is_kept_with_them() -> None:
    """Closures that agree make the layout worse: those that say what the passes say stay."""
    truth = round_trip()
    graph = graph_by_hand(truth)
    passes = as_tracked(graph, *(true_link(truth, k, k + 480) for k in (20, 120)))
    near = closure(truth, 60, 540)
    wrong = link(130, len(truth) - 10, (6.0, 5.0, 1.0), "closure")
    spoiled = Candidate("relaxed", passes, (near, wrong), Agreement(agree=1000, contradict=500))
    found = chosen(graph, passes, spoiled, cast(Views, Trusting()))
    assert found.choice == "passes"
    assert found.draft.loops == (*passes.loops, near)
    assert found.dropped == (wrong,)
