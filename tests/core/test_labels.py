"""Runs and neighbours, against itertools and networkx."""

from __future__ import annotations

from itertools import groupby

import networkx as nx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.arrays import neighbours, order_of_appearance, runs

LABELS = st.lists(st.integers(-1, 4), max_size=30)


@given(LABELS)
def test_runs_are_those_of_groupby(labels: list[int]) -> None:
    found = runs(np.array(labels, dtype=np.int64))
    assert [labels[start] for start, _ in found] == [label for label, _ in groupby(labels)]
    assert [end - start for start, end in found] == [len(list(g)) for _, g in groupby(labels)]
    assert sum(end - start for start, end in found) == len(labels)


@given(st.lists(st.tuples(st.integers(0, 5), st.integers(0, 5)), max_size=12))
def test_neighbours_are_those_of_networkx(pairs: list[tuple[int, int]]) -> None:
    graph = nx.Graph()
    graph.add_nodes_from(range(6))
    graph.add_edges_from(pair for pair in pairs if pair[0] != pair[1])
    expected = {node: frozenset(graph[node]) for node in graph}
    assert neighbours(range(6), pairs) == expected


def test_a_pair_of_strangers_is_refused() -> None:
    with pytest.raises(KeyError):
        neighbours([0, 1], [(0, 7)])


@given(LABELS)
def test_labels_are_numbered_as_they_appear(labels: list[int]) -> None:
    order = order_of_appearance(labels)
    assert list(order.values()) == list(range(len(set(labels))))
    firsts = [labels.index(label) for label in order]
    assert firsts == sorted(firsts)
