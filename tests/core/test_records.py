"""Records that travel between stages, and arrays of them, against itertools and networkx."""

from __future__ import annotations

import itertools
from dataclasses import FrozenInstanceError

import networkx as nx
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from specmap_cli.core import records
from specmap_cli.core.arrays import evenly, first_in_cells, neighbours, runs
from specmap_cli.core.geometry import Pose2
from specmap_cli.core.records import PlanarScan
from tests.casting import keyframe
from tests.strategies import planar_scans, poses, seeds


@given(st.lists(st.integers(-1, 4), max_size=30))
def test_runs_are_those_of_groupby(labels: list[int]) -> None:
    found = runs(np.array(labels, dtype=np.int64))
    groups = [(label, len(list(group))) for label, group in itertools.groupby(labels)]
    assert [(labels[start], end - start) for start, end in found] == groups
    assert sum(end - start for start, end in found) == len(labels)


@given(st.lists(st.tuples(st.integers(0, 5), st.integers(0, 5)), max_size=12))
def test_neighbours_are_those_of_networkx(pairs: list[tuple[int, int]]) -> None:
    graph = nx.Graph()
    graph.add_nodes_from(range(6))
    graph.add_edges_from(pair for pair in pairs if pair[0] != pair[1])
    expected = {node: frozenset(graph[node]) for node in graph}
    assert neighbours(range(6), pairs) == expected
    with pytest.raises(KeyError):  # a pair of strangers
        neighbours(range(6), [*pairs, (0, 7)])


@given(st.integers(0, 200), st.integers(1, 60))
def test_what_is_kept_is_spread_evenly(count: int, most: int) -> None:
    kept = evenly(np.arange(count), most)
    assert len(kept) == min(count, most)
    assert (np.diff(kept) > 0).all()
    if count > most > 1:
        assert (kept[0], kept[-1]) == (0, count - 1)
        gaps = np.diff(kept)
        assert gaps.max() - gaps.min() <= 1
    rows = np.arange(2 * count).reshape(count, 2)  # which are kept whole
    assert evenly(rows, most).tolist() == rows[kept].tolist()
    assert evenly(rows, count) is rows


@given(seeds, st.just(200))
@example(0, 1)
@example(0, 0)
def test_the_first_point_of_each_cell_is_kept(seed: int, count: int) -> None:
    points = np.random.default_rng(seed).uniform(-3.0, 3.0, (count, 3))
    first: dict[tuple[float, ...], int] = {}
    for number, point in enumerate(points):
        first.setdefault(tuple(np.floor(point / 0.7).tolist()), number)
    assert first_in_cells(points, 0.7).tolist() == sorted(first.values())


@pytest.mark.parametrize("away", [1e3, 1e6, 1e12])
def test_cells_too_many_to_number_are_told_apart(away: float) -> None:
    points = np.array([[0, 0, 0], [away, -away, away], [0.05, 0, 0], [away, -away, away]])
    assert first_in_cells(points, 0.1).tolist() == [0, 1]
    assert first_in_cells(points[:, :2], 0.1).tolist() == [0, 1]


def test_records_are_frozen_slotted_and_documented() -> None:
    of_here = (kind for kind in vars(records).values() if isinstance(kind, type))
    for kind in (kind for kind in of_here if kind.__module__ == records.__name__):
        assert kind.__dataclass_params__.frozen, kind  # type: ignore[attr-defined]
        assert "__slots__" in vars(kind), kind
        assert kind.__doc__, kind


@given(planar_scans())
def test_hits_are_the_returns_in_order(scan: PlanarScan) -> None:
    hits = scan.hits(4.0)
    kept = [(r, b) for r, b in zip(scan.ranges, scan.bearings, strict=True) if r <= 4.0]
    expected = [(r * np.cos(b), r * np.sin(b)) for r, b in kept]
    np.testing.assert_allclose(hits, np.array(expected).reshape(-1, 2))
    assert len(scan.hits()) == np.isfinite(scan.ranges).sum()


@given(poses, poses)
def test_the_laser_stands_where_its_mounting_says(base: Pose2, mounting: Pose2) -> None:
    scan = PlanarScan(0, np.zeros(0), np.zeros(0), 1.0, False)
    posed = keyframe(scan, base, mounting)
    assert posed.map_from_laser == base @ mounting
    with pytest.raises(FrozenInstanceError):
        posed.lost = True  # type: ignore[misc]
