"""How far it is from one place along a way to another, where ties cut the way short."""

from __future__ import annotations

import math
from bisect import bisect_left, insort
from collections import defaultdict
from heapq import heappop, heappush


class Shortcuts:
    """Ties between places along a way, metres from its start; each tie is a way of its own."""

    def __init__(self) -> None:
        self._places: list[float] = []  # the tied ones, ascending
        self._tied = defaultdict[float, list[tuple[float, float]]](list)

    def add(self, a: float, b: float, metres: float = 0.0) -> None:
        """Tie two places, by a way of so many metres."""
        for place, other in ((a, b), (b, a)):
            if place not in self._tied:
                insort(self._places, place)
            self._tied[place].append((metres, other))

    def between(self, start: float, end: float, most_m: float = math.inf) -> float:
        """Metres of the least way between two places, along the way and over ties, to `most_m`."""
        heap, seen = [(0.0, start)], set[float]()
        while heap:  # Dijkstra's algorithm over the tied places
            way_m, place = heappop(heap)
            if way_m >= most_m:
                break
            if place in seen:
                continue
            seen.add(place)
            most_m = min(most_m, way_m + abs(place - end))
            at = bisect_left(self._places, place)
            for other in (*self._places[max(at - 1, 0) : at], *self._places[at : at + 2]):
                heappush(heap, (way_m + abs(place - other), other))
            for metres, other in self._tied.get(place, ()):
                heappush(heap, (way_m + metres, other))
        return most_m
