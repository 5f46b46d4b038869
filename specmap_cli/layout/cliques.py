"""The largest clique of a graph: branch and bound with colours.

Tomita and Seki, "An efficient branch-and-bound algorithm for finding a maximum clique" (DMTCS
2003): vertices that share a colour are not neighbours, so that a clique has at most one of each.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def largest_clique(adjacent: NDArray[np.bool_], most_steps: int) -> tuple[tuple[int, ...], bool]:
    """The largest clique of an undirected graph (n, n), ascending, and whether that is certain.

    Of equals the first found counts: the same every time. It starts from a greedy one and ends
    after `most_steps` steps with the best so far.
    """
    search = _Search(adjacent, most_steps)
    search.expand([], search.all)
    return tuple(sorted(search.best)), search.left > 0


class _Search:
    """Sets of vertices are the bits of whole numbers."""

    def __init__(self, adjacent: NDArray[np.bool_], most_steps: int) -> None:
        self.neighbours = [
            sum(1 << int(k) for k in np.flatnonzero(row) if k != vertex)
            for vertex, row in enumerate(adjacent)
        ]
        self.all = (1 << len(adjacent)) - 1
        self.left = most_steps
        self.best = self._greedy()

    def expand(self, clique: list[int], candidates: int) -> None:
        """Look for larger cliques of `clique` and some of its common neighbours `candidates`."""
        if not candidates and len(clique) > len(self.best):
            self.best = list(clique)
        order, colours = self._coloured(candidates)
        for vertex, colour in zip(reversed(order), reversed(colours), strict=True):
            if self.left <= 0 or len(clique) + colour <= len(self.best):
                return
            self.left -= 1
            self.expand([*clique, vertex], candidates & self.neighbours[vertex])
            candidates &= ~(1 << vertex)

    def _coloured(self, candidates: int) -> tuple[list[int], list[int]]:
        """Vertices by colour, ascending, and the colour of each: a bound on cliques up to there."""
        order: list[int] = []
        colours: list[int] = []
        colour = 0
        while candidates:
            colour += 1
            free = candidates
            while free:
                vertex = (free & -free).bit_length() - 1
                candidates &= ~(1 << vertex)
                free &= ~(1 << vertex) & ~self.neighbours[vertex]
                order.append(vertex)
                colours.append(colour)
        return order, colours

    def _greedy(self) -> list[int]:
        """Vertices of the most neighbours first, each that is a neighbour of all before."""
        ranked = sorted(
            range(len(self.neighbours)), key=lambda v: (-self.neighbours[v].bit_count(), v)
        )
        clique: list[int] = []
        common = self.all
        for vertex in ranked:
            if common >> vertex & 1:
                clique.append(vertex)
                common &= self.neighbours[vertex]
        return clique
