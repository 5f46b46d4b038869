"""Closures tried in the layout: those that bring walls into free space go, and it is told."""

from __future__ import annotations

from collections.abc import Iterator
from typing import cast

import numpy as np
import pytest

from specmap_cli.core.geometry import FloatArray, Pose2, compose
from specmap_cli.core.records import PlanarScan
from specmap_cli.core.settings import RelaxationConfig
from specmap_cli.layout.closing import Closed, closed, suspects
from specmap_cli.layout.contradictions import Standing, Views
from specmap_cli.layout.judging import Judged, Reason
from specmap_cli.layout.motion_edges import Bridge
from specmap_cli.layout.path_graph import Graph, graph_of
from specmap_cli.layout.pose_graph import Link
from specmap_cli.layout.relaxation import Constraint, Finished, chosen, relax
from specmap_cli.layout.walls import Walls
from tests.layout.driving import (
    STIFF,
    as_tracked,
    drifted,
    graph_by_hand,
    link,
    round_trip,
    stored,
    true_constraint,
    true_link,
    worst,
)
from tests.turning import turned

CONFIG = RelaxationConfig()
Drive = tuple[FloatArray, list[PlanarScan]]


@pytest.fixture
def alone() -> Iterator[None]:
    """No pass mends what closures do."""
    with turned("layout.nearby_passes", LOOPS_PER_NODE=0), turned("layout.strays", STRAY_TRIES=0):
        yield


@pytest.fixture
def ring(drive: Drive) -> Iterator[tuple[FloatArray, Graph, Walls, Views]]:
    """The drive as tracked with some drift, and what closing it needs."""
    truth, scans = drive
    with stored(drifted(truth), scans) as store:
        graph = graph_of(store, [60, 100, 200, 540, 590, 690], [])
        yield truth, graph, Walls(store, graph, 12.0), Views.of(store, graph)


def close(ring: tuple[FloatArray, Graph, Walls, Views], closures: list[Link]) -> Closed:
    _, graph, walls, views = ring
    return closed(graph, as_tracked(graph), closures, walls, views)


@pytest.mark.usefixtures("alone")
@pytest.mark.parametrize("away", [(3.0, 1.0), (0.0, 1.5)])
def test_a_wrong_closure_that_drift_would_allow_brings_walls_into_free_space(
    ring: tuple[FloatArray, Graph, Walls, Views], away: tuple[float, float]
) -> None:
    truth = ring[0]
    x, y, theta = true_link(truth, 60, 540).source_from_target
    wrong = link(60, 540, (x + away[0], y + away[1], theta), "closure")
    found = close(ring, [wrong])
    assert [one.reason for one in found.judged] == ["contradicted"]
    assert found.draft.loops == ()
    assert found.judged[0].away_m > 1.0
    with turned("layout.closing", _SUSPECTS_MOST=0):
        unasked = close(ring, [wrong])
    assert unasked.draft.loops == (wrong,), "nothing was suspected"


@pytest.mark.usefixtures("alone")
def test_right_closures_are_not_suspected(ring: tuple[FloatArray, Graph, Walls, Views]) -> None:
    truth = ring[0]
    right = [true_link(truth, *ends, "closure") for ends in ((60, 540), (100, 590), (200, 690))]
    found = close(ring, right)
    assert found.draft.loops == tuple(right)
    assert all(one.believed for one in found.judged)


@pytest.mark.usefixtures("alone")
def test_a_wrong_one_goes_and_the_right_ones_stay(
    ring: tuple[FloatArray, Graph, Walls, Views],
) -> None:
    truth = ring[0]
    right = [true_link(truth, *ends, "closure") for ends in ((60, 540), (200, 690))]
    x, y, theta = true_link(truth, 100, 590).source_from_target
    wrong = link(100, 590, (x - 4.0, y, theta), "closure")
    found = close(ring, [wrong, *right])
    assert {(one.link.source, one.believed) for one in found.judged if one.link is not wrong} == {
        (60, True),
        (200, True),
    }
    assert not found.judged[0].believed or worst(found.draft.poses, truth[ring[1].nodes]) < 0.5


def judged_as(one: Link, reason: Reason, away_m: float) -> Judged:
    return Judged(
        link=one,
        believed=True,
        reason=reason,
        away_m=away_m,
        allowed_m=9.0,
        votes=1,
    )


def test_suspects_follow_one_another_on_both_passes_and_mend_most_first() -> None:
    graph = graph_by_hand(np.array([(0.5 * k, 0.0, 0.0) for k in range(800)]))
    ends = ((0, 400), (40, 440), (300, 450), (80, 480), (500, 700))
    links = [link(a, b, (0.0, 0.0, 0.0), "closure") for a, b in ends]
    away = (1.0, 2.0, 5.0, 1.5, 0.1)
    reasons: tuple[Reason, ...] = ("drift", "drift", "drift", "agreement", "near")
    believed = [judged_as(*of) for of in zip(links, reasons, away, strict=True)]
    groups = suspects(graph, believed)
    assert [[one.link.source for one in group] for group in groups] == [[300], [0, 40, 80]]
    with turned("layout.closing", _SUSPECTS_MOST=1):
        assert len(suspects(graph, believed)) == 1


def shifted_lap(truth: FloatArray, motion: tuple[float, float, float], at: int) -> FloatArray:
    """Tracking broke at a keyframe, and what bridged the break was off by a motion."""
    tracked = np.array(truth)
    tracked[at:] = compose(np.array(motion), truth[at:])
    return tracked


@pytest.mark.usefixtures("alone")
def test_one_closure_does_not_move_a_piece_that_odometry_bridged(drive: Drive) -> None:
    """The bridge is good to 2 cm; a wrong closure asks for four metres."""
    truth, scans = drive
    at, x, y, theta = 500, *true_link(truth, 60, 540).source_from_target
    wrong = Constraint(60, 540, Pose2(x + 4.0, y, theta), STIFF)
    with stored(truth, scans) as store:
        layout = relax(store, [wrong], {at: Bridge(0.02, 0.005)}, CONFIG)
        unknown = relax(store, [wrong], {at: None}, CONFIG)
    assert worst(layout.poses, truth) < 0.1
    assert worst(unknown.poses, truth) < 0.1, "nor on one closure's word where nothing is known"
    assert layout.loose == ()
    assert unknown.loose == (at,)
    assert {one.kind for one in layout.odometry} == {"odometry", "bridge"}
    assert [one.first for one in unknown.evidence.parts] == [at]


@pytest.mark.usefixtures("alone")
def test_two_closures_that_agree_move_a_piece_of_which_nothing_is_known(drive: Drive) -> None:
    truth, scans = drive
    at = 500
    right = [true_constraint(truth, 60, 540), true_constraint(truth, 200, 690)]
    with stored(shifted_lap(truth, (2.0, -3.0, 0.7), at), scans) as store:
        both = relax(store, right, [at], CONFIG)
        one = relax(store, right[:1], [at], CONFIG)
    assert worst(both.poses, truth) < 0.2
    assert both.loose == ()
    (move,) = both.evidence.parts
    assert (move.first, move.votes) == (at, 2)
    assert move.moved_m == pytest.approx(0.96, abs=0.05)
    assert one.loose == (at,)
    assert [verdict.reason for verdict in one.evidence.closures] == ["impossible"]


def test_passes_mend_a_bridge_within_its_error(drive: Drive) -> None:
    truth, scans = drive
    at = 500
    with stored(shifted_lap(truth, (0.4, 0.3, 0.02), at), scans) as store:
        layout = relax(store, [], {at: Bridge(0.5, 0.05)}, CONFIG)
    assert worst(layout.poses, truth) < 0.2
    assert (layout.dropped, layout.loose) == ((), ())


def test_the_layout_tells_what_it_moved(drive: Drive) -> None:
    truth, scans = drive
    with stored(drifted(truth), scans) as store:
        evidence = relax(store, [true_constraint(truth, 100, 590)], [], CONFIG).evidence
    assert evidence.choice == "relaxed"
    assert evidence.parts == ()
    assert [one.link.source for one in evidence.closures[:1]] == [100]


@pytest.mark.usefixtures("alone")
def test_what_is_worse_than_the_path_as_tracked_is_not_taken(drive: Drive) -> None:
    """Three wrong closures that agree, over a path that was perfect, and none is suspected."""
    truth, scans = drive
    wrong = []
    for i, j in ((60, 540), (130, 610), (200, 690)):
        x, y, theta = true_link(truth, i, j).source_from_target
        wrong.append(Constraint(i, j, Pose2(x + 0.8, y + 0.8, theta), STIFF))
    with stored(truth, scans) as store, turned("layout.closing", _SUSPECTS_MOST=0):
        layout = relax(store, wrong, [], CONFIG)
    assert layout.evidence.choice in {"tracked", "passes"}
    assert worst(layout.poses, truth) < 0.05
    assert layout.kept == ()
    assert len(layout.dropped) == 3
    assert [edge.kind for edge in layout.dropped].count("closure") == 3


class Trusting:
    """Views that see nothing wrong in any layout they are asked of."""

    def standing(self, *_: object) -> Standing:
        return Standing(agree=1000)


def test_what_the_passes_say_anyway_is_kept_with_them() -> None:
    """Closures that agree make the layout worse: those that say what the passes say stay."""
    truth = round_trip(1.5)
    graph, count = graph_by_hand(truth), len(truth)
    passes = as_tracked(graph, *(true_link(truth, k, k + 480) for k in (20, 120)))
    near = true_link(truth, 60, 540, "closure")
    wrong = link(130, count - 10, (6.0, 5.0, 1.0), "closure")
    spoiled = Finished("relaxed", passes, (near, wrong), Standing(agree=1000, contradict=500))
    found = chosen(graph, passes, spoiled, Standing(), cast(Views, Trusting()))
    assert found.choice == "passes"
    assert found.draft.loops == (*passes.loops, near)
    assert found.dropped == (wrong,)
