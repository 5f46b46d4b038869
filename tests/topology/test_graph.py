"""The topology as a pure function of the submap of each keyframe."""

from __future__ import annotations

from itertools import pairwise

import networkx as nx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.geometry import Pose2
from specmap_cli.core.records import Closure
from specmap_cli.grids.gridmap import FREE, GridMap
from specmap_cli.topology.graph import (
    RegionMerger,
    build_topology,
    first_visit_order,
    settle_labels,
)
from specmap_cli.topology.topological_map import TopologicalMap


def line_of_poses(count: int, step_m: float = 1.0) -> np.ndarray:
    poses = np.zeros((count, 3))
    poses[:, 0] = np.arange(count) * step_m
    return poses


def grids_of(labels: list[int]) -> dict[int, GridMap]:
    return {label: GridMap(np.full((2, 2), FREE, dtype=np.uint8), 0.1) for label in set(labels)}


def topology_of(
    labels: list[int],
    breaks: tuple[int, ...] = (),
    closures: tuple[Closure, ...] = (),
    poses: np.ndarray | None = None,
) -> TopologicalMap:
    stamps = [1000 * k for k in range(len(labels))]
    return build_topology(
        np.array(labels),
        line_of_poses(len(labels)) if poses is None else poses,
        stamps,
        breaks,
        closures,
        {label: label for label in labels},
        grids_of(labels),
    )


def closure(old: int, new: int, verified: bool, merged: bool) -> Closure:
    return Closure(new, old, 0.5, 0.7, 0.7, verified, merged, 0.9, "because")


def test_visits_traversals_and_frames_follow_the_robot() -> None:
    topology = topology_of([0, 0, 1, 1, 0, 2])
    assert [len(topology.submaps[i].visits) for i in (0, 1, 2)] == [2, 1, 1]
    assert topology.submaps[0].keyframes == [0, 1, 4]
    visits = topology.submaps[0].visits
    assert [(v.start_ns, v.end_ns) for v in visits] == [(0, 1000), (4000, 4000)]
    assert {key: edge.kind for key, edge in topology.edges.items()} == {
        (0, 1): "traversed",
        (0, 2): "traversed",
    }
    there, back = topology.edges[0, 1].traversals
    assert (there.source, there.target, there.pose.x) == (0, 1, 1.5)
    assert (back.source, back.target, back.pose.x) == (1, 0, 3.5)
    assert topology.edges[0, 1].crossing == (2.5, 0.0)
    assert topology.edges[0, 1].source_from_target == Pose2(2.0, 0.0, 0.0)


def test_a_loss_of_tracking_leaves_a_loose_edge_until_the_robot_drives_across() -> None:
    assert topology_of([0, 1], breaks=(1,)).edges[0, 1].kind == "loose"
    assert topology_of([0, 1], breaks=(1,)).edges[0, 1].crossing is None
    assert topology_of([0, 1, 0], breaks=(1,)).edges[0, 1].kind == "traversed"


def test_a_verified_closure_is_an_edge_where_the_tracks_meet() -> None:
    labels, poses = [0, 0, 1, 1, 2, 2], line_of_poses(6)
    poses[4] = poses[0]  # the robot comes back to where it was in submap 0
    verified = (closure(0, 2, True, False), closure(1, 2, True, False))
    topology = topology_of(labels, closures=verified, poses=poses)
    assert topology.edges[0, 2].kind == "closure"
    assert topology.edges[1, 2].kind == "traversed"
    assert (0, 2) not in topology_of(labels, closures=verified).edges, "tracks apart"
    refused = (closure(0, 2, False, False),)
    assert (0, 2) not in topology_of(labels, closures=refused, poses=poses).edges


@given(st.lists(st.integers(0, 4), min_size=1, max_size=30))
def test_the_graph_of_a_driven_tour_is_connected_and_complete(
    labels: list[int],
) -> None:
    topology = topology_of(labels)
    graph = nx.Graph()
    graph.add_nodes_from(topology.submaps)
    graph.add_edges_from(topology.edges)
    assert nx.is_connected(graph)
    keyframes = sorted(k for submap in topology.submaps.values() for k in submap.keyframes)
    assert keyframes == list(range(len(labels)))
    crossings = sum(len(edge.traversals) for edge in topology.edges.values())
    assert crossings == sum(a != b for a, b in pairwise(labels))


def test_a_short_excursion_is_absorbed_and_a_long_one_stays() -> None:
    poses = line_of_poses(9, 0.2)
    labels = np.array([0, 0, 1, 1, 0, 0, 0, 2, 2])
    assert settle_labels(labels, poses, 0.5).tolist() == [0, 0, 0, 0, 0, 0, 0, 2, 2]
    assert settle_labels(labels, poses, 0.1).tolist() == labels.tolist()
    assert labels.tolist() == [0, 0, 1, 1, 0, 0, 0, 2, 2], "the argument is left alone"


def test_ids_are_given_in_order_of_first_visit() -> None:
    assert first_visit_order([7, 7, 3, 9, 3]) == {7: 0, 3: 1, 9: 2}


@given(st.lists(st.tuples(st.integers(0, 12), st.integers(0, 12)), max_size=20))
def test_merging_agrees_with_connected_components(pairs: list[tuple[int, int]]) -> None:
    merger, graph = RegionMerger(), nx.empty_graph(13)
    for region in range(13):
        merger.add(region)
    for a, b in pairs:
        merger.merge(a, b)
        graph.add_edge(a, b)
    for part in nx.connected_components(graph):
        assert {merger.find(region) for region in part} == {min(part)}
        assert merger.members(min(part)) == sorted(part)


def test_an_unknown_region_has_no_submap() -> None:
    with pytest.raises(KeyError):
        RegionMerger().find(3)
