"""Closures judged together, in large loops of which the truth is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from specmap_cli.core.geometry import FloatArray, compose, invert
from specmap_cli.layout.agreement import Ends, Pairs, independent, largest_agreement, pairs_of
from specmap_cli.layout.judging import _CLOSURE_VOTES, Judgement, judge, spread_of
from specmap_cli.layout.path_graph import Graph
from specmap_cli.layout.pose_graph import Link
from tests.layout.driving import as_tracked, graph_by_hand, link, true_link
from tests.turning import turned

STEP = np.diag([1 / 0.035**2, 1 / 0.035**2, 1 / 0.006**2])  # of a metre, by the default settings
SIDES_M = (60.0, 35.0)


def large_loop(laps: int = 4) -> FloatArray:
    """True poses 1 m apart around a block of corridors, 190 m a lap."""
    poses = [np.zeros(3)]
    for _ in range(laps):
        for side in (*SIDES_M, *SIDES_M):
            poses += [compose(poses[-1], np.array([k + 1.0, 0.0, 0.0])) for k in range(int(side))]
            poses[-1] = compose(poses[-1], np.array([0.0, 0.0, np.pi / 2]))
    return np.array(poses)


def tracked_by(truth: FloatArray, seed: int) -> FloatArray:
    """The path of a front end that drifts by metres: 2 % too long, and it turns a little."""
    rng = np.random.default_rng(seed)
    steps = compose(invert(truth[:-1]), truth[1:])
    steps[:, :2] *= 1.02
    steps[:, :2] += rng.normal(0, 0.02, (len(steps), 2))
    steps[:, 2] += rng.normal(0, 0.005, len(steps)) + rng.normal(0, 0.0005)
    poses = [truth[0]]
    for step in steps:
        poses.append(compose(poses[-1], step))
    return np.array(poses)


def graph_of_steps(tracked: FloatArray, breaks: tuple[int, ...] = ()) -> Graph:
    """The graph of a path whose steps are known as well as those of a front end."""
    graph = graph_by_hand(tracked, breaks)
    steps = tuple(replace(motion, information=STEP) for motion in graph.odometry)
    return replace(graph, odometry=steps)


def nearly(truth: FloatArray, i: int, j: int, rng: np.random.Generator) -> Link:
    """A closure that is right to a decimetre and a degree."""
    x, y, theta = true_link(truth, i, j).source_from_target
    off = rng.normal(0, 1, 3) * (0.1, 0.1, 0.01)
    return link(i, j, (x + off[0], y + off[1], theta + off[2]), "closure")


def killian(seed: int) -> tuple[FloatArray, Graph, list[Link], list[bool]]:
    """A long drive with eight right closures and three wrong ones that agree with nothing."""
    truth, rng = large_loop(), np.random.default_rng(seed)
    lap = int(2 * sum(SIDES_M))
    right = [
        nearly(truth, 10 + 15 * k, 10 + 15 * k + lap * (2 if k % 2 else 1), rng) for k in range(8)
    ]
    wrong = []
    for _ in range(3):
        i, j = sorted(rng.choice(len(truth), 2, replace=False).tolist())
        x, y, theta = true_link(truth, i, j).source_from_target
        away, bearing = rng.uniform(12, 39), rng.uniform(-np.pi, np.pi)
        motion = (x + away * np.cos(bearing), y + away * np.sin(bearing), theta)
        wrong.append(link(i, j, motion, "closure"))
    order = rng.permutation(11)
    closures = [[*right, *wrong][k] for k in order]
    return truth, graph_of_steps(tracked_by(truth, seed)), closures, [bool(k < 8) for k in order]


def judged(graph: Graph, closures: list[Link]) -> Judgement:
    return judge(graph, as_tracked(graph), closures)


@pytest.mark.parametrize("seed", range(6))
def test_eight_that_agree_win_and_three_that_agree_with_nothing_go(seed: int) -> None:
    _, graph, closures, right = killian(seed)
    found = judged(graph, closures)
    believed = [one.believed for one in found.closures]
    assert sum(b for b, r in zip(believed, right, strict=True) if r) >= 7
    assert not any(b for b, r in zip(believed, right, strict=True) if not r)
    far = [one for one, r in zip(found.closures, right, strict=True) if r and one.believed]
    assert max(one.away_m for one in far) > 3.0
    assert {one.reason for one in far} <= {"agreement", "near"}
    assert min(one.votes for one in far if one.reason == "agreement") >= _CLOSURE_VOTES
    assert judged(graph, closures) == found


def test_one_alone_must_stay_within_drift_and_two_are_not_several() -> None:
    _, graph, closures, right = killian(2)
    some = [c for c, r in zip(closures, right, strict=True) if r]
    for few in (some[:1], some[:2]):
        verdicts = judged(graph, few).closures
        assert all(one.believed is (one.away_m <= one.allowed_m) for one in verdicts)
        assert {one.votes for one in verdicts} == {1}
    with turned("layout.drift", _CLOSURE_DRIFT_SHARE=0.001, CLOSURE_SLACK_M=0.0):
        assert not any(one.believed for one in judged(graph, some[:2]).closures)
        assert sum(one.believed for one in judged(graph, some).closures) >= 7


def test_the_same_place_seen_again_and_again_is_one_evidence() -> None:
    truth, rng = large_loop(), np.random.default_rng(0)
    graph, lap = graph_of_steps(tracked_by(truth, 1)), int(2 * sum(SIDES_M))
    same = [nearly(truth, 20 + k, 20 + k + lap, rng) for k in range(4)]
    along = [nearly(truth, 20 + 8 * k, 20 + 8 * k + lap, rng) for k in range(4)]
    with turned("layout.drift", _CLOSURE_DRIFT_SHARE=0.0, CLOSURE_SLACK_M=0.0):
        assert not any(one.believed for one in judged(graph, same).closures)
        assert all(one.believed for one in judged(graph, along).closures)


def compared(graph: Graph, closures: list[Link]) -> Pairs:
    spread = spread_of(graph, as_tracked(graph))
    return pairs_of(graph, graph.poses, Ends.of(graph, closures), spread)


def offices(count: int = 8) -> tuple[Graph, list[Link]]:
    """A corridor of offices 5 m apart that look alike, and closures from each to the next."""
    truth = np.array([(k * 0.5, 0.0, 0.0) for k in range(10 * count)])
    twins = [link(10 * k, 10 * k + 10, (0.0, 0.0, 0.0), "closure") for k in range(count - 1)]
    return graph_of_steps(truth), twins


def test_look_alike_offices_agree_and_are_impossible() -> None:
    """Seven closures agree pair by pair, but the way between is too short to be off by 5 m."""
    graph, twins = offices()
    agreed = largest_agreement(compared(graph, twins))
    assert agreed.members == tuple(range(7))
    assert independent(Ends.of(graph, twins), agreed.members, graph.path, 4.0) == 7
    verdicts = judged(graph, twins).closures
    assert [one.reason for one in verdicts] == ["impossible"] * 7


def test_what_agrees_outvotes_what_drift_would_allow() -> None:
    truth, rng = large_loop(), np.random.default_rng(0)
    graph, lap = graph_of_steps(tracked_by(truth, 3)), int(2 * sum(SIDES_M))
    right = [nearly(truth, 10 + 20 * k, 10 + 20 * k + lap, rng) for k in range(5)]
    x, y, theta = true_link(graph.tracked, 30, 30 + lap).source_from_target
    wrong = link(30, 30 + lap, (x + 6.0, y, theta), "closure")
    alone = judged(graph, [wrong]).closures[0]
    assert (alone.believed, alone.reason) == (True, "drift")
    among = judged(graph, [*right, wrong]).closures
    assert [one.believed for one in among] == [*[True] * 5, False]
    assert among[-1].reason == "outvoted"


def test_closures_of_other_parts_say_nothing_about_each_other() -> None:
    truth, rng = large_loop(), np.random.default_rng(0)
    lap = int(2 * sum(SIDES_M))
    graph = graph_of_steps(truth, breaks=(100, lap + 100))
    closures = [nearly(truth, k, k + lap, rng) for k in (10, 50, 120, 160)]
    agree = compared(graph, closures).agree
    assert agree[0, 1]
    assert agree[2, 3]
    assert not agree[:2, 2:].any()
    assert not agree.diagonal().any()


def test_a_closure_told_the_other_way_round_is_the_same() -> None:
    _, graph, closures, _ = killian(1)
    back = [
        link(c.target, c.source, tuple(c.source_from_target.inverse()), "closure") for c in closures
    ]
    there, turned = judged(graph, closures), judged(graph, back)
    assert [one.believed for one in there.closures] == [one.believed for one in turned.closures]
    assert [one.votes for one in there.closures] == [one.votes for one in turned.closures]


def test_independent_ones_are_counted_in_order() -> None:
    graph = graph_by_hand(np.array([(float(k), 0.0, 0.0) for k in range(100)]))
    links = [link(a, b, (0.0, 0.0, 0.0)) for a, b in ((0, 50), (3, 53), (3, 60), (20, 80))]
    ends = Ends.of(graph, links)
    assert independent(ends, [0, 1, 2, 3], graph.path, 5.0) == 3
    assert independent(ends, [], graph.path, 5.0) == 0


def test_what_the_layout_says_is_near_and_none_is_none() -> None:
    _, graph, closures, _ = killian(0)
    assert judged(graph, closures).cut_short == 0
    assert judged(graph, []) == Judgement((), 0)
    assert judged(graph, [true_link(graph.tracked, 0, 300, "closure")]).closures[0].reason == "near"
