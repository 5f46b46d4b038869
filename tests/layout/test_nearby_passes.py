"""Nearby passes: which pairs of nodes are matched along the path, and what comes of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.geometry import FloatArray, Pose2, compose, invert, wrap_angle
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.motion_edges import MATCH_RANGE_M
from specmap_cli.layout.nearby_passes import candidates, find_passes, passes_at
from specmap_cli.layout.path_graph import LOOP_PATH_M, Draft, Graph
from specmap_cli.layout.pose_graph import Link
from specmap_cli.layout.solving import renewed
from specmap_cli.layout.stops import stops
from specmap_cli.layout.strays import _STRAY_VOTES
from specmap_cli.layout.walls import Walls
from tests.layout.driving import as_tracked, between
from tests.strategies import pose_arrays
from tests.turning import turned

Perfect = tuple[KeyframeStore, Graph]


def by_loops(node: int, poses: FloatArray, path: FloatArray, radius: float) -> list[int]:
    """The candidates of a node, from the words of the constants."""
    ranked = []
    for k in range(len(poses)):
        distance = float(np.hypot(*(poses[k, :2] - poses[node, :2])))
        turn = abs(wrap_angle(float(poses[k, 2] - poses[node, 2])))
        if path[node] - path[k] > LOOP_PATH_M and distance < radius:
            ranked.append((distance + 0.7 * turn, k))
    chosen: list[int] = []
    for _, k in sorted(ranked):
        if all(abs(path[k] - path[other]) > radius for other in chosen):
            chosen.append(k)
    return chosen


@given(
    pose_arrays(16),
    st.lists(st.floats(0.0, 3.0), min_size=16, max_size=16),
    st.integers(0, 15),
    st.floats(0.5, 60.0),
)
def test_candidates_are_near_far_along_the_path_and_apart(
    poses: FloatArray, steps: list[float], node: int, radius: float
) -> None:
    path = np.cumsum(steps)
    with turned("layout.nearby_passes", LOOP_RADIUS_M=radius):
        assert candidates(node, poses, path) == by_loops(node, poses, path, radius)


def test_none_per_node_is_none(perfect: Perfect) -> None:
    store, graph = perfect
    walls = Walls(store, graph, MATCH_RANGE_M)
    assert passes_at(190, graph, graph.poses, walls, {}, set(), 0.5).links
    with turned("layout.nearby_passes", LOOPS_PER_NODE=0):
        found = passes_at(190, graph, graph.poses, walls, {}, set(), 0.5)
        assert (found.links, found.guesses, found.is_tied) == ((), {}, False)
        assert find_passes(graph, as_tracked(graph), walls).loops == ()


@given(st.lists(st.floats(0.0, 3.0), min_size=1, max_size=30), st.floats(0.1, 5.0))
def test_stops_are_the_first_nodes_past_each_stretch(steps: list[float], every_m: float) -> None:
    path = np.cumsum(steps)
    chosen = stops(path, every_m)
    ways = [0.0, *path[chosen].tolist()]
    assert (np.diff(ways) >= every_m).all()
    for k in set(range(len(path))) - set(chosen):
        last = max(way for way in ways if way <= path[k])
        assert path[k] - last < every_m


def rows_of(graph: Graph, links: Sequence[Link]) -> set[tuple[int, int]]:
    return {(graph.row[link.source], graph.row[link.target]) for link in links}


def test_a_pass_is_linked_and_remembered(perfect: Perfect) -> None:
    store, graph = perfect
    walls = Walls(store, graph, MATCH_RANGE_M)
    first = passes_at(190, graph, graph.poses, walls, {}, set(), 0.5)
    assert first.is_tied
    (found,) = first.links
    truth = between(graph.tracked, found.source, found.target)
    assert (truth.inverse() @ found.source_from_target).distance < 0.1
    assert found.target == graph.nodes[190]
    assert first.cut_short == 0
    linked = rows_of(graph, first.links)
    again = passes_at(190, graph, graph.poses, walls, first.guesses, linked, 0.5)
    assert again.links == ()
    assert again.is_tied
    assert again.guesses == first.guesses


def test_the_second_pass_is_asked_when_the_first_does_not_fit(perfect: Perfect) -> None:
    store, graph = perfect
    walls = Walls(store, graph, MATCH_RANGE_M)
    graph = replace(graph, path=10 * graph.path)  # so that neighbours are passes of their own
    best, second = candidates(190, graph.poses, graph.path)[:2]
    guess = Pose2(*compose(invert(graph.poses[best]), graph.poses[190]).tolist())
    tried = {(best, 190): guess}  # to no avail
    found = passes_at(190, graph, graph.poses, walls, tried, set(), 0.5)
    assert rows_of(graph, found.links) == {(second, 190)}
    with turned("layout.nearby_passes", LOOPS_PER_NODE=1):
        assert not passes_at(190, graph, graph.poses, walls, tried, set(), 0.5).is_tied


@pytest.mark.parametrize(("shift", "count"), [(0.9, 0), (1.1, 1)])
def test_a_pair_that_moved_by_a_metre_is_matched_again(
    perfect: Perfect, shift: float, count: int
) -> None:
    store, graph = perfect
    walls = Walls(store, graph, MATCH_RANGE_M)
    with turned("layout.nearby_passes", LOOPS_PER_NODE=1):
        first = passes_at(190, graph, graph.poses, walls, {}, set(), 0.5)
        moved = {pair: guess @ Pose2(shift, 0.0, 0.0) for pair, guess in first.guesses.items()}
        found = passes_at(190, graph, graph.poses, walls, moved, set(), 0.5)
    assert len(found.links) == count


def test_a_search_shorter_than_the_drift_is_counted(perfect: Perfect) -> None:
    store, graph = perfect
    walls = Walls(store, graph, MATCH_RANGE_M)
    with turned("layout.nearby_passes", LOOP_SEARCH_MAX_M=0.5):
        found = passes_at(190, graph, graph.poses, walls, {}, set(), 0.6)
    assert found.cut_short == len(found.guesses) > 0
    tied = as_tracked(graph)
    with turned("layout.nearby_passes", LOOP_SEARCH_MAX_M=0.3):
        assert find_passes(graph, tied, walls).limits["loop_search_max_m"] > 0
    with turned("layout.nearby_passes", LOOP_SEARCH_MAX_M=9.0):
        assert find_passes(graph, tied, walls).limits == {}


def test_passes_are_found_along_the_second_lap(perfect: Perfect) -> None:
    store, graph = perfect
    walls = Walls(store, graph, MATCH_RANGE_M)
    draft = as_tracked(graph)
    found = find_passes(graph, draft, walls)
    assert len(found.loops) >= 15
    for edge in found.loops:
        truth = between(graph.tracked, edge.source, edge.target)
        assert edge.target > 440
        assert (truth.inverse() @ edge.source_from_target).distance < 0.1
    assert np.abs(found.poses - graph.poses).max() < 0.1, "they confirm what was right"
    assert draft.loops == ()
    assert draft.tried == {}
    again = find_passes(graph, found, walls)
    fresh = set(again.tried) - set(found.tried)
    assert len(fresh) <= 2, "nodes moved by millimetres: hardly another one is the nearest"
    assert found.loops == again.loops[: len(found.loops)]
    assert len(again.loops) <= len(found.loops) + len(fresh)


def test_where_more_passes_came_by_stops_are_farther_apart(perfect: Perfect) -> None:
    """Each neighbour of a node counts as a pass of its own: there are many."""
    store, graph = perfect
    walls = Walls(store, graph, MATCH_RANGE_M)
    known = replace(graph, path=10 * graph.path)  # metres that are decimetres
    with turned("layout.path_graph", LOOP_EVERY_M=10.0, LOOP_PATH_M=60.0):
        with turned("layout.uncertainty", DRIFT_SHARE=0.004):
            found = find_passes(known, as_tracked(graph), walls)
        with turned("layout.uncertainty", DRIFT_SHARE=0.02):
            often = find_passes(known, as_tracked(graph), walls)
    newer = sorted(graph.row[link.target] for link in found.loops)
    ways = np.diff(known.path[newer])
    assert ways.min() >= 20.0
    assert np.median(ways) < 45.0, "no farther than the path drifts by half of the least search"
    assert len(often.loops) > 1.5 * len(found.loops)


def test_what_confirms_the_layout_does_not_renew_it(
    perfect: Perfect, monkeypatch: pytest.MonkeyPatch
) -> None:
    store, graph = perfect
    walls = Walls(store, graph, MATCH_RANGE_M)
    solutions: list[int] = []

    def counted(graph: Graph, draft: Draft) -> Draft:
        solutions.append(len(draft.loops))
        return renewed(graph, draft)

    monkeypatch.setattr("specmap_cli.layout.nearby_passes.renewed", counted)
    monkeypatch.setattr("specmap_cli.layout.nearby_passes._SOLVE_EVERY", 2)
    assert len(find_passes(graph, as_tracked(graph), walls).loops) >= 15
    assert solutions == []
    aside = graph.poses
    aside[graph.parts == 1, 1] += 0.25
    find_passes(graph, replace(as_tracked(graph), poses=aside), walls)
    assert 0 < len(solutions) < 5, "the first bring the rest where it belongs"


def test_the_layout_is_renewed_as_passes_come_in(perfect: Perfect) -> None:
    """The second lap was put a little aside: the first passes bring all of it back at once."""
    store, graph = perfect
    second = graph.parts == 1
    aside = graph.poses
    aside[second, 1] += 0.25
    walls = Walls(store, graph, MATCH_RANGE_M)
    start = replace(as_tracked(graph), poses=aside)
    with turned("layout.nearby_passes", _SOLVE_EVERY=2):
        often = find_passes(graph, start, walls)
    with turned("layout.nearby_passes", _SOLVE_EVERY=10_000):
        never = find_passes(graph, start, walls)
    assert np.array_equal(never.poses, aside)
    off = np.hypot(*(often.poses - graph.poses)[second, :2].T)
    assert off.max() < 0.1


def test_a_stray_part_is_rejoined_on_the_way(perfect: Perfect) -> None:
    store, graph = perfect
    walls = Walls(store, graph, MATCH_RANGE_M)
    draft = Draft(poses=graph.poses)
    found = find_passes(graph, draft, walls)
    assert found.tied == {0, 1}
    assert found.tries[1] >= _STRAY_VOTES - 1, "the guess, which is right, is a vote"
    with turned("layout.strays", STRAY_TRIES=0):
        alone = find_passes(graph, draft, walls)
    assert alone.tied == {0}
    assert all(edge.target < 480 for edge in alone.loops), "a guess is no place to look from"
