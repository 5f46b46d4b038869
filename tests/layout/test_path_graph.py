"""The graph of the path: its nodes, its parts, and the way between them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.geometry import FloatArray, compose
from specmap_cli.core.settings import RelaxationConfig
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.path_graph import (
    _NODE_RAD,
    LOOP_PATH_M,
    NODE_M,
    Draft,
    chosen_nodes,
    graph_of,
)
from tests.layout.driving import between

CONFIG = RelaxationConfig()


def wander(seed: int, count: int) -> FloatArray:
    """Poses of a robot that drives up to 0.2 m and turns up to 0.2 rad at a time."""
    rng = np.random.default_rng(seed)
    poses = np.zeros((count, 3))
    for k in range(1, count):
        step = [rng.uniform(0, 0.2), 0.0, rng.uniform(-0.2, 0.2)]
        poses[k] = compose(poses[k - 1], np.array(step))
    return poses


def test_nodes_are_a_step_apart_and_hold_what_must_be() -> None:
    poses = np.column_stack([np.arange(100) * 0.05, np.zeros(100), np.zeros(100)])
    nodes = chosen_nodes(poses, {17, 50}).tolist()
    assert {0, 17, 50, 99} <= set(nodes)
    assert np.diff(nodes).max() * 0.05 <= NODE_M + 0.05 + 1e-9
    assert len(nodes) < 25


def test_a_turn_on_the_spot_has_nodes() -> None:
    poses = np.column_stack([np.zeros(60), np.zeros(60), np.arange(60) * 0.1])
    assert chosen_nodes(poses, ()).tolist() == [*range(0, 60, 3), 59]


@given(st.integers(0, 1000), st.integers(1, 60), st.sets(st.integers(0, 59), max_size=4))
def test_every_keyframe_is_near_the_node_before_it(seed: int, count: int, always: set[int]) -> None:
    poses = wander(seed, count)
    nodes = chosen_nodes(poses, always).tolist()
    assert nodes == sorted(set(nodes))
    assert {0, count - 1} | {k for k in always if k < count} <= set(nodes)
    for k in set(range(count)) - set(nodes):
        step = between(poses, max(node for node in nodes if node < k), k)
        assert step.distance < NODE_M
        assert abs(step.theta) < _NODE_RAD


def test_parts_begin_at_breaks_and_the_path_jumps_there(store: KeyframeStore) -> None:
    graph = graph_of(store, [33], [0, 200, 450])
    assert {33, 200, 450} <= set(graph.nodes.tolist())
    assert graph.part_numbers == range(3)
    starts = [graph.nodes[graph.parts == part][0] for part in graph.part_numbers]
    assert starts == [0, 200, 450], "keyframe 0 is no break: there is nothing before it"
    steps = np.diff(graph.path)
    over = np.flatnonzero(np.diff(graph.parts))
    assert np.allclose(steps[over], 2 * LOOP_PATH_M)
    driven = np.hypot(*np.diff(store.poses[graph.nodes, :2], axis=0).T)
    assert np.allclose(np.delete(steps, over), np.delete(driven, over))
    assert graph.path[0] == 0.0
    assert [edge.kind == "loose" for edge in graph.odometry] == [
        bool(k in over) for k in range(len(graph.nodes) - 1)
    ]


def test_rows_lead_back_to_the_nodes(store: KeyframeStore) -> None:
    graph = graph_of(store, [], [])
    assert [graph.row[number] for number in graph.nodes.tolist()] == list(range(len(graph.nodes)))
    assert np.array_equal(graph.poses, store.poses[graph.nodes])
    assert graph.part_numbers == range(1)


def test_limits_are_counted_in_another_draft() -> None:
    draft = Draft(poses=np.zeros((1, 3)))
    once = draft.counting("stray_cells", 1)
    assert once.counting("stray_cells", 2).counting("stray_tries", 1).limits == {
        "stray_cells": 3,
        "stray_tries": 1,
    }
    assert draft.counting("stray_cells", 0) is draft
    assert draft.limits == {}


def test_nobody_can_poke_into_a_graph(store: KeyframeStore) -> None:
    graph = graph_of(store, [], [])
    with pytest.raises(dataclasses.FrozenInstanceError):
        graph.nodes = np.zeros(1, dtype=np.int64)  # type: ignore[misc]
