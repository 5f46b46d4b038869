"""Parts of the path moved to where links put them, or looked for among all older walls."""

from __future__ import annotations

import networkx as nx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.geometry import FloatArray, compose, invert, wrap_angles
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.parts import (
    PartSearch,
    loose_starts,
    most_voted,
    place_part,
    place_parts,
    rejoin,
)
from specmap_cli.layout.path_graph import NODE_M, Draft, Graph, graph_of
from specmap_cli.layout.walls import Walls
from tests.layout.driving import (
    Laps,
    arc,
    between,
    building,
    graph_by_hand,
    link,
    missed,
    moved_from,
    round_trip,
    scans_of,
    stored,
    true_link,
    worst,
)
from tests.strategies import pose_arrays, seeds
from tests.turning import turned

AWAY = (3.0, -2.0, 0.9)  # where the second part was put by a guess


def kidnapped() -> tuple[FloatArray, Graph]:
    """True poses, and the graph of a robot that was lost at 20 and again at 40."""
    truth = arc(60)
    tracked = moved_from(40, moved_from(20, truth, AWAY), AWAY)
    return truth, graph_by_hand(tracked, breaks=(20, 40))


@given(pose_arrays(4), seeds)
def test_a_part_goes_where_links_put_it(poses: FloatArray, seed: int) -> None:
    draft = Draft(poses=poses)
    z = np.random.default_rng(seed).uniform(-3, 3, 3)
    there, back = link(1, 3, z.tolist()), link(3, 1, invert(z).tolist())
    placed = place_part(graph_by_hand(poses, breaks=(2,)), draft, 1, [there, back], votes=2)
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
    draft = place_parts(graph, [*wrong, *right], 2)
    assert np.allclose(draft.poses, truth, atol=1e-9)
    assert draft.tied == {0, 1, 2}
    assert draft.loops == (), "the closures themselves are judged later"


def test_links_that_agree_take_a_part_to_older_ones_and_along_what_hangs_on_it() -> None:
    truth, graph = kidnapped()
    draft = Draft(poses=graph.poses)
    links = [true_link(truth, *ends) for ends in ((21, 30), (25, 50), (5, 45))]
    assert place_part(graph, draft, 1, links, votes=1) is draft, "no link to an older part"
    assert place_part(graph, draft, 2, links, votes=1).tied == {0, 2}
    assert place_part(graph, draft, 2, links, votes=3) is draft
    finds = [true_link(truth, 0, 25), true_link(truth, 5, 35), link(1, 30, (9.0, 9.0, 1.0))]
    assert place_part(graph, draft, 1, finds, votes=3) is draft
    placed = place_part(graph, draft, 1, finds, votes=2)
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


def test_the_guess_is_a_vote_where_a_closure_agrees_with_it() -> None:
    truth = arc(40)
    graph = graph_by_hand(truth, breaks=(20,))
    (x, y, theta) = true_link(truth, 5, 30).source_from_target
    near, far = link(5, 30, (x + 0.2, y, theta)), link(5, 30, (x + 2.0, y, theta))
    tied = place_parts(graph, [near], 2)
    assert tied.tied == {0, 1}
    assert np.hypot(*(tied.poses - truth)[20:, :2].T) == pytest.approx(0.2)
    assert place_parts(graph, [far], 2).tied == {0}
    assert place_parts(graph, [], 1).tied == {0}, "the guess alone is none"


def search_along(
    store: KeyframeStore, graph: Graph, rows: list[int]
) -> tuple[Draft, PartSearch | None]:
    """The search for the part of some rows, one try at each, until it is found."""
    draft, search = Draft(poses=graph.poses), None
    walls = Walls(store, graph)
    for row in rows:
        draft, search = rejoin(row, graph, draft, walls, search)
        if int(graph.parts[row]) in draft.tied:
            break
    return draft, search


def test_a_part_is_moved_when_enough_finds_agree() -> None:
    """The second lap was put metres away and turned; three places along it say where it belongs."""
    truth = round_trip(1.25)[::2]
    kidnapped = moved_from(260, truth, AWAY)
    with stored(kidnapped, scans_of(building(), truth)) as store:
        graph = graph_of(store, [], {260: None})
        rows = np.flatnonzero(graph.parts == 1).tolist()[::4]
        draft, search = search_along(store, graph, rows)
        with turned("layout.parts", _PART_VOTES=1):
            hasty, first = search_along(store, graph, rows)
    assert search is not None
    assert draft.tied == {0, 1}
    assert len(search.finds) == 3
    assert draft.tries[1] >= 3
    assert worst(draft.poses, truth[graph.nodes]) < 0.3
    for find in search.finds:
        assert missed(between(truth, find.source, find.target), find.source_from_target)[0] < 0.2
    assert first is not None
    assert hasty.tied == {0, 1}
    assert len(first.finds) == 1


def test_a_part_is_given_up_and_the_finds_of_another_part_do_not_count(perfect: Laps) -> None:
    store, _ = perfect
    graph = graph_of(store, [], {480: None, 600: None})
    rows = np.flatnonzero(graph.parts >= 1).tolist()
    first, second = ([row for row in rows if graph.parts[row] == part] for part in (1, 2))
    with turned("layout.parts", PART_TRIES=2, _PART_VOTES=4):
        draft, search = search_along(store, graph, [*first[8:24:4], *second[8:24:4]])
    assert draft.tries == {1: 2, 2: 2}
    assert search is not None
    assert search.part == 2
    assert len(search.finds) == 2, "two of each part, and none of the part before"
    assert draft.tied == {0}
    assert np.array_equal(draft.poses, graph.poses)
    with turned("layout.parts", PART_TRIES=0):
        never, nothing = search_along(store, graph, first[:4])
    assert nothing is None
    assert never.tries == {}


def test_the_more_tries_fail_the_farther_apart_they_are(perfect: Laps) -> None:
    store, _ = perfect
    graph = graph_of(store, [], {480: None})
    rows = np.flatnonzero(graph.parts == 1).tolist()
    draft, search, at = Draft(poses=graph.poses), None, []
    walls = Walls(store, graph)
    for row in rows:
        before = draft.tries.get(1, 0)
        with (
            turned("layout.path_graph", LOOP_EVERY_M=0.6),
            turned("layout.parts", PART_TRIES=4, _PART_VOTES=9),
        ):
            draft, search = rejoin(row, graph, draft, walls, search)
        if draft.tries[1] > before:
            at.append(float(graph.path[row] - graph.path[rows[0]]))
    due = [0.6 * tries * (1.0 + tries / 20) for tries in range(4)]
    assert len(at) == 4
    assert all(0.0 <= way - least <= NODE_M + 0.2 for way, least in zip(at, due, strict=True))
