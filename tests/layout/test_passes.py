"""Passes: which pairs of nodes are matched along the path, far and near, and what comes of it."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.geometry import FloatArray, Pose2, compose, invert, wrap_angle
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.grids.matching import PRIOR_SIGMAS
from specmap_cli.layout.consistency import judge, path_error
from specmap_cli.layout.passes import (
    PassesOnTheWay,
    candidates,
    far_passes,
    find_passes,
    passes_at,
    tied,
)
from specmap_cli.layout.path_graph import LOOP_PATH_M, Bridge, Draft, Graph, graph_of, solved
from specmap_cli.layout.pose_graph import Link
from specmap_cli.layout.walls import Walls
from tests.layout.driving import (
    SECOND_LAP,
    Drive,
    as_tracked,
    away_m,
    between,
    drifted,
    link,
    missed,
    posed,
    stored,
)
from tests.strategies import pose_arrays
from tests.turning import turned


def candidates_by_hand(node: int, poses: FloatArray, path: FloatArray, radius: float) -> list[int]:
    """The candidates of a node, from the words of the constants."""
    ranked = []
    for k in range(len(poses)):
        distance = float(np.hypot(*(poses[k, :2] - poses[node, :2])))
        turn = abs(wrap_angle(float(poses[k, 2] - poses[node, 2])))
        if path[node] - path[k] > LOOP_PATH_M and distance < radius:
            ranked.append((distance + 0.7 * turn, k))
    chosen: list[int] = []
    for _, k in sorted(ranked):
        if all(abs(path[k] - path[other]) > radius for other in chosen):
            chosen.append(k)
    return chosen


@given(
    pose_arrays(16),
    st.lists(st.floats(0.0, 3.0), min_size=16, max_size=16),
    st.integers(0, 15),
    st.floats(0.5, 60.0),
)
def test_candidates_are_near_far_along_the_path_and_apart(
    poses: FloatArray, steps: list[float], node: int, radius: float
) -> None:
    path = np.cumsum(steps)
    with turned("layout.passes", _NEAR_M=radius):
        assert candidates(node, poses, path) == candidates_by_hand(node, poses, path, radius)


def test_a_pass_is_linked_and_noted_and_none_per_node_is_none(graph: Graph, walls: Walls) -> None:
    first = passes_at(190, graph, graph.poses, walls, {}, set(), tied(graph, ()))
    assert first.is_tied
    (found,) = first.links
    truth = between(graph.tracked, found.source, found.target)
    assert (truth.inverse() @ found.source_from_target).distance < 0.1
    assert found.target == graph.nodes[190]
    linked = {ends_of(graph, one) for one in first.links}
    again = passes_at(190, graph, graph.poses, walls, first.guesses, linked, tied(graph, ()))
    assert (again.links, again.is_tied, again.guesses) == ((), True, first.guesses)
    with turned("layout.passes", LOOPS_PER_NODE=0):
        none = passes_at(190, graph, graph.poses, walls, {}, set(), tied(graph, ()))
        assert (none.links, none.guesses, none.is_tied) == ((), {}, False)
        assert find_passes(graph, as_tracked(graph), walls).loops == ()


def test_a_pass_is_searched_as_far_as_the_way_to_it_may_drift(graph: Graph, walls: Walls) -> None:
    poses = np.array(graph.poses)
    poses[150:, 0] += 0.8
    (found,) = passes_at(190, graph, poses, walls, {}, set(), tied(graph, ())).links
    truth = between(graph.tracked, found.source, found.target)
    assert (truth.inverse() @ found.source_from_target).distance < 0.1
    near = link(found.source, int(graph.nodes[188]), (0, 0, 0))  # its other tie, a step before
    assert not passes_at(190, graph, poses, walls, {}, set(), tied(graph, [near])).is_tied


def test_the_second_pass_is_asked_when_the_first_does_not_fit(graph: Graph, walls: Walls) -> None:
    graph = replace(graph, path=10 * graph.path)  # so that neighbours are passes of their own
    best, second = candidates(190, graph.poses, graph.path)[:2]
    guess = Pose2(*compose(invert(graph.poses[best]), graph.poses[190]).tolist())
    tried = {(best, 190): guess}  # to no avail
    found = passes_at(190, graph, graph.poses, walls, tried, set(), tied(graph, ()))
    assert {ends_of(graph, one) for one in found.links} == {(second, 190)}
    with turned("layout.passes", LOOPS_PER_NODE=1):
        assert not passes_at(190, graph, graph.poses, walls, tried, set(), tied(graph, ())).is_tied


@pytest.mark.parametrize(("shift", "count"), [(0.9, 0), (1.1, 1)])
def test_a_moved_pair_is_matched_anew(graph: Graph, walls: Walls, shift: float, count: int) -> None:
    with turned("layout.passes", LOOPS_PER_NODE=1):
        first = passes_at(190, graph, graph.poses, walls, {}, set(), tied(graph, ()))
        moved = {pair: guess @ Pose2(shift, 0.0, 0.0) for pair, guess in first.guesses.items()}
        found = passes_at(190, graph, graph.poses, walls, moved, set(), tied(graph, ()))
    assert len(found.links) == count


def test_passes_are_found_along_the_second_lap(graph: Graph, walls: Walls) -> None:
    draft = as_tracked(graph)
    found = find_passes(graph, draft, walls)
    assert len(found.loops) >= 15
    for edge in found.loops:
        truth = between(graph.tracked, edge.source, edge.target)
        assert edge.target > 440
        assert (truth.inverse() @ edge.source_from_target).distance < 0.1
    assert np.abs(found.poses - graph.poses).max() < 0.1, "they confirm what was right"
    assert draft.loops == ()
    assert draft.matched == {}
    again = find_passes(graph, found, walls)
    fresh = set(again.matched) - set(found.matched)
    assert len(fresh) <= 2, "nodes moved by millimetres: hardly another one is the nearest"
    assert found.loops == again.loops[: len(found.loops)]
    assert len(again.loops) <= len(found.loops) + len(fresh)


def test_where_more_passes_came_by_fewer_nodes_are_asked(graph: Graph, walls: Walls) -> None:
    """Each neighbour of a node counts as a pass of its own: there are many."""
    known = replace(graph, path=10 * graph.path)  # metres that are decimetres
    with turned("layout.path_graph", LOOP_EVERY_M=10.0, LOOP_PATH_M=60.0):
        with turned("layout.consistency", DRIFT_SHARE=0.004):
            found = find_passes(known, as_tracked(graph), walls)
        with turned("layout.consistency", DRIFT_SHARE=0.02):
            often = find_passes(known, as_tracked(graph), walls)
    ways = np.diff(known.path[sorted(graph.row[link.target] for link in found.loops)])
    assert ways.min() >= 20.0
    assert np.median(ways) < 45.0, "no farther than the path drifts by half of the least search"
    assert len(often.loops) > 1.5 * len(found.loops)


def test_the_layout_is_renewed_as_passes_come_in_that_do_not_confirm_it(
    graph: Graph, walls: Walls, monkeypatch: pytest.MonkeyPatch
) -> None:
    solving = Mock(wraps=solved)
    monkeypatch.setattr("specmap_cli.layout.passes.solved", solving)
    monkeypatch.setattr("specmap_cli.layout.passes._SOLVE_EVERY", 2)
    assert len(find_passes(graph, as_tracked(graph), walls).loops) >= 15
    solving.assert_not_called()
    aside = replace(as_tracked(graph), poses=graph.poses)
    aside.poses[graph.parts == 1, 1] += 0.25
    often = find_passes(graph, aside, walls)
    assert 0 < solving.call_count < 5, "the first bring the rest where it belongs"
    assert np.hypot(*(often.poses - graph.poses)[graph.parts == 1, :2].T).max() < 0.1
    with turned("layout.passes", _SOLVE_EVERY=10_000):
        assert np.array_equal(find_passes(graph, aside, walls).poses, aside.poses)


def test_a_part_that_a_guess_placed_is_no_place_to_look_from(graph: Graph, walls: Walls) -> None:
    alone = find_passes(graph, Draft(poses=graph.poses), walls)
    assert alone.tied == {0}
    assert all(edge.target < 480 for edge in alone.loops)


@pytest.mark.parametrize("at", [None, 560])
def test_a_search_on_the_way_finds_what_one_at_the_end_finds(
    drive: Drive, monkeypatch: pytest.MonkeyPatch, at: int | None
) -> None:
    """Also over a break of the tracking; the graph is made anew a few times only."""
    truth, scans = drive
    tracked = drifted(truth)
    breaks = {} if at is None else {at: Bridge(0.3, 0.05)}
    made: list[int] = []

    def counted(*given: Any) -> Graph:
        made.append(len(given[0]))
        return graph_of(*given)

    monkeypatch.setattr("specmap_cli.layout.passes.graph_of", counted)
    with KeyframeStore() as store:
        search = PassesOnTheWay(store)
        for scan in posed(tracked, scans):
            store.append(scan)
            search.go_on({k: bridge for k, bridge in breaks.items() if k < len(store)})
        on_the_way = len(made)
        graph, walls, found = search.ended(breaks, [33])
        assert 3 <= on_the_way <= 8
        assert made[-1] == len(truth)
        assert 33 in graph.nodes
        before = PassesOnTheWay(store).ended(breaks, [33])[2]
        assert np.array_equal(walls.sides(20).points, Walls(store, graph).sides(20).points)
        assert np.array_equal(walls.sides(20).normals, Walls(store, graph).sides(20).normals)
    assert all(0 <= older < newer for older, newer in found.matched)
    ours, theirs = ({(one.source, one.target) for one in each.loops} for each in (found, before))
    assert len(theirs) >= 15
    assert len(ours & theirs) > 0.7 * len(theirs)
    assert 0.8 < len(ours) / len(theirs) < 1.25
    laid = solved(graph, found).poses
    assert np.hypot(*(tracked - truth)[:, :2].T).max() > 1.5
    assert np.hypot(*(laid - truth[graph.nodes])[:, :2].T).max() < 0.35


def test_a_draft_is_carried_to_a_graph_with_more_nodes(graph: Graph) -> None:
    """What comes after a node that moved goes with it; pairs of rows are those of the keyframes."""
    few = Graph.of(graph.tracked, graph.nodes[:100:2], graph.odometry[:98:2])
    turned_by = np.array([1.0, 2.0, 0.5])
    guess = Pose2(0.1, 0.2, 0.3)
    draft = Draft(poses=compose(turned_by, few.poses), matched={(3, 40): guess})
    found = draft.carried(few, graph)
    assert np.allclose(found.poses, compose(turned_by, graph.poses))
    assert found.matched == {(6, 80): guess}
    assert found.loops == draft.loops


def ends_of(graph: Graph, one: Link) -> tuple[int, int]:
    return graph.row[one.source], graph.row[one.target]


@pytest.fixture(scope="module")
def aside(drive: Drive) -> Iterator[tuple[Graph, Walls]]:
    """The second lap put metres aside, by an error that is expected."""
    truth, scans = drive
    tracked = np.concatenate([truth[:450], compose(np.array([4.0, 0.0, 0.0]), truth[450:])])
    with stored(tracked, scans) as store:
        graph = graph_of(store, [], {})
        yield graph, Walls(store, graph)


def far(aside: tuple[Graph, Walls], draft: Draft, **constants: float) -> tuple[Link, ...]:
    """What is found far away, searched every few metres."""
    with turned("layout.passes", **{"_WIDE_EVERY_M": 4.0, **constants}):
        return far_passes(aside[0], draft, aside[1])


def test_what_lies_metres_away_is_found(drive: Drive, aside: tuple[Graph, Walls]) -> None:
    truth, graph = drive[0], aside[0]
    claims = far(aside, as_tracked(graph))
    late = [claim for claim in claims if claim.target > SECOND_LAP]
    assert len(late) >= 3
    for claim in late:
        assert missed(between(truth, claim.source, claim.target), claim.source_from_target)[0] < 0.2
    assert {claim.kind for claim in claims} == {"nearby"}
    assert min(away_m(graph, one) for one in late) > 3.0
    (alone,) = judge(graph, as_tracked(graph), late[:1])
    assert alone.reason == "alone", "one pass far away is not believed"


def test_nothing_is_found_where_the_path_cannot_have_drifted_from(
    aside: tuple[Graph, Walls],
) -> None:
    """What was seen since then lies where it lies: it would be found there."""
    graph, least_m = aside[0], 5.2
    claims = far(aside, as_tracked(graph), LOOP_SEARCH_MAX_M=least_m)
    older, newer = np.array([sorted(ends_of(graph, one)) for one in claims]).T
    drifted = path_error(graph, graph.poses).between(older, newer)
    assert min(PRIOR_SIGMAS * np.linalg.eigvalsh(drifted[:, :2, :2])[:, -1] ** 0.5) > least_m


def test_nothing_is_searched_where_it_need_not_be(aside: tuple[Graph, Walls]) -> None:
    graph = aside[0]
    # the near search reaches as far
    for constants in ({"LOOP_SEARCH_MAX_M": 99.0}, {"_WIDE_EVERY_M": 500.0}):
        assert far(aside, as_tracked(graph), **constants) == ()
    nodes = graph.nodes.tolist()
    tied = as_tracked(graph, *(link(nodes[0], node, (0.0, 0.0, 0.0)) for node in nodes[30:]))
    assert far(aside, tied) == ()
    assert far_passes(graph, as_tracked(graph), aside[1], len(nodes)) == ()
