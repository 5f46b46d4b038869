"""Walls of one pass in the free space of another: few where a layout is right, many where not."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from specmap_cli.core.geometry import FloatArray, compose
from specmap_cli.core.records import PlanarScan
from specmap_cli.core.settings import RelaxationConfig
from specmap_cli.layout.contradictions import Standing, Views
from specmap_cli.layout.path_graph import LOOP_PATH_M, Graph, graph_of
from tests.layout.driving import drifted, stored

CONFIG = RelaxationConfig()
Drive = tuple[FloatArray, list[PlanarScan]]


@pytest.fixture(scope="module")
def seen(drive: Drive) -> Iterator[tuple[Graph, Views]]:
    """The drive as it was, and what was seen."""
    truth, scans = drive
    with stored(truth, scans) as store:
        graph = graph_of(store, [], [])
        yield graph, Views.of(store, graph)


def moved_second_lap(graph: Graph, motion: tuple[float, float, float]) -> FloatArray:
    """The nodes with the second lap somewhere else."""
    poses = np.array(graph.poses)
    second = graph.nodes >= 480
    poses[second] = compose(np.array(motion), poses[second])
    return poses


def test_a_right_layout_agrees_and_hardly_anything_contradicts(seen: tuple[Graph, Views]) -> None:
    graph, views = seen
    right = views.standing(graph.poses)
    assert right.agree > 5000
    assert right.contradict < 0.01 * right.agree


@pytest.mark.parametrize("motion", [(0.0, 1.0, 0.0), (1.5, 0.0, 0.0), (0.0, 0.0, 0.1)])
def test_a_pass_that_was_moved_contradicts(
    seen: tuple[Graph, Views], motion: tuple[float, float, float]
) -> None:
    graph, views = seen
    right = views.standing(graph.poses)
    wrong = views.standing(moved_second_lap(graph, motion))
    assert wrong.contradict > 0.02 * wrong.agree
    assert wrong.agree < right.agree
    assert wrong.is_worse_than(right)
    assert not right.is_worse_than(wrong)
    assert wrong.is_doubtful
    assert not right.is_doubtful


def test_the_frame_of_the_map_does_not_matter(seen: tuple[Graph, Views]) -> None:
    graph, views = seen
    moved = compose(np.array([20.0, -7.0, 1.0]), graph.poses)
    plain, other = views.standing(graph.poses), views.standing(moved)
    assert other.agree == pytest.approx(plain.agree, rel=0.01)


def test_passes_that_are_apart_say_nothing(seen: tuple[Graph, Views]) -> None:
    graph, views = seen
    apart = views.standing(moved_second_lap(graph, (500.0, 0.0, 0.0)))
    assert apart.agree < 0.1 * views.standing(graph.poses).agree


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
        ((10_000, 600), (100, 0), False),  # much more agrees
        ((10_000, 1200), (100, 0), True),
        ((100, 1000), (100, 1000), False),
        ((2389, 258), (4347, 312), True),  # less agrees, and a larger share contradicts
        ((2389, 30), (4347, 312), False),
        ((0, 0), (5000, 10), False),  # what is apart contradicts nothing
    ],
)
def test_what_is_worse(now: tuple[int, int], before: tuple[int, int], worse: bool) -> None:
    assert Standing(*now).is_worse_than(Standing(*before)) is worse


def test_a_robot_that_saw_nothing_contradicts_nothing(drive: Drive) -> None:
    truth, scans = drive
    with stored(drifted(truth)[:2], scans[:2]) as store:
        graph = graph_of(store, [], [])
        assert Views.of(store, graph).standing(graph.poses) == Standing(0, 0)
