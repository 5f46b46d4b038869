"""Closures judged together, in large loops of which the truth is known; the largest clique."""

from __future__ import annotations

from dataclasses import replace

import networkx as nx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.geometry import FloatArray, compose, invert
from specmap_cli.layout.consistency import (
    _CLOSURE_VOTES,
    Judgement,
    Pairs,
    independent,
    judge,
    largest_clique,
)
from specmap_cli.layout.path_graph import Ends, Graph
from specmap_cli.layout.pose_graph import Link
from specmap_cli.layout.uncertainty import path_error
from tests.layout.driving import as_tracked, chained, graph_by_hand, link, true_link
from tests.strategies import seeds
from tests.turning import turned

STEP = np.diag([1 / 0.035**2, 1 / 0.035**2, 1 / 0.006**2])  # of a metre, by the default settings
SIDES_M = (60.0, 35.0)
LAP = int(2 * sum(SIDES_M))


def large_loop(laps: int = 4) -> FloatArray:
    """True poses 1 m apart around a block of corridors, 190 m a lap."""
    poses = [np.zeros(3)]
    for _ in range(laps):
        for side in (*SIDES_M, *SIDES_M):
            poses += [compose(poses[-1], np.array([k + 1.0, 0.0, 0.0])) for k in range(int(side))]
            poses[-1] = compose(poses[-1], np.array([0.0, 0.0, np.pi / 2]))
    return np.array(poses)


TRUTH = large_loop()


def tracked_by(seed: int) -> FloatArray:
    """The path of a front end that drifts by metres: 2 % too long, and it turns a little."""
    rng = np.random.default_rng(seed)
    steps = compose(invert(TRUTH[:-1]), TRUTH[1:])
    steps[:, :2] *= 1.02
    steps[:, :2] += rng.normal(0, 0.02, (len(steps), 2))
    steps[:, 2] += rng.normal(0, 0.005, len(steps)) + rng.normal(0, 0.0005)
    return chained(TRUTH[0], steps)


def graph_of_steps(tracked: FloatArray, breaks: tuple[int, ...] = ()) -> Graph:
    """The graph of a path whose steps are known as well as those of a front end."""
    graph = graph_by_hand(tracked, breaks)
    steps = tuple(replace(motion, information=STEP) for motion in graph.odometry)
    return replace(graph, odometry=steps)


def nearly(i: int, j: int, rng: np.random.Generator) -> Link:
    """A closure that is right to a decimetre and a degree."""
    off = rng.normal(0, 1, 3) * (0.1, 0.1, 0.01)
    motion = np.add(true_link(TRUTH, i, j).source_from_target, off)
    return link(i, j, motion.tolist(), "closure")


def killian(seed: int) -> tuple[Graph, list[Link], list[bool]]:
    """A long drive with eight right closures and three wrong ones that agree with nothing."""
    rng = np.random.default_rng(seed)
    at = [10 + 15 * k for k in range(8)]
    right = [nearly(i, i + LAP * (1 + k % 2), rng) for k, i in enumerate(at)]
    wrong = []
    for _ in range(3):
        i, j = sorted(rng.choice(len(TRUTH), 2, replace=False).tolist())
        x, y, theta = true_link(TRUTH, i, j).source_from_target
        away, bearing = rng.uniform(12, 39), rng.uniform(-np.pi, np.pi)
        motion = (x + away * np.cos(bearing), y + away * np.sin(bearing), theta)
        wrong.append(link(i, j, motion, "closure"))
    order = rng.permutation(11).tolist()
    closures = [[*right, *wrong][k] for k in order]
    return graph_of_steps(tracked_by(seed)), closures, [k < 8 for k in order]


def judged(graph: Graph, closures: list[Link]) -> tuple[Judgement, ...]:
    return judge(graph, as_tracked(graph), closures)[0]


@pytest.mark.parametrize("seed", range(6))
def test_eight_that_agree_win_and_three_that_agree_with_nothing_go(seed: int) -> None:
    graph, closures, right = killian(seed)
    found = judged(graph, closures)
    far = [one for one in found if one.believed]
    assert len(far) >= 7
    assert not any(one.believed and not r for one, r in zip(found, right, strict=True))
    assert max(one.away_m for one in far) > 3.0
    assert {one.reason for one in far} <= {"votes", "near"}
    assert min(one.votes for one in far if one.reason == "votes") >= _CLOSURE_VOTES
    assert judge(graph, as_tracked(graph), closures) == (found, 0)


def test_one_alone_must_stay_within_drift_and_two_are_not_several() -> None:
    graph, closures, right = killian(2)
    some = [c for c, r in zip(closures, right, strict=True) if r]
    for few in (some[:1], some[:2]):
        found = judged(graph, few)
        assert all(one.believed is (one.away_m <= one.allowed_m) for one in found)
        assert {one.votes for one in found} == {1}
    with turned("layout.uncertainty", _CLOSURE_DRIFT_SHARE=0.001, CLOSURE_SLACK_M=0.0):
        assert not any(one.believed for one in judged(graph, some[:2]))
        assert sum(one.believed for one in judged(graph, some)) >= 7


def test_the_same_place_seen_again_and_again_is_one_vote() -> None:
    rng, graph = np.random.default_rng(0), graph_of_steps(tracked_by(1))
    same = [nearly(20 + k, 20 + k + LAP, rng) for k in range(4)]
    along = [nearly(20 + 8 * k, 20 + 8 * k + LAP, rng) for k in range(4)]
    with turned("layout.uncertainty", _CLOSURE_DRIFT_SHARE=0.0, CLOSURE_SLACK_M=0.0):
        assert not any(one.believed for one in judged(graph, same))
        assert all(one.believed for one in judged(graph, along))


def compared(graph: Graph, closures: list[Link]) -> Pairs:
    ends = Ends.of(graph.row, closures)
    return Pairs.of(graph, graph.poses, ends, path_error(graph, graph.poses))


def test_look_alike_offices_agree_and_are_impossible() -> None:
    """Seven closures agree pair by pair, but the way between is too short to be off by 5 m."""
    graph = graph_of_steps(np.array([(k * 0.5, 0.0, 0.0) for k in range(80)]))
    twins = [link(10 * k, 10 * k + 10, (0.0, 0.0, 0.0), "closure") for k in range(7)]
    agreed, _ = largest_clique(compared(graph, twins).agree, 1000)
    assert agreed == tuple(range(7))
    assert independent(Ends.of(graph.row, twins), agreed, graph.path, 4.0) == 7
    assert [one.reason for one in judged(graph, twins)] == ["impossible"] * 7


def test_what_agrees_outvotes_what_drift_would_allow() -> None:
    rng, graph = np.random.default_rng(0), graph_of_steps(tracked_by(3))
    right = [nearly(10 + 20 * k, 10 + 20 * k + LAP, rng) for k in range(5)]
    x, y, theta = true_link(graph.tracked, 30, 30 + LAP).source_from_target
    wrong = link(30, 30 + LAP, (x + 6.0, y, theta), "closure")
    (alone,) = judged(graph, [wrong])
    assert (alone.believed, alone.reason) == (True, "drift")
    among = judged(graph, [*right, wrong])
    assert [one.believed for one in among] == [*[True] * 5, False]
    assert among[-1].reason == "outvoted"


def test_closures_of_other_parts_say_nothing_about_each_other() -> None:
    rng, graph = np.random.default_rng(0), graph_of_steps(TRUTH, breaks=(100, LAP + 100))
    agree = compared(graph, [nearly(k, k + LAP, rng) for k in (10, 50, 120, 160)]).agree
    assert np.array_equal(agree, np.kron(np.eye(2), 1 - np.eye(2)))


def test_a_closure_told_the_other_way_round_is_the_same() -> None:
    graph, closures, _ = killian(1)
    back = [
        link(c.target, c.source, tuple(c.source_from_target.inverse()), "closure") for c in closures
    ]
    there, turned_round = (
        [(one.reason, one.votes) for one in judged(graph, each)] for each in (closures, back)
    )
    assert there == turned_round


def test_independent_ones_are_counted_in_order() -> None:
    graph = graph_by_hand(np.array([(float(k), 0.0, 0.0) for k in range(100)]))
    links = [link(a, b, (0.0, 0.0, 0.0)) for a, b in ((0, 50), (3, 53), (3, 60), (20, 80))]
    ends = Ends.of(graph.row, links)
    assert independent(ends, [0, 1, 2, 3], graph.path, 5.0) == 3
    assert independent(ends, [], graph.path, 5.0) == 0


def test_what_the_layout_says_is_near_and_none_is_none() -> None:
    graph, _, _ = killian(0)
    assert judge(graph, as_tracked(graph), []) == ((), 0)
    assert judged(graph, [true_link(graph.tracked, 0, 300, "closure")])[0].reason == "near"


@given(st.integers(0, 18), st.floats(0, 1), seeds)
def test_the_clique_is_as_large_as_that_of_networkx(count: int, share: float, seed: int) -> None:
    graph = nx.gnp_random_graph(count, share, seed=seed % 2**32)
    adjacent = nx.to_numpy_array(graph, dtype=bool) if count else np.zeros((0, 0), dtype=bool)
    found, exact = largest_clique(adjacent, 100_000)
    assert exact
    assert len(found) == max((len(clique) for clique in nx.find_cliques(graph)), default=0)
    assert list(found) == sorted(set(found))
    assert all(adjacent[a, b] for a in found for b in found if a < b)
    assert largest_clique(adjacent, 100_000) == (found, exact)


def test_the_diagonal_does_not_count_and_of_equals_the_first_stays() -> None:
    for own in (False, True):
        adjacent = np.ones((4, 4), dtype=bool)
        np.fill_diagonal(adjacent, own)
        assert largest_clique(adjacent, 1000) == ((0, 1, 2, 3), True)
    pairs = nx.to_numpy_array(nx.Graph([(0, 1), (2, 3), (4, 5)]), dtype=bool)
    assert largest_clique(pairs, 1000) == ((0, 1), True)


def test_a_search_that_is_cut_short_says_so_and_is_still_a_clique() -> None:
    adjacent = nx.to_numpy_array(nx.gnp_random_graph(60, 0.7, seed=3), dtype=bool)
    hasty, exact = largest_clique(adjacent, 5)
    best, certain = largest_clique(adjacent, 100_000)
    assert (exact, certain) == (False, True)
    assert 2 < len(hasty) <= len(best)
    assert all(adjacent[a, b] for a in hasty for b in hasty if a < b)
