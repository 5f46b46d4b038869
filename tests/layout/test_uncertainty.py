"""Errors of steps added up along a path, and what of a closure drift explains."""

from __future__ import annotations

from dataclasses import replace

import networkx as nx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.geometry import FloatArray, Pose2, compose, invert
from specmap_cli.layout.path_graph import Bridge, Draft, Graph
from specmap_cli.layout.pose_graph import Link
from specmap_cli.layout.uncertainty import (
    CLOSURE_SLACK_M,
    Uncertainty,
    chain_lengths,
    deviations,
)
from tests.layout.driving import SOFT, arc, as_tracked, graph_by_hand, link, true_link
from tests.turning import turned


def gained(path: FloatArray, end: int, share: float, veer: float) -> FloatArray:
    """What errors that go on add to the covariance of a row seen from the first."""
    motions, i, j = graph_by_hand(path).odometry, np.array([0]), np.array([end])
    plain = Uncertainty.along(path, motions, 0.0).between(i, j)
    return np.asarray((Uncertainty.along(path, motions, share, veer).between(i, j) - plain)[0])


def sampled(path: FloatArray, i: int, j: int, runs: int = 4000) -> FloatArray:
    """Errors (runs, 3) of pose j seen from i, of paths whose steps err as SOFT says."""
    rng = np.random.default_rng(1)
    sigma = np.sqrt(np.diag(np.linalg.inv(SOFT))) / 5  # small, where the first order is enough
    steps = compose(invert(path[:-1]), path[1:])
    seen = np.tile(path[i], (runs, 1))
    for step in steps[i:j]:
        seen = compose(compose(seen, step), rng.normal(0, 1, (runs, 3)) * sigma)
    return compose(invert(compose(invert(path[i]), path[j])), compose(invert(path[i]), seen))


@pytest.mark.parametrize(("i", "j"), [(0, 39), (5, 6), (10, 30)])
def test_it_is_what_random_paths_come_to(i: int, j: int) -> None:
    path = arc(40)
    spread = Uncertainty.along(path, graph_by_hand(path).odometry, 0.0)
    expected = np.cov(sampled(path, i, j).T) * 25
    found = spread.between(np.array([i]), np.array([j]))[0]
    assert np.allclose(found, expected, rtol=0.1, atol=0.05 * np.abs(expected).max())


def test_the_way_back_is_known_as_well_and_a_place_from_itself_exactly() -> None:
    path = arc(40)
    spread = Uncertainty.along(path, graph_by_hand(path).odometry, 0.1)
    there = spread.between(np.array([3, 7]), np.array([30, 7]))
    back = spread.between(np.array([30]), np.array([3]))
    assert np.array_equal(there[1], np.zeros((3, 3)))
    assert there[0][2, 2] == pytest.approx(back[0][2, 2])


def test_errors_that_go_on_grow_with_the_way() -> None:
    """0.002 rad a metre over 10 m: the end, seen from the start, is half of 0.02 rad aside."""
    path = arc(40)
    place = (0.02 * np.hypot(*np.diff(path[:31, :2], axis=0).T).sum()) ** 2
    assert gained(path, 30, 0.02, 0.0) == pytest.approx(np.diag([place, place, 0.0]))
    assert np.diag(gained(arc(21, 0.0), 20, 0.0, 0.002)) == pytest.approx([0.01, 0.01, 0.0004])


def wrong_by(graph: Graph, source: int, target: int, metres: float) -> Link:
    """A closure that puts its target some metres from where the graph has it."""
    right = true_link(graph.tracked, source, target).source_from_target
    return link(source, target, right @ Pose2(metres, 0.0, 0.0), "closure")


def kinds_of(graph: Graph, draft: Draft, closures: list[Link]) -> list[str]:
    """Whether the layout says what each closure does, or drift explains the rest, or nothing."""
    return [
        "near" if away <= CLOSURE_SLACK_M else ("far" if away <= allowed else "refuted")
        for away, allowed in zip(*deviations(graph, draft, closures), strict=True)
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
    graph = graph_by_hand(arc(15), breaks)
    links = [link(a, b, (length, 0.0, 0.0)) for (a, b), length in loops if a != b]
    network = nx.empty_graph(15, create_using=nx.MultiGraph)
    for edge in (*(e for e in graph.odometry if e.kind == "odometry"), *links):
        length = max(edge.source_from_target.distance, 1e-3)
        network.add_edge(edge.source, edge.target, weight=length)
    lengths = dict(nx.all_pairs_dijkstra_path_length(network))
    expected = [lengths[a].get(b, np.inf) for a, b in closures]
    found = chain_lengths(graph, links, [link(a, b, (0.0, 0.0, 0.0)) for a, b in closures])
    assert found.tolist() == pytest.approx(expected)


@pytest.mark.parametrize(
    ("metres", "limits", "expected"),
    [
        (0.0, {}, "near"),
        (0.49, {}, "near"),
        (0.51, {}, "far"),
        (7.9, {}, "far"),
        (8.1, {}, "refuted"),
        (3.0, {"CLOSURE_SLACK_M": 3.5}, "near"),
        (3.0, {"_CLOSURE_DRIFT_SHARE": 0.04}, "refuted"),
        (3.0, {"DRIFT_SHARE": 10.0}, "far"),
    ],
)
def test_along_a_bare_path_drift_explains_much_as_the_limits_say(
    metres: float, limits: dict[str, float], expected: str
) -> None:
    """50 m between the ends: 0.5 m and 15 % of them."""
    graph = graph_by_hand(arc(101, 0.0))
    with turned("layout.uncertainty", **limits):
        assert kinds_of(graph, as_tracked(graph), [wrong_by(graph, 0, 100, metres)]) == [expected]


def test_where_a_pass_cuts_the_path_short_drift_explains_little() -> None:
    """A pass ties keyframe 90 to 2: from 0 to 100 it is 6 m over it, not 50 m."""
    graph = graph_by_hand(arc(101, 0.0))
    tied = as_tracked(graph, link(2, 90, (0.1, 0.0, 0.0)))
    closures = [wrong_by(graph, 0, 100, metres) for metres in (0.4, 0.7, 0.8)]
    assert kinds_of(graph, tied, closures) == ["near", "far", "refuted"]


def test_over_a_break_only_the_guess_may_be_off() -> None:
    """0.5 m and three times 0.3 m: farther, a part is moved as a whole, by several closures."""
    graph = graph_by_hand(arc(40), breaks=(20,))
    closures = [wrong_by(graph, *of) for of in ((0, 39, 1.3), (0, 39, 1.5), (25, 39, 5.0))]
    assert kinds_of(graph, as_tracked(graph), closures) == ["far", "refuted", "refuted"]


def test_a_bridge_lets_its_own_error_be_mended() -> None:
    """Ten metres of way allow 0.5 + 1.5 m, a bridge good to 0.4 m another 1.2 m."""
    graph = graph_by_hand(arc(21, 0.0))
    motions = list(graph.odometry)
    motions[9] = replace(motions[9], kind="bridge", information=Bridge(0.4, 0.1).information)
    bridged = replace(graph, odometry=tuple(motions))
    closures = [wrong_by(graph, 0, 20, metres) for metres in (1.9, 2.1, 3.1, 3.3)]
    assert kinds_of(graph, as_tracked(graph), closures) == ["far", *["refuted"] * 3]
    assert kinds_of(bridged, as_tracked(graph), closures) == [*["far"] * 3, "refuted"]
