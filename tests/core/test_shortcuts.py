"""How far it is along a way that is tied to itself."""

import math

import networkx as nx
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.shortcuts import Shortcuts

places = st.integers(0, 12)
ties = st.lists(st.tuples(places, places, st.sampled_from([0.0, 0.5, 4.0])), max_size=8)


@given(
    st.lists(st.floats(0.0, 3.0), min_size=12, max_size=12),
    *(ties, places, places),
    st.one_of(st.floats(0.0, 20.0), st.just(math.inf)),
)
def test_the_least_way_goes_along_the_way_and_over_ties(
    steps: list[float], tied: list[tuple[int, int, float]], start: int, end: int, most_m: float
) -> None:
    along = np.cumsum([0.0, *steps]).tolist()
    ways = nx.MultiGraph()
    ways.add_weighted_edges_from((k, k + 1, step) for k, step in enumerate(steps))
    way, last = Shortcuts(), abs(along[end] - along[start])
    for one, other, metres in tied:
        way.add(along[one], along[other], metres)
        ways.add_edge(one, other, weight=metres)
        shortest = nx.shortest_path_length(ways, start, end, weight="weight")
        found = way.between(along[start], along[end], most_m)
        assert found == pytest.approx(min(shortest, most_m))
        assert found <= last + 1e-9  # no tie makes a way longer
        last = found


@pytest.mark.parametrize("ends", [(10.0, math.inf), (math.inf, 10.0), (math.inf, math.inf)])
def test_across_a_loss_of_tracking_no_way_is_known(ends: tuple[float, float]) -> None:
    way = Shortcuts()
    assert not math.isfinite(way.between(*ends))
    way.add(10.0, 50.0)
    assert not math.isfinite(way.between(*ends))
