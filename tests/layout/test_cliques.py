"""The largest clique against networkx, and what is left when the search is cut short."""

from __future__ import annotations

import networkx as nx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.layout.cliques import largest_clique
from tests.strategies import seeds

PLENTY = 100_000


def network(count: int, share: float, seed: int) -> nx.Graph:
    """A random graph."""
    return nx.gnp_random_graph(count, share, seed=seed)


@given(st.integers(0, 18), st.floats(0, 1), seeds)
def test_it_is_as_large_as_that_of_networkx(count: int, share: float, seed: int) -> None:
    graph = network(count, share, seed % 2**32)
    adjacent = nx.to_numpy_array(graph, dtype=bool) if count else np.zeros((0, 0), dtype=bool)
    found, exact = largest_clique(adjacent, PLENTY)
    largest = max((len(clique) for clique in nx.find_cliques(graph)), default=0)
    assert exact
    assert len(found) == largest
    assert list(found) == sorted(set(found))
    assert all(adjacent[a, b] for a in found for b in found if a < b)
    assert largest_clique(adjacent, PLENTY) == (found, exact)


@pytest.mark.parametrize("own", [False, True])
def test_the_diagonal_does_not_count(own: bool) -> None:
    adjacent = np.ones((4, 4), dtype=bool)
    np.fill_diagonal(adjacent, own)
    assert largest_clique(adjacent, PLENTY) == ((0, 1, 2, 3), True)


def test_of_equals_the_first_stays() -> None:
    adjacent = np.zeros((6, 6), dtype=bool)
    for a, b in ((0, 1), (2, 3), (4, 5)):
        adjacent[a, b] = adjacent[b, a] = True
    assert largest_clique(adjacent, PLENTY) == ((0, 1), True)


def test_a_search_that_is_cut_short_says_so_and_is_still_a_clique() -> None:
    adjacent = nx.to_numpy_array(network(60, 0.7, 3), dtype=bool)
    hasty, exact = largest_clique(adjacent, 5)
    best, certain = largest_clique(adjacent, PLENTY)
    assert not exact
    assert certain
    assert 2 < len(hasty) <= len(best)
    assert all(adjacent[a, b] for a in hasty for b in hasty if a < b)
