"""Large graphs cut into parts before they are clustered."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from sklearn.metrics import adjusted_rand_score

from specmap_cli.core.settings import SegmentationConfig
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.segmentation import graph_division
from specmap_cli.segmentation.division import segment
from specmap_cli.segmentation.graph_division import parts_of
from specmap_cli.segmentation.spectral import Spectrum, clusters_of


def rooms(sizes: Sequence[int], bridge: float = 0.05) -> csr_array:
    """A chain of cliques, each joined to the next by one weak edge."""
    count = sum(sizes)
    S = np.zeros((count, count))
    start = 0
    for size in sizes:
        S[start : start + size, start : start + size] = 1.0
        if start:
            S[start - 1, start] = S[start, start - 1] = bridge
        start += size
    np.fill_diagonal(S, 0.0)
    return csr_array(S)


def test_a_small_graph_is_one_part_a_component() -> None:
    two = rooms([5, 4, 6], bridge=0.0)
    assert [part.tolist() for part in parts_of(two, 6)] == [
        list(range(5)),
        list(range(5, 9)),
        list(range(9, 15)),
    ]
    assert [part.tolist() for part in parts_of(rooms([5, 4]), 9)] == [list(range(9))]
    assert parts_of(csr_array((0, 0)), 10) == []


@given(sizes=st.lists(st.integers(4, 20), min_size=2, max_size=12), seed=st.integers(0, 1000))
def test_cuts_go_through_the_weak_edges_and_through_no_room(sizes: list[int], seed: int) -> None:
    place = np.random.default_rng(seed).permutation(sum(sizes))
    S, room = rooms(sizes)[place][:, place], np.repeat(np.arange(len(sizes)), sizes)[place]
    parts = parts_of(S, max(sizes))
    assert sorted(np.concatenate(parts).tolist()) == list(range(sum(sizes)))
    for part in parts:
        assert len(part) <= max(sizes)
        assert (np.diff(part) > 0).all()
        assert connected_components(S[part][:, part])[0] == 1
    if len(set(sizes)) == 1:  # else a share of the degrees may ask for a cut through a room
        assert all(len(np.unique(room[part])) == 1 for part in parts)
    assert [part[0] for part in parts] == sorted(part[0] for part in parts)


def test_the_cut_goes_where_least_is_lost() -> None:
    sizes = [30, 30, 30, 30]
    S = rooms(sizes).tolil()
    for i, j in ((29, 30), (89, 90)):  # wide openings; between them a narrow one
        S[i, j] = S[j, i] = 5.0
    parts = parts_of(csr_array(S), 60)
    assert [part.tolist() for part in parts] == [list(range(60)), list(range(60, 120))]


@pytest.fixture(scope="module")
def hotel() -> GridMap:
    """Twelve rooms on either side of a corridor; 0.05 m a cell."""
    cells = np.full((220, 24 * 80 // 2 + 20), OCCUPIED, dtype=np.uint8)
    cells[94:126, 10:-10] = FREE
    for number in range(12):
        left = 10 + number * 78
        for rows, door in ((slice(10, 90), slice(90, 94)), (slice(130, 210), slice(126, 130))):
            cells[rows, left : left + 74] = FREE
            cells[door, left + 28 : left + 46] = FREE
    return GridMap(cells, 0.05)


def test_rooms_are_the_same_whether_the_graph_is_cut_or_not(hotel: GridMap) -> None:
    config = SegmentationConfig()
    whole = segment(hotel, config)
    cut = segment(hotel, config.model_copy(update={"part_nodes": 300}))
    assert len(whole.nodes) > 600
    assert whole.count == cut.count == 25
    both = whole.labels >= 0
    assert adjusted_rand_score(whole.labels[both], cut.labels[both]) > 0.99


def test_no_spectrum_has_more_nodes_than_the_setting(
    hotel: GridMap, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = []

    def counted(L: Any, *rest: Any) -> Spectrum:
        seen.append(L.shape[0])
        return clusters_of(L, *rest)

    monkeypatch.setattr(graph_division, "clusters_of", counted)
    segment(hotel, SegmentationConfig(part_nodes=150))
    assert max(seen) <= 150


def test_a_hall_of_many_nodes_stays_one_region(plan: Callable[..., GridMap]) -> None:
    found = segment(plan(31, 21, (0.5, 0.5, 30.5, 20.5)), SegmentationConfig(part_nodes=300))
    assert len(found.nodes) > 900
    assert found.count == 1
