"""The layout of a drifting robot: consistent again, poses between, lost parts, the map's frame."""

import dataclasses
import math
from collections.abc import Iterator
from typing import cast

import networkx as nx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.geometry import FloatArray, Pose2, compose, invert, wrap_angle, wrap_angles
from specmap_cli.core.records import Sweep, Trajectory
from specmap_cli.core.settings import RelaxationConfig
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.audit import Agreement, Views
from specmap_cli.layout.path_graph import Bridge, Draft, Graph, graph_of
from specmap_cli.layout.pose_graph import Link
from specmap_cli.layout.relaxation import chosen, close, most_voted, place_parts, relax
from specmap_cli.layout.result import (
    Candidate,
    Layout,
    along_walls,
    bridged,
    corrected,
    loose_starts,
    propagated,
    rows_of,
    wall_direction,
)
from specmap_cli.layout.walls import Walls
from tests.layout.driving import (
    CONFIG,
    Drive,
    arc,
    as_tracked,
    away_m,
    closure,
    closures_alone,
    drifted,
    graph_by_hand,
    laid_out,
    link,
    moved_from,
    stored,
    true_link,
    worst,
)
from tests.strategies import pose_arrays, seeds

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


def test_what_follows_a_break_with_a_bridge_is_brought_to_its_walls(drive: Drive) -> None:
    truth, scans = drive
    layout = laid_out(moved_from(500, truth, (0.4, 0.3, 0.02)), scans, (), {500: Bridge(0.5, 0.05)})
    assert worst(layout.poses, truth) < 0.2
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


def test_a_wrong_closure_leaves_the_others_alone_in_any_frame(drive: Drive) -> None:
    """It only splits the path at its ends, which are nodes of the right ones here."""
    (truth, scans), motion = drive, np.array([40.0, -25.0, 2.5])
    right = [closure(truth, i, j) for i, j in ((5, 490), (100, 590), (200, 690))]
    wrong, tracked = link(5, 590, (2.0, -1.0, 1.0), "closure"), drifted(truth)
    with_wrong, without = (laid_out(tracked, scans, each) for each in ([*right, wrong], right))
    assert (with_wrong.dropped, without.dropped) == ((wrong,), ())
    assert with_wrong.why == {(5, 590): "outlier"}
    assert np.allclose(with_wrong.poses, without.poses, atol=0.01)
    moved = laid_out(compose(motion, tracked), scans, [*right, wrong])
    assert moved.dropped == (wrong,)
    assert ends_of(moved.kept) == ends_of(with_wrong.kept)
    assert np.abs(moved.poses - compose(motion, with_wrong.poses))[:, :2].max() < 5e-3


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
    assert away_m(graph, wrong) > 1.0
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


def test_what_the_passes_say_anyway_is_kept_with_them(drive: Drive) -> None:
    """Closures that agree make the layout worse: those that say what the passes say stay."""
    truth, _ = drive
    graph = graph_by_hand(truth)
    passes = as_tracked(graph, *(true_link(truth, k, k + 480) for k in (20, 120)))
    near = closure(truth, 60, 540)
    wrong = link(130, len(truth) - 10, (6.0, 5.0, 1.0), "closure")
    spoiled = Candidate("relaxed", passes, (near, wrong), Agreement(agree=1000, contradict=500))
    found = chosen(graph, passes, spoiled, cast(Views, Trusting()))
    assert found.choice == "passes"
    assert found.draft.loops == (*passes.loops, near)
    assert found.dropped == (wrong,)


AWAY = (3.0, -2.0, 0.9)  # where the second part was put by a guess


def kidnapped() -> tuple[FloatArray, Graph]:
    """True poses, and the graph of a robot that was lost at 20 and again at 40."""
    truth = arc(60)
    return truth, graph_by_hand(moved_from(40, moved_from(20, truth, AWAY), AWAY), breaks=(20, 40))


@given(pose_arrays(4), seeds)
def test_a_part_goes_where_links_put_it(poses: FloatArray, seed: int) -> None:
    draft = Draft(poses=poses)
    z = np.random.default_rng(seed).uniform(-3, 3, 3)
    there, back = link(1, 3, z.tolist()), link(3, 1, invert(z).tolist())
    placed = place_parts(graph_by_hand(poses, breaks=(2,)), draft, [there, back])
    gap = compose(invert(z), compose(invert(placed.poses[1]), placed.poses[3]))
    assert placed.tied == {0, 1}
    assert np.hypot(*gap[:2]) < 1e-6
    assert abs(wrap_angles(gap[2:])[0]) < 1e-9


MOTIONS = st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-0.4, 0.4))


@given(st.lists(MOTIONS, min_size=1, max_size=8), st.tuples(st.floats(-5, 5), st.floats(-5, 5)))
def test_votes_are_those_of_a_count_by_hand(
    motions: list[tuple[float, float, float]], centre: tuple[float, float]
) -> None:
    placed = [compose(np.array(motion), np.array([*centre, 0.0])) for motion in motions]
    votes = [
        sum(np.hypot(*(a - b)[:2]) <= 0.5 and abs(wrap_angles(a - b)[2]) <= 0.15 for b in placed)
        for a in placed
    ]
    motion, agreeing = most_voted(np.array(motions), np.array(centre))
    assert agreeing == max(votes)
    assert np.array_equal(motion, motions[votes.index(max(votes))]), "the first of equals"


def test_parts_go_where_most_closures_put_them() -> None:
    truth, graph = kidnapped()
    wrong = [link(2, 22, (9.0, 9.0, 1.0)), link(3, 44, (-9.0, 9.0, 1.0))]
    right = [true_link(truth, *ends) for ends in ((0, 25), (5, 35), (30, 50), (10, 55))]
    draft = place_parts(graph, Draft(poses=graph.poses), [*wrong, *right])
    assert np.allclose(draft.poses, truth, atol=1e-9)
    assert draft.tied == {0, 1, 2}
    assert draft.loops == (), "they pull when it is solved"


def test_links_take_a_part_to_older_ones_and_along_what_hangs_on_it() -> None:
    truth, graph = kidnapped()
    draft = Draft(poses=graph.poses)
    assert place_parts(graph, draft, [true_link(truth, 21, 30)]) == draft, "to no older part"
    assert place_parts(graph, draft, [true_link(truth, 25, 50)]).tied == {0, 2}
    finds = [true_link(truth, 0, 25), true_link(truth, 5, 35), link(1, 30, (9.0, 9.0, 1.0))]
    placed = place_parts(graph, draft, finds)
    assert placed.tied == {0, 1}
    assert np.allclose(placed.poses[:40], truth[:40], atol=1e-9)
    inside = compose(invert(placed.poses[20]), placed.poses[20:])
    assert np.allclose(inside, compose(invert(graph.poses[20]), graph.poses[20:]), atol=1e-9)


@given(st.lists(st.tuples(st.integers(0, 19), st.integers(0, 19)), max_size=8))
def test_loose_parts_are_those_that_networkx_finds_apart(pairs: list[tuple[int, int]]) -> None:
    graph = graph_by_hand(arc(20), breaks=range(2, 20, 2))
    pieces = nx.empty_graph(10)
    pieces.add_edges_from((a // 2, b // 2) for a, b in pairs)
    with_first = nx.node_connected_component(pieces, 0)
    loops = [link(a, b, (0.0, 0.0, 0.0)) for a, b in pairs]
    expected = tuple(2 * part for part in range(10) if part not in with_first)
    assert loose_starts(graph, loops) == expected
    assert loose_starts(graph_by_hand(arc(20)), loops) == ()


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
    stamps, tilt = np.repeat(store.stamps_ns, 2), np.full((len(tracked), 3), 0.1)
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
    stamps = store.stamps_ns
    few = Trajectory(stamps_ns=stamps[:5], poses=store.poses[:5])
    assert rows_of(few, store.stamps_ns, store.poses).tolist() == [0, 1, 2, 3, 4]
    others = Trajectory(stamps_ns=stamps + 1, poses=store.poses)
    assert rows_of(others, store.stamps_ns, store.poses).tolist() == []


STRAIGHT = np.column_stack([np.arange(8.0), np.zeros((8, 2))])


@pytest.mark.parametrize("hole_s", [0, 6])
def test_guesses_lead_from_the_scan_before_to_the_one_after(hole_s: int) -> None:
    """Tracking went straight on; it turned up 2 m aside, 1 m farther: most of it in the hole."""
    lost, relaxed = np.isin(np.arange(8), [2, 3, 4]), np.array(STRAIGHT)
    relaxed[5:] += (1.0, 2.0, 0.4)
    stamps = 10**9 * (np.arange(8) + np.where(np.arange(8) < 2, 0, hole_s))
    found = bridged(relaxed, Trajectory(stamps, STRAIGHT, lost=lost))
    np.testing.assert_array_equal(found[~lost], relaxed[~lost])
    share = (np.array([1, 2, 3]) + hole_s) / (4 + hole_s)
    np.testing.assert_allclose(found[lost], STRAIGHT[lost] + share[:, None] * (1.0, 2.0, 0.4))


@pytest.mark.parametrize("rows", [slice(0, 3), slice(5, 8), slice(0, 8), slice(0, 0)])
def test_guesses_without_an_end_stay(rows: slice) -> None:
    lost = np.zeros(8, dtype=np.bool_)
    lost[rows] = True
    moved = STRAIGHT + (3.0, 1.0, 0.0)
    way = Trajectory(np.arange(8), STRAIGHT, lost=lost)
    np.testing.assert_array_equal(bridged(moved, way), moved)


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
