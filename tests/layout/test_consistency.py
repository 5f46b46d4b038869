"""Closures judged together, in large loops of which the truth is known; the largest clique."""

from dataclasses import replace

import networkx as nx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.geometry import FloatArray, Pose2, compose, invert
from specmap_cli.core.records import BoolArray
from specmap_cli.layout.consistency import (
    Judgement,
    Uncertainty,
    _votes,
    independent,
    judge,
    pairs_of,
    path_error,
)
from specmap_cli.layout.path_graph import Ends, Graph, settle, tighten
from specmap_cli.layout.pose_graph import Link
from tests.layout.driving import (
    SOFT,
    arc,
    as_tracked,
    away_m,
    chained,
    closure,
    graph_by_hand,
    link,
)
from tests.strategies import seeds
from tests.turning import turned

STEP = np.diag([1 / 0.035**2, 1 / 0.035**2, 1 / 0.006**2])  # of a metre, by the default settings
ALONE = {"_ALONE_SIGMAS": 0.0, "_ALONE_SHARE": 0.0}  # one alone may mend nothing
SIDES_M = (60.0, 35.0)
LAP = int(2 * sum(SIDES_M))


def large_loop() -> FloatArray:
    """True poses 1 m apart around a block of corridors, four laps of 190 m."""
    poses = [np.zeros(3)]
    for side in SIDES_M * 8:
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
    return closure(TRUTH, i, j, Pose2(*rng.normal(0, (0.1, 0.1, 0.01)).tolist()))


def killian(seed: int) -> tuple[Graph, list[Link], list[bool]]:
    """A long drive with eight right closures and three wrong ones that agree with nothing."""
    rng = np.random.default_rng(seed)
    at = [10 + 15 * k for k in range(8)]
    right = [nearly(i, i + LAP * (1 + k % 2), rng) for k, i in enumerate(at)]
    wrong = []
    for _ in range(3):
        i, j = sorted(rng.choice(len(TRUTH), 2, replace=False).tolist())
        away, bearing = rng.uniform(12, 39), rng.uniform(-np.pi, np.pi)
        off = Pose2(away * np.cos(bearing), away * np.sin(bearing), 0.0)
        wrong.append(closure(TRUTH, i, j, off))
    order = rng.permutation(11).tolist()
    closures = [[*right, *wrong][k] for k in order]
    return graph_of_steps(tracked_by(seed)), closures, [k < 8 for k in order]


def judged(graph: Graph, closures: list[Link]) -> tuple[Judgement, ...]:
    return judge(graph, as_tracked(graph), closures)


@pytest.mark.parametrize("seed", range(6))
def test_eight_that_agree_win_and_three_that_agree_with_nothing_go(seed: int) -> None:
    graph, closures, right = killian(seed)
    found = judged(graph, closures)
    far = [one for one in found if one.believed]
    assert len(far) >= 7
    wrong = [one for one, r in zip(found, right, strict=True) if one.believed and not r]
    assert {one.reason for one in wrong} <= {"drift"}, "the path may err by so much"
    believed = as_tracked(graph).adding([one.link for one in far])
    kept = settle(graph, tighten(graph, believed))[0].loops
    assert len(kept) >= 7
    assert not {one.link for one in wrong} & set(kept), "the solution leaves it out"
    assert max(away_m(graph, one.link) for one in far) > 3.0
    assert {one.reason for one in far} <= {"votes", "near", "drift"}
    assert judged(graph, closures) == found


def test_one_alone_is_what_the_path_errs_by_and_two_are_not_several() -> None:
    graph, closures, right = killian(2)
    some = [c for c, r in zip(closures, right, strict=True) if r]
    for few in (some[:1], some[:2]):
        assert {one.reason for one in judged(graph, few)} == {"drift"}
    turning = closure(TRUTH, some[0].source, some[0].target, Pose2(0.0, 0.0, 1.5))
    assert judged(graph, [turning])[0].reason == "impossible"
    with turned("layout.consistency", **ALONE, CLAIM_SLACK_M=0.0):
        assert not any(one.believed for one in judged(graph, some[:2]))
        assert sum(one.believed for one in judged(graph, some)) >= 7


def test_the_same_place_seen_again_and_again_is_one_vote() -> None:
    rng, graph = np.random.default_rng(0), graph_of_steps(tracked_by(1))
    same = [nearly(20 + k, 20 + k + LAP, rng) for k in range(4)]
    along = [nearly(20 + 8 * k, 20 + 8 * k + LAP, rng) for k in range(4)]
    with turned("layout.consistency", **ALONE, CLAIM_SLACK_M=0.0):
        assert not any(one.believed for one in judged(graph, same))
        assert all(one.believed for one in judged(graph, along))


def compared(graph: Graph, closures: list[Link]) -> tuple[BoolArray, FloatArray]:
    ends = Ends.of(graph.row, closures)
    return pairs_of(graph, graph.poses, ends, path_error(graph, graph.poses))


def test_look_alike_offices_agree_and_are_impossible() -> None:
    """Seven closures agree pair by pair, but the way between is too short to be off by 5 m."""
    graph = graph_of_steps(np.array([(k * 0.5, 0.0, 0.0) for k in range(80)]))
    twins = [link(10 * k, 10 * k + 10, (0.0, 0.0, 0.0), "closure") for k in range(7)]
    assert compared(graph, twins)[0].all()
    assert independent(Ends.of(graph.row, twins), range(7), graph.path, 4.0) == 7
    assert [one.reason for one in judged(graph, twins)] == ["impossible"] * 7


def test_what_agrees_outvotes_what_drift_would_allow() -> None:
    rng, graph = np.random.default_rng(0), graph_of_steps(tracked_by(3))
    right = [nearly(10 + 20 * k, 10 + 20 * k + LAP, rng) for k in range(5)]
    wrong = closure(graph.tracked, 30, 30 + LAP, Pose2(6.0, 0.0, 0.0))
    (alone,) = judged(graph, [wrong])
    assert (alone.believed, alone.reason) == (True, "drift")
    among = judged(graph, [*right, wrong])
    assert [one.believed for one in among] == [*[True] * 5, False]
    assert among[-1].reason == "outvoted"


def test_closures_of_other_parts_say_nothing_about_each_other() -> None:
    rng, graph = np.random.default_rng(0), graph_of_steps(TRUTH, breaks=(100, LAP + 100))
    agree, told_m = compared(graph, [nearly(k, k + LAP, rng) for k in (10, 50, 120, 160)])
    assert np.array_equal(agree, np.kron(np.eye(2), np.ones((2, 2))))
    assert np.array_equal(np.isfinite(told_m), agree & ~np.eye(4, dtype=bool))


def test_a_closure_told_the_other_way_round_is_the_same() -> None:
    graph, closures, _ = killian(1)
    back = [link(c.target, c.source, c.source_from_target.inverse(), "closure") for c in closures]
    for one, other in zip(judged(graph, closures), judged(graph, back), strict=True):
        assert one.reason == other.reason
    assert np.array_equal(compared(graph, closures)[0], compared(graph, back)[0])


def test_independent_ones_are_counted_in_order() -> None:
    graph = graph_by_hand(np.array([(float(k), 0.0, 0.0) for k in range(100)]))
    links = [link(a, b, (0.0, 0.0, 0.0)) for a, b in ((0, 50), (3, 53), (3, 60), (20, 80))]
    ends = Ends.of(graph.row, links)
    assert independent(ends, [0, 1, 2, 3], graph.path, 5.0) == 3
    assert independent(ends, [], graph.path, 5.0) == 0


def test_what_the_layout_says_is_near_and_none_is_none() -> None:
    graph, _, _ = killian(0)
    assert judge(graph, as_tracked(graph), []) == ()
    assert judged(graph, [closure(graph.tracked, 0, 300)])[0].reason == "near"


@given(st.integers(1, 18), st.floats(0, 1), seeds)
def test_votes_are_of_a_set_in_which_all_agree(count: int, share: float, seed: int) -> None:
    """Of claims far apart on the path each is a vote; the most agreed on is in no smaller set."""
    network = nx.gnp_random_graph(count, share, seed=seed % 2**32)
    agree = nx.to_numpy_array(network, dtype=bool) | np.eye(count, dtype=bool)
    graph = graph_by_hand(np.array([(10.0 * k, 0.0, 0.0) for k in range(2 * count)]))
    ends = Ends.of(graph.row, [link(k, count + k, (0.0, 0.0, 0.0)) for k in range(count)])
    possible = np.random.default_rng(seed % 2**32).random(count) < 0.8
    votes = _votes(graph, ends, agree, agree, possible)
    assert (votes[~possible] == 1).all()
    cliques = [set(clique) for clique in nx.find_cliques(network)]
    for number, found in enumerate(votes.tolist()):
        assert any(number in clique and len(clique) >= found for clique in cliques)
    if share == 1.0:
        assert (votes[possible] == possible.sum()).all()


def gained(path: FloatArray, end: int, share: float, veer: float) -> FloatArray:
    """What errors that go on add to the covariance of a row seen from the first."""
    motions, i, j = graph_by_hand(path).odometry, np.array([0]), np.array([end])
    plain = Uncertainty.along(path, motions, 0.0).between(i, j)
    return np.asarray((Uncertainty.along(path, motions, share, veer).between(i, j) - plain)[0])


def sampled(path: FloatArray, i: int, j: int) -> FloatArray:
    """Errors (4000, 3) of pose j seen from i, of paths whose steps err as SOFT says."""
    rng = np.random.default_rng(1)
    sigma = np.sqrt(np.diag(np.linalg.inv(SOFT))) / 5  # small, where the first order is enough
    steps = compose(invert(path[:-1]), path[1:])
    seen = np.tile(path[i], (4000, 1))
    for step in steps[i:j]:
        seen = compose(compose(seen, step), rng.normal(0, 1, (4000, 3)) * sigma)
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
