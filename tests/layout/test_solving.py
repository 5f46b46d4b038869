"""Drafts solved: outliers dropped, closures over any drift, steps that are limited."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.geometry import FloatArray, compose, invert
from specmap_cli.core.settings import RelaxationConfig
from specmap_cli.layout.path_graph import Graph
from specmap_cli.layout.pose_graph import Link, LinkArrays, solve
from specmap_cli.layout.solving import _KERNEL_SIGMAS, renewed, settle, solved, tighten
from tests.layout.driving import as_tracked, drifted, graph_by_hand, link, true_link
from tests.strategies import few
from tests.turning import turned

CONFIG = RelaxationConfig()
LAP = 60


def ring(laps: int = 2) -> FloatArray:
    """True poses half a metre apart around a circle."""
    truth = np.zeros((laps * LAP, 3))
    for k in range(1, len(truth)):
        truth[k] = compose(truth[k - 1], np.array([0.5, 0.0, 2 * np.pi / LAP]))
    return truth


def driven(bias: float = 0.002) -> tuple[FloatArray, Graph]:
    """True poses, and the graph of a robot that turned a little too far at each step."""
    truth = ring()
    return truth, graph_by_hand(drifted(truth, bias))


def rightly(truth: FloatArray, *starts: int) -> tuple[Link, ...]:
    """Passes from the first lap to the second, as they are."""
    return tuple(true_link(truth, k, k + LAP) for k in starts)


def off(poses: FloatArray, truth: FloatArray, every: int) -> float:
    """Largest error of where the second lap lies, seen from every so many places of the first."""
    gaps = compose(invert(poses[:LAP:every]), poses[LAP::every])
    true = compose(invert(truth[:LAP:every]), truth[LAP::every])
    return float(np.hypot(*(gaps - true)[:, :2].T).max())


def test_loops_pull_the_laps_together() -> None:
    truth, graph = driven()
    draft = as_tracked(graph, *rightly(truth, 0, 15, 30, 45))
    assert off(draft.poses, truth, 15) > 0.4
    after = solved(graph, draft)
    assert off(after.poses, truth, 15) < 0.04
    assert np.array_equal(draft.poses, graph.poses), "the draft before is as it was"
    assert after.loops == draft.loops


@few(10)
@given(st.integers(0, LAP - 1), st.floats(1.5, 20), st.floats(-3, 3))
def test_a_dropped_outlier_leaves_the_others_alone(at: int, away: float, turn: float) -> None:
    truth, graph = driven()
    right, wrong = rightly(truth, 0, 15, 30, 45), link(at, at + 50, (away, away, turn))
    with_wrong, dropped = settle(graph, as_tracked(graph, *right, wrong))
    without, none = settle(graph, as_tracked(graph, *right))
    assert dropped == (wrong,)
    assert none == ()
    assert with_wrong.loops == without.loops == right
    assert np.allclose(with_wrong.poses[:, :2], without.poses[:, :2], atol=0.02)


def test_what_is_dropped_is_told_in_order_and_motions_stay() -> None:
    truth, graph = driven()
    right = rightly(truth, 0, 15, 30, 45)
    first, second = link(5, 70, (30.0, 0.0, 0.0)), link(9, 80, (0.0, -40.0, 0.0))
    draft, dropped = settle(graph, as_tracked(graph, first, *right, second))
    assert dropped == (first, second)
    assert draft.loops == right
    alone, nothing = settle(graph, as_tracked(graph))
    assert nothing == ()
    assert np.allclose(alone.poses, graph.poses)


def test_what_counts_as_an_outlier_is_set() -> None:
    truth, graph = driven(bias=0.0)
    x, y, theta = true_link(truth, 0, LAP).source_from_target
    doubtful = link(0, LAP, (x + 0.16, y, theta))  # four sigmas off
    loops = (*rightly(truth, *range(20)), doubtful)
    for limit, expected in ((25.0, ()), (4.0, (doubtful,))):
        with turned("layout.solving", _OUTLIER_CHI2=limit):
            assert settle(graph, as_tracked(graph, *loops))[1] == expected


def test_closures_that_agree_win_over_any_drift() -> None:
    """Metres off, each of them is an outlier to begin with; together they outvote the wrong one."""
    truth, graph = driven(0.02)
    wrong = link(3, 100, (6.0, 5.0, 1.0), "closure")
    right = rightly(truth, 0, 10, 20, 30, 40, 50)
    start = as_tracked(graph, *right, wrong)
    assert off(start.poses, truth, 10) > 2.0
    assert len(settle(graph, start)[1]) == 7, "none is believed as it is"
    draft, dropped = settle(graph, tighten(graph, start))
    assert dropped == (wrong,)
    assert off(draft.poses, truth, 10) < 0.1


def test_without_loops_there_is_nothing_to_tighten() -> None:
    _, graph = driven()
    assert np.allclose(tighten(graph, as_tracked(graph)).poses, graph.poses)


def test_solutions_that_were_cut_short_are_counted() -> None:
    truth, graph = driven(0.02)
    draft = as_tracked(graph, *rightly(truth, 0, 30))
    with turned("layout.solving", _SOLVE_ITERATIONS=1):
        assert solved(graph, solved(graph, draft)).limits == {"solve_iterations": 2}
    with turned("layout.solving", _SOLVE_ITERATIONS=100):
        assert solved(graph, draft).limits == {}


@few(8)
@given(st.floats(-9, 9), st.floats(-9, 9), st.floats(-3, 3))
def test_the_frame_of_the_map_does_not_matter(x: float, y: float, turn: float) -> None:
    truth, graph = driven()
    motion = np.array([x, y, turn])
    loops = (*rightly(truth, 0, 20, 40), link(7, 95, (11.0, 0.0, 0.0)))
    moved = graph_by_hand(compose(motion, graph.tracked))
    plain, dropped = settle(graph, as_tracked(graph, *loops))
    other, same = settle(moved, as_tracked(moved, *loops))
    assert dropped == same
    assert np.allclose(compose(motion, plain.poses)[:, :2], other.poses[:, :2], atol=5e-3)


@pytest.mark.parametrize("starts", [(0,), (0, 9), (5, 30, 55)])
def test_what_follows_the_last_loop_goes_with_it(starts: tuple[int, ...]) -> None:
    """Only the rows before are solved; all rows solved at once lie the same."""
    truth, graph = driven()
    draft = as_tracked(graph, *rightly(truth, *starts))
    widths = {"nearby": _KERNEL_SIGMAS}
    links = LinkArrays.of((*graph.odometry, *draft.loops), graph.row, widths)
    whole = solve(draft.poses, links, 100)
    assert np.abs(whole.poses - draft.poses).max() > 0.05
    after = solved(graph, draft)
    assert np.allclose(after.poses, whole.poses, atol=1e-4)


def test_a_bent_end_is_straightened_again() -> None:
    """Its loop was dropped: nothing but the motions holds it."""
    truth, graph = driven()
    (right,) = rightly(truth, 0)
    bent = graph.poses
    bent[100:] = compose(np.array([0.5, 0.2, 0.05]), bent[100:])
    after = solved(graph, replace(as_tracked(graph, right), poses=bent))
    straight = solved(graph, as_tracked(graph, right))
    assert np.allclose(after.poses, straight.poses, atol=1e-4)


def test_a_rough_solution_is_near_the_fine_one() -> None:
    truth, graph = driven()
    draft = as_tracked(graph, *rightly(truth, 0, 15, 30, 45))
    rough, fine = renewed(graph, draft), solved(graph, draft)
    assert np.abs(fine.poses - draft.poses).max() > 0.2
    assert np.allclose(rough.poses, fine.poses, atol=0.01)
    assert rough.limits == {}
