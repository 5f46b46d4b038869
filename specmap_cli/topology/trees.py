"""Cheapest ways over free cells, from one cell to all others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import BoolArray, IntArray
from specmap_cli.topology.space import Window

_STEPS = ((0, 1), (1, 0), (1, 1), (1, -1))  # to half of the eight neighbours
_NO_NODE = -1


@dataclass(frozen=True, slots=True)
class Tree:
    """The cheapest ways from one cell over the cells of a window of the map.

    `number` (h, w) is the node of each cell, or -1; `cells` (n, 2) the row and column on the map;
    `cost` (n + 1,) that of the way, infinite where there is none and for node -1; `before` (n,) the
    node that comes before it on the way, negative for the first.
    """

    window: Window
    number: IntArray
    cells: IntArray
    cost: FloatArray
    before: NDArray[np.int32]

    def cost_to(self, cells: IntArray) -> FloatArray:
        """(m,) the cost of the way to cells (m, 2) of the window, infinite where there is none."""
        return np.asarray(self.cost[self._nodes(cells)])

    def way_to(self, cell: IntArray) -> IntArray:
        """(k, 2) the cells of the way to one that can be reached, from the first on."""
        node = int(self._nodes(cell[None])[0])
        way = [node]
        while (node := int(self.before[node])) >= 0:
            way.append(node)
        return np.asarray(self.cells[way[::-1]])

    def _nodes(self, cells: IntArray) -> IntArray:
        rows, columns = (cells - [part.start for part in self.window]).T
        return np.asarray(self.number[rows, columns])


def tree(open_cells: BoolArray, price: FloatArray, window: Window, start: tuple[int, int]) -> Tree:
    """The cheapest ways from `start`, a row and column of the map, over `open_cells` (h, w).

    `price` (h, w) is that of a step of one cell, also across corners. Both are of a `window` of
    the map. Takes n log n for n open cells.
    """
    from scipy.sparse import csr_matrix  # take a fifth of a second to load
    from scipy.sparse.csgraph import dijkstra

    number = np.full(open_cells.shape, _NO_NODE, dtype=np.int64)
    cells = np.argwhere(open_cells)
    number[open_cells] = np.arange(len(cells))
    ends, prices = _steps(number, price)
    graph = csr_matrix((prices, (ends[:, 0], ends[:, 1])), shape=(len(cells), len(cells)))
    first = int(number[start[0] - window[0].start, start[1] - window[1].start])
    cost, before = np.full(len(cells), np.inf), np.full(len(cells), _NO_NODE, dtype=np.int32)
    if first != _NO_NODE:
        cost, before = dijkstra(graph, directed=False, indices=first, return_predecessors=True)
    corner = [part.start for part in window]
    return Tree(window, number, cells + corner, np.append(cost, np.inf), before)


def _steps(number: IntArray, price: FloatArray) -> tuple[IntArray, FloatArray]:
    """Both nodes (m, 2) of each step between two numbered cells, and its price (m,)."""
    ends, prices = [], []
    height, width = number.shape
    for down, right in _STEPS:
        here = slice(0, height - down), slice(max(0, -right), width - max(0, right))
        there = slice(down, height), slice(max(0, right), width - max(0, -right))
        both = (number[here] != _NO_NODE) & (number[there] != _NO_NODE)
        if down and right:  # a line across a corner touches the cells on both sides of it
            both &= number[there[0], here[1]] != _NO_NODE
            both &= number[here[0], there[1]] != _NO_NODE
        ends.append(np.column_stack([number[here][both], number[there][both]]))
        prices.append((price[here][both] + price[there][both]) * (0.5 * np.hypot(down, right)))
    return np.concatenate(ends), np.concatenate(prices)
