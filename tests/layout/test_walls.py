"""The walls around nodes, gathered from the store."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from specmap_cli.core.geometry import FloatArray, Pose2, compose
from specmap_cli.core.records import PlanarScan
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.grids.score_field import thinned
from specmap_cli.layout.path_graph import Graph
from specmap_cli.layout.walls import Walls
from tests.layout.driving import between, graph_by_hand, stored

Perfect = tuple[KeyframeStore, Graph]


def seen_from(store: KeyframeStore, graph: Graph, row: int, range_m: float) -> FloatArray:
    """The thinned points of one node in its own frame."""
    return thinned(store.points(int(graph.nodes[row]), range_m), 0.05)


@pytest.mark.parametrize(("row", "reach"), [(10, 3), (1, 3), (50, 0)])
def test_walls_are_those_of_the_neighbours_in_the_frame_of_the_node(
    perfect: Perfect, row: int, reach: int
) -> None:
    store, graph = perfect
    found = Walls(store, graph, 6.0).around(row, reach, graph.poses)
    expected = [
        between(graph.poses, row, k).apply(seen_from(store, graph, k, 6.0))
        for k in range(max(0, row - reach), row + reach + 1)
    ]
    assert np.allclose(found, np.concatenate(expected))


def test_walls_are_not_gathered_over_a_break(perfect: Perfect) -> None:
    store, graph = perfect
    first = int(np.argmax(graph.parts == 1))
    walls = Walls(store, graph, 6.0)
    after = walls.around(first, 4, graph.poses)
    assert len(after) == sum(len(seen_from(store, graph, first + k, 6.0)) for k in range(5))
    before = walls.around(first - 1, 4, graph.poses)
    assert len(before) == sum(len(seen_from(store, graph, first - 1 - k, 6.0)) for k in range(5))


def test_farther_returns_are_no_walls(perfect: Perfect) -> None:
    store, graph = perfect
    near = Walls(store, graph, 2.0).around(20, 0, graph.poses)
    assert 0 < len(near) < len(Walls(store, graph, 12.0).around(20, 0, graph.poses))
    assert np.hypot(*near.T).max() <= 2.0


def test_the_walls_of_many_nodes_lie_in_the_map_a_cell_apart(perfect: Perfect) -> None:
    store, graph = perfect
    rows, motion = list(range(0, 120, 2)), np.array([5.0, -3.0, 0.7])
    poses = compose(motion, graph.poses)
    gathered = Walls(store, graph, 6.0).of_all(rows, poses)
    everything = np.concatenate(
        [Pose2(*poses[k].tolist()).apply(seen_from(store, graph, k, 6.0)) for k in rows]
    )
    assert cKDTree(everything).query(gathered)[0].max() < 1e-9, "points are seen ones"
    assert cKDTree(gathered).query(everything)[0].max() < 0.05 * np.sqrt(2), "all are near one"
    cells = np.floor(gathered / 0.05)
    assert len(np.unique(cells, axis=0)) == len(cells)
    assert len(gathered) < 0.5 * len(everything)


def test_no_nodes_have_no_walls(perfect: Perfect) -> None:
    store, graph = perfect
    assert Walls(store, graph, 6.0).of_all([], graph.poses).shape == (0, 2)


def test_more_nodes_than_are_remembered_are_read_again(
    drive: tuple[FloatArray, list[PlanarScan]],
) -> None:
    truth, scans = drive
    with stored(truth, scans) as store:
        graph = graph_by_hand(truth)
        walls = Walls(store, graph, 6.0)
        before = walls.around(0, 0, truth)
        for row in range(300):
            walls.around(row, 0, truth)
        assert np.array_equal(walls.around(0, 0, truth), before)
