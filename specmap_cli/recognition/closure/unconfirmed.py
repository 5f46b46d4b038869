"""How far the robot has driven between two stays without a match that says what tracking says.

Drift grows along the way. Where the grids of two stays match just where tracking has them, it had
not drifted between these two, however long the way; what may have drifted is the rest.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from specmap_cli.core.settings import RecognitionConfig
from specmap_cli.recognition.closure.stay import Stay
from specmap_cli.recognition.closure.verdict import TWIN_MARGIN_M

_Tie = tuple[float, float, float]  # two places along the way, and the metres that part them


class UnconfirmedWay:
    """The ways between stays, cut short by the matches that confirmed them."""

    def __init__(self, config: RecognitionConfig) -> None:
        self.config = config
        self._ties: list[_Tie] = []

    def confirm(self, old: Stay, new: Stay, mended_m: float) -> None:
        """The grids of two stays match `mended_m` from where tracking has them.

        As far as that is no twin whatever the way, they are as near as the way on which drift makes
        as much. A match that cuts no way short is not kept: a robot that patrols makes many.
        """
        ends = old.travelled_m, new.travelled_m
        known = old.map_from_stay is not None and new.map_from_stay is not None
        if known and all(map(math.isfinite, ends)) and mended_m <= TWIN_MARGIN_M:
            drift = self.config.max_drift
            metres = mended_m / drift if drift > 0.0 else 0.0
            if metres < self.between(old, new):
                self._ties.append((*ends, metres))

    def between(self, old: Stay, new: Stay) -> float:
        """Metres of the shortest way between two stays; not finite across a loss of tracking."""
        start, end = old.travelled_m, new.travelled_m
        if not self._ties or not (math.isfinite(start) and math.isfinite(end)):
            return abs(end - start)
        return _shortest(start, end, self._ties)


def _shortest(start: float, end: float, ties: list[_Tie]) -> float:
    """Metres between two places along a way with ties between others."""
    places = sorted({start, end, *(place for tie in ties for place in tie[:2])})
    number = {place: k for k, place in enumerate(places)}
    metres = {(k, k + 1): b - a for k, (a, b) in enumerate(pairwise(places))}
    for a, b, tied_m in ties:
        i, j = sorted((number[a], number[b]))
        metres[i, j] = min(tied_m, metres.get((i, j), math.inf))
    ends = np.array(list(metres), dtype=np.int32).T  # csgraph wants 32 bits
    graph = csr_array((list(metres.values()), tuple(ends)), shape=(len(places), len(places)))
    return float(dijkstra(graph, directed=False, indices=number[start])[number[end]])
