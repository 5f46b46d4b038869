"""Closures sorted by what drift explains; chains of links against networkx."""

from __future__ import annotations

from dataclasses import replace

import networkx as nx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.geometry import FloatArray, Pose2, compose
from specmap_cli.layout.drift import CLOSURE_SLACK_M, chain_lengths, deviations
from specmap_cli.layout.motion_edges import Bridge
from specmap_cli.layout.path_graph import Draft, Graph
from specmap_cli.layout.pose_graph import Link
from tests.layout.driving import as_tracked, graph_by_hand, link, network_of, true_link
from tests.strategies import poses
from tests.turning import turned


def track(count: int, turn: float = 0.02) -> FloatArray:
    """Poses half a metre apart along a wide arc."""
    places = np.zeros((count, 3))
    for k in range(1, count):
        places[k] = compose(places[k - 1], np.array([0.5, 0.0, turn]))
    return places


def wrong_by(graph: Graph, source: int, target: int, metres: float) -> Link:
    """A closure that puts its target some metres from where the graph has it."""
    right = true_link(graph.tracked, source, target).source_from_target
    return link(source, target, right @ Pose2(metres, 0.0, 0.0), "closure")


def kinds_of(graph: Graph, draft: Draft, closures: list[Link]) -> list[str]:
    """Whether the layout says what each closure does, or drift explains the rest, or nothing."""
    found = deviations(graph, draft, closures)
    return [
        "near" if away <= CLOSURE_SLACK_M else ("far" if away <= allowed else "refuted")
        for away, allowed in zip(found.away_m, found.allowed_m, strict=True)
    ]


ENDS = st.tuples(st.integers(0, 14), st.integers(0, 14))


@given(
    st.lists(st.tuples(ENDS, st.floats(0, 20)), max_size=10),
    st.lists(ENDS, max_size=4),
    st.sets(st.integers(1, 14), max_size=3),
)
def test_chains_are_the_shortest_paths_of_networkx(
    loops: list[tuple[tuple[int, int], float]], closures: list[tuple[int, int]], breaks: set[int]
) -> None:
    """Also where edges are parallel, there and back, and where a break leaves no chain."""
    graph = graph_by_hand(track(15), breaks)
    links = [link(a, b, (length, 0.0, 0.0)) for (a, b), length in loops if a != b]
    network = network_of([*(e for e in graph.odometry if e.kind == "odometry"), *links])
    network.add_nodes_from(range(15))
    expected = [
        nx.shortest_path_length(network, a, b, weight="weight")
        if nx.has_path(network, a, b)
        else np.inf
        for a, b in closures
    ]
    found = chain_lengths(graph, links, [link(a, b, (0.0, 0.0, 0.0)) for a, b in closures])
    assert found.tolist() == pytest.approx(expected)


def test_the_shorter_of_two_parallel_links_counts() -> None:
    graph = graph_by_hand(track(20))
    long, short = link(0, 19, (6.0, 0.0, 0.0)), link(0, 19, (2.0, 0.0, 0.0))
    closure = link(0, 19, (0.0, 0.0, 0.0))
    for loops in ([long, short], [short, long]):
        assert chain_lengths(graph, loops, [closure]).tolist() == [2.0]


@pytest.mark.parametrize(
    ("metres", "expected"),
    [(0.0, "near"), (0.49, "near"), (0.51, "far"), (7.9, "far"), (8.1, "refuted")],
)
def test_along_a_bare_path_drift_explains_much(metres: float, expected: str) -> None:
    """50 m between the ends: 0.5 m and 15 % of them."""
    graph = graph_by_hand(track(101, 0.0))
    closures = [wrong_by(graph, 0, 100, metres)]
    assert kinds_of(graph, as_tracked(graph), closures) == [expected]


def test_where_a_pass_cuts_the_path_short_drift_explains_little() -> None:
    """A pass ties keyframe 90 to 2: from 0 to 100 it is 6 m over it, not 50 m."""
    graph = graph_by_hand(track(101, 0.0))
    tied = as_tracked(graph, link(2, 90, (0.1, 0.0, 0.0)))
    closures = [wrong_by(graph, 0, 100, metres) for metres in (0.4, 0.7, 0.8)]
    assert kinds_of(graph, tied, closures) == ["near", "far", "refuted"]


def test_the_limits_are_set() -> None:
    graph = graph_by_hand(track(101, 0.0))
    closures = [wrong_by(graph, 0, 100, 3.0)]
    for home, limit, expected in (
        ("drift", {"CLOSURE_SLACK_M": 3.5}, "near"),
        ("drift", {"_CLOSURE_DRIFT_SHARE": 0.04}, "refuted"),
        ("uncertainty", {"DRIFT_SHARE": 10.0}, "far"),
    ):
        with turned(f"layout.{home}", **limit):
            assert kinds_of(graph, as_tracked(graph), closures) == [expected]


def test_over_a_break_only_the_guess_may_be_off() -> None:
    """0.5 m and three times 0.3 m: farther, a part is moved as a whole, by several closures."""
    graph = graph_by_hand(track(40), breaks=(20,))
    closures = [
        wrong_by(graph, 0, 39, 1.3),
        wrong_by(graph, 0, 39, 1.5),
        wrong_by(graph, 25, 39, 5),
    ]
    assert kinds_of(graph, as_tracked(graph), closures) == ["far", "refuted", "refuted"]


def test_a_bridge_lets_its_own_error_be_mended() -> None:
    """Ten metres of way allow 0.5 + 1.5 m, a bridge good to 0.4 m another 1.2 m."""
    graph = graph_by_hand(track(21, 0.0))
    bridge = Bridge(0.4, 0.1)
    motions = list(graph.odometry)
    motions[9] = replace(motions[9], kind="bridge", information=bridge.information)
    bridged = replace(graph, odometry=tuple(motions))
    closures = [wrong_by(graph, 0, 20, metres) for metres in (1.9, 2.1, 3.1, 3.3)]
    assert kinds_of(graph, as_tracked(graph), closures) == ["far", *["refuted"] * 3]
    assert kinds_of(bridged, as_tracked(graph), closures) == [*["far"] * 3, "refuted"]


def test_without_closures_there_is_nothing_to_say() -> None:
    graph = graph_by_hand(track(60))
    found = deviations(graph, as_tracked(graph), [])
    assert found.away_m.shape == found.allowed_m.shape == (0,)


# never at a limit, where rounding decides
AWAY_M = st.integers(-40, 40).map(lambda tenths: tenths / 10 + 0.0123)


@given(poses, st.lists(st.tuples(ENDS, AWAY_M), max_size=6))
def test_the_frame_of_the_map_does_not_matter(
    motion: Pose2, ends: list[tuple[tuple[int, int], float]]
) -> None:
    plain, moved = (graph_by_hand(t) for t in (track(15), compose(np.array(motion), track(15))))
    closures = [wrong_by(plain, a, b, metres) for (a, b), metres in ends if a != b]
    kinds = [kinds_of(graph, as_tracked(graph), closures) for graph in (plain, moved)]
    assert kinds[0] == kinds[1]
