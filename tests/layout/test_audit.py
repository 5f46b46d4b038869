"""Views of passes that contradict each other: found, told from people, and counted."""

from dataclasses import replace

import numpy as np
import pytest

from specmap_cli.core.geometry import compose
from specmap_cli.layout.audit import Agreement, Views
from specmap_cli.layout.path_graph import LOOP_PATH_M, Graph, graph_of
from tests.layout.driving import SECOND_LAP, Drive, Laps, drifted, moved_from, stored


@pytest.fixture(scope="module")
def seen(perfect: Laps) -> tuple[Graph, Views]:
    """The drive as it was, and what was seen."""
    store = perfect[0]
    graph = graph_of(store, [], {})
    return graph, Views.of(store, graph)


@pytest.mark.parametrize("motion", [(0.0, 1.0, 0.0), (1.5, 0.0, 0.0), (0.0, 0.0, 0.1)])
def test_a_moved_pass_is_told(
    seen: tuple[Graph, Views], motion: tuple[float, float, float]
) -> None:
    graph, views = seen
    right = views.agreement(graph.poses)
    assert right.agree > 5000
    assert right.contradict < 0.01 * right.agree
    first = int(np.searchsorted(graph.nodes, SECOND_LAP))
    wrong = views.agreement(moved_from(first, graph.poses, motion))
    assert wrong.contradict > 0.01 * wrong.agree
    assert wrong.worst
    assert wrong.agree < right.agree
    assert wrong.is_worse_than(right)
    assert not right.is_worse_than(wrong)
    assert wrong.is_doubtful
    assert not right.is_doubtful


def test_a_person_before_walls_that_both_saw_contradicts_nothing(seen: tuple[Graph, Views]) -> None:
    """Somebody stands a metre before the laser in one view of ten of the second pass, or in all."""
    graph, views = seen
    first = int(np.searchsorted(views.rows, np.searchsorted(graph.nodes, SECOND_LAP)))
    before = views.agreement(graph.poses).contradict
    found = []
    for chosen in (slice(first, None, 10), slice(first, None)):
        ranges = views.ranges.copy()
        ranges[chosen, 40:60] = np.minimum(ranges[chosen, 40:60], 1.0)
        found.append(replace(views, ranges=ranges).agreement(graph.poses))
    some, everywhere = found
    assert some.contradict <= before + 10
    assert not some.is_doubtful
    assert everywhere.agree < some.agree


def test_the_frame_does_not_matter_and_passes_apart_say_nothing(seen: tuple[Graph, Views]) -> None:
    graph, views = seen
    moved = compose(np.array([20.0, -7.0, 1.0]), graph.poses)
    plain, other = (views.agreement(poses) for poses in (graph.poses, moved))
    assert other.agree == pytest.approx(plain.agree, rel=0.01)
    first = int(np.searchsorted(graph.nodes, SECOND_LAP))
    apart = views.agreement(moved_from(first, graph.poses, (500.0, 0.0, 0.0)))
    assert apart.agree < 0.1 * plain.agree


def test_partners_are_near_and_of_another_pass(seen: tuple[Graph, Views]) -> None:
    graph, views = seen
    lasers = compose(graph.poses[views.rows], views.mounts)
    older, newer = views.partners(lasers)
    assert len(older) > 20
    assert (views.way[newer] - views.way[older] > LOOP_PATH_M).all()
    assert (np.hypot(*(lasers[older] - lasers[newer])[:, :2].T) < 4.0).all()
    assert np.bincount(newer).max() <= 4


@pytest.mark.parametrize(
    ("now", "before", "worse"),
    [
        ((100, 60), (100, 0), True),
        ((100, 20), (100, 0), False),  # a door that closed
        ((10_000, 300), (100, 0), False),  # much more agrees
        ((10_000, 400), (100, 0), True),
        ((100, 1000), (100, 1000), False),
        ((2389, 258), (4347, 312), True),  # less agrees, and a larger share contradicts
        ((2389, 30), (4347, 312), False),
        ((0, 0), (5000, 10), False),  # what is apart contradicts nothing
    ],
)
def test_what_is_worse(now: tuple[int, int], before: tuple[int, int], worse: bool) -> None:
    assert Agreement(*now).is_worse_than(Agreement(*before)) is worse


def test_nothing_is_said_of_a_robot_that_came_nowhere_again(drive: Drive) -> None:
    truth, scans = drive
    with stored(drifted(truth)[:2], scans[:2]) as store:
        graph = graph_of(store, [], {})
        assert Views.of(store, graph).agreement(graph.poses) == Agreement(0, 0)
