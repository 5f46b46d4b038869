"""How much of one division of a building is found in another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.stability.maps import Divided
from specmap_cli.grids.gridmap import BoolArray

SAME = 0.5  # IoU above which two submaps are one: each submap has one such partner at the most


@dataclass(frozen=True, slots=True)
class Agreement:
    """`matched` submaps of the `first` and `second` that both maps saw, and the mean best IoU."""

    matched: int
    first: int
    second: int
    iou: float

    @property
    def share(self) -> float:
        """Matched submaps of those of the map that has more of them."""
        return self.matched / max(self.first, self.second, 1)


def agreement(first: Divided, second: Divided) -> Agreement:
    """Hold the submaps of two maps against each other, over the cells that belong to one in both.

    A submap counts when both maps saw at least half of it.
    """
    one, other = first.regions, second.regions
    cells = np.argwhere(one.owner >= 0)
    second_from_first = second.shared_from_map.inverse() @ first.shared_from_map
    there = other.grid.cells_of(second_from_first.apply(one.grid.centres_of(cells)))
    inside = other.grid.inside(there)
    mine, theirs = one.owner[tuple(cells[inside].T)], other.owner[tuple(there[inside].T)]
    both = theirs >= 0
    shared = np.zeros((one.owner.max() + 1, other.owner.max() + 1))
    np.add.at(shared, (mine[both], theirs[both]), 1.0)
    iou = shared / np.maximum(shared.sum(axis=1)[:, None] + shared.sum(axis=0) - shared, 1.0)
    counted = iou[_seen(shared.sum(axis=1), one.owner)][:, _seen(shared.sum(axis=0), other.owner)]
    return Agreement(
        matched=int((counted > SAME).sum()),
        first=counted.shape[0],
        second=counted.shape[1],
        iou=float(counted.max(axis=1).mean()) if counted.size else 0.0,
    )


def _seen(common: np.ndarray, owner: np.ndarray) -> BoolArray:
    """Which regions (k,) lie in both maps by half at the least, of those that own a cell."""
    whole = np.bincount(owner[owner >= 0], minlength=len(common))
    return np.asarray((whole > 0) & (common >= 0.5 * whole))
