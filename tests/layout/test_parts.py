"""Parts of the path moved to where links put them, or looked for among all older walls."""

from __future__ import annotations

import networkx as nx
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.geometry import FloatArray, compose, invert, wrap_angles
from specmap_cli.layout.path_graph import Draft, Graph, graph_of
from specmap_cli.layout.relaxation import close, most_voted, place_parts
from specmap_cli.layout.result import loose_starts
from specmap_cli.layout.walls import Walls
from tests.layout.driving import (
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


def test_a_part_is_moved_when_enough_finds_agree_and_not_by_one_alone() -> None:
    """The second lap was put metres away and turned; places along it say where it belongs."""
    truth = round_trip()[::2]
    with stored(moved_from(260, truth, AWAY), scans_of(building(), truth)) as store:
        graph = graph_of(store, [], {260: None})
        start, walls = Draft(poses=graph.poses), Walls(store, graph)
        draft, judged = close(graph, start, (), walls)
        with turned("layout.passes", _LOST_TRIES=0):
            still, one = close(graph, start, (), walls)
    finds = [each for each in judged if each.link.target >= 260]
    assert len(finds) >= 3
    assert {each.reason for each in finds} == {"votes"}
    assert draft.tied == {0, 1}
    assert worst(draft.poses, truth[graph.nodes]) < 0.3
    for find in (each.link for each in finds):
        assert missed(between(truth, find.source, find.target), find.source_from_target)[0] < 0.2
    assert [each.reason for each in one if each.link.target >= 260] == ["alone"]
    assert still.tied == {0}
