"""Drafts solved: outliers dropped, closures over any drift, chains of motions taken for one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.geometry import FloatArray, compose, invert
from specmap_cli.layout.path_graph import Graph
from specmap_cli.layout.pose_graph import Link, LinkArrays, solve
from specmap_cli.layout.solving import _KERNEL_SIGMAS, settle, solved, tighten
from tests.layout.driving import arc, as_tracked, drifted, graph_by_hand, link, true_link
from tests.strategies import few
from tests.turning import turned

LAP = 60


def driven(bias: float = 0.002) -> tuple[FloatArray, Graph]:
    """True poses around a circle, two laps, and the graph of a robot that turned too far."""
    truth = arc(2 * LAP, 2 * np.pi / LAP)
    return truth, graph_by_hand(drifted(truth, bias))


def rightly(truth: FloatArray, *starts: int) -> tuple[Link, ...]:
    """Passes from the first lap to the second, as they are."""
    return tuple(true_link(truth, k, k + LAP) for k in starts)


def off(poses: FloatArray, truth: FloatArray, every: int) -> float:
    """Largest error of where the second lap lies, seen from every so many places of the first."""
    gaps = compose(invert(poses[:LAP:every]), poses[LAP::every])
    true = compose(invert(truth[:LAP:every]), truth[LAP::every])
    return float(np.hypot(*(gaps - true)[:, :2].T).max())


def test_loops_pull_the_laps_together_also_roughly() -> None:
    truth, graph = driven()
    draft = as_tracked(graph, *rightly(truth, 0, 15, 30, 45))
    assert off(draft.poses, truth, 15) > 0.4
    after, rough = solved(graph, draft), solved(graph, draft, roughly=True)
    assert off(after.poses, truth, 15) < 0.04
    assert np.array_equal(draft.poses, graph.poses), "the draft before is as it was"
    assert after.loops == draft.loops
    assert np.allclose(rough.poses, after.poses, atol=0.01)


@few(10)
@given(st.integers(0, LAP - 1), st.floats(1.5, 20), st.floats(-3, 3))
def test_a_dropped_outlier_leaves_the_others_alone(at: int, away: float, turn: float) -> None:
    truth, graph = driven()
    right, wrong = rightly(truth, 0, 15, 30, 45), link(at, at + 50, (away, away, turn))
    with_wrong, dropped = settle(graph, as_tracked(graph, *right, wrong))
    without, none = settle(graph, as_tracked(graph, *right))
    assert (dropped, none) == ((wrong,), ())
    assert with_wrong.loops == without.loops == right
    assert np.allclose(with_wrong.poses[:, :2], without.poses[:, :2], atol=0.02)


def test_what_is_dropped_is_told_in_order_and_motions_stay() -> None:
    truth, graph = driven()
    right = rightly(truth, 0, 15, 30, 45)
    first, second = link(5, 70, (30.0, 0.0, 0.0)), link(9, 80, (0.0, -40.0, 0.0))
    draft, dropped = settle(graph, as_tracked(graph, first, *right, second))
    assert (dropped, draft.loops) == ((first, second), right)
    alone, nothing = settle(graph, as_tracked(graph))
    assert nothing == ()
    assert np.allclose(alone.poses, graph.poses)
    assert np.allclose(tighten(graph, as_tracked(graph)).poses, graph.poses)


def test_what_counts_as_an_outlier_is_set() -> None:
    truth, graph = driven(bias=0.0)
    x, y, theta = true_link(truth, 0, LAP).source_from_target
    unlikely = link(0, LAP, (x + 0.16, y, theta))  # four sigmas off
    loops = (*rightly(truth, *range(20)), unlikely)
    for limit, expected in ((25.0, ()), (4.0, (unlikely,))):
        with turned("layout.solving", _OUTLIER_CHI2=limit):
            assert settle(graph, as_tracked(graph, *loops))[1] == expected


def test_closures_that_agree_win_over_any_drift() -> None:
    """Metres off, each of them is an outlier to begin with; together they outvote the wrong one."""
    truth, graph = driven(0.02)
    wrong = link(3, 100, (6.0, 5.0, 1.0), "closure")
    start = as_tracked(graph, *rightly(truth, 0, 10, 20, 30, 40, 50), wrong)
    assert off(start.poses, truth, 10) > 2.0
    assert len(settle(graph, start)[1]) == 7, "none is believed as it is"
    draft, dropped = settle(graph, tighten(graph, start))
    assert dropped == (wrong,)
    assert off(draft.poses, truth, 10) < 0.1


@pytest.mark.parametrize("starts", [(0,), (0, 9), (5, 30, 55)])
def test_what_follows_the_last_loop_goes_with_it(starts: tuple[int, ...]) -> None:
    """Only the rows before are solved; all rows solved at once lie the same."""
    truth, graph = driven()
    draft = as_tracked(graph, *rightly(truth, *starts))
    links = LinkArrays.of((*graph.odometry, *draft.loops), graph.row, {"nearby": _KERNEL_SIGMAS})
    whole = solve(draft.poses, links, 100)
    assert np.abs(whole.poses - draft.poses).max() > 0.05
    assert np.allclose(solved(graph, draft).poses, whole.poses, atol=1e-4)


def test_a_bent_end_is_straightened_again() -> None:
    """Its loop was dropped: nothing but the motions holds it."""
    truth, graph = driven()
    straight = as_tracked(graph, *rightly(truth, 0))
    bent = graph.poses
    bent[100:] = compose(np.array([0.5, 0.2, 0.05]), bent[100:])
    after = solved(graph, replace(straight, poses=bent))
    assert np.allclose(after.poses, solved(graph, straight).poses, atol=1e-4)
