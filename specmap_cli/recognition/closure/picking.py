"""Which of several matches is told, and which submaps may be duplicates of each other."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace

from specmap_cli.core.records import Closure

_ALIKE_M = 1.0  # tracking is off by as much in either of two places


def with_one_merge(
    closures: Sequence[Closure], moved_m: Callable[[Closure], float], lead: float
) -> list[Closure]:
    """The closures with the best of the merges alone left as one.

    Of those that match nearly as well, by less than `lead`, the one is right that tracking
    expected: `moved_m` tells how far a match moves the new stay. Twin rooms are a room apart.
    """
    merges = [c for c in closures if c.merged]
    if not merges:
        return list(closures)
    enough = max(c.score for c in merges) - lead
    best = min(
        (c for c in merges if c.score >= enough),
        key=lambda c: (max(moved_m(c), _ALIKE_M), -c.score, c.old),
    )
    return [
        replace(c, merged=False, reason="another submap fits better")
        if c.merged and c is not best
        else c
        for c in closures
    ]


def likely_duplicates(
    ids: Sequence[int], adjacency: Mapping[int, Collection[int]]
) -> list[tuple[int, int]]:
    """Pairs (smaller, larger) of submaps one or two edges apart."""
    pairs: list[tuple[int, int]] = []
    left = set(ids)
    for start in ids:
        near = set(adjacency.get(start, ()))
        near |= {n for neighbour in near for n in adjacency.get(neighbour, ())}
        pairs.extend((start, other) for other in sorted(near & left) if other > start)
    return pairs


def merit(closure: Closure) -> tuple[bool, bool, float]:
    """What makes one match with a submap better than another; no match at all is the worst."""
    score = -math.inf if math.isnan(closure.score) else closure.score
    return closure.merged, closure.verified, score
