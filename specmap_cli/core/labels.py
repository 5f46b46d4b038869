"""Sequences of labels and the graphs between them: runs, neighbours, order of first appearance."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

Neighbours = Mapping[int, frozenset[int]]


def runs(labels: Sequence[Any] | NDArray[Any]) -> list[tuple[int, int]]:
    """Half-open ranges (start, end) of equal successive labels (n,), in order; [] of none."""
    values = np.asarray(labels)
    if not len(values):
        return []
    cuts = np.flatnonzero(values[1:] != values[:-1]) + 1
    return list(pairwise([0, *cuts.tolist(), len(values)]))


def neighbours(ids: Iterable[int], pairs: Iterable[tuple[int, int]]) -> Neighbours:
    """The ids that share a pair with each id, which may be none; a pair of equals counts nothing.

    Raises KeyError for a pair with an end that is no id.
    """
    found: dict[int, set[int]] = {id_: set() for id_ in ids}
    for a, b in pairs:
        if a != b:
            found[a].add(b)
            found[b].add(a)
    return {id_: frozenset(near) for id_, near in found.items()}


def order_of_appearance(labels: Iterable[int]) -> dict[int, int]:
    """New numbers 0, 1, ... for the labels, in the order in which they first appear."""
    order: dict[int, int] = {}
    for label in labels:
        order.setdefault(int(label), len(order))
    return order
