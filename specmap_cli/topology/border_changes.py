"""What became of the borders of submaps: how much is the same, and who has the rest.

Only cells that are free in both maps count: what nobody had seen before, or has not seen since, is
neither kept nor lost.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from specmap_cli.core.records import IntArray
from specmap_cli.grids.gridmap import FREE
from specmap_cli.topology.regions import Regions

_DECIMALS = 1  # of square metres: forty cells of 5 cm; less moves with the walls


@dataclass(frozen=True, slots=True, kw_only=True)
class BorderChange:
    """A submap before and after: intersection over union, and what it had, square metres.

    `given` and `taken` are what it gave to others, and what it has of theirs, by their ids; NOBODY
    stands for cells of no submap.
    """

    submap: int
    iou: float
    was_m2: float
    given: Mapping[int, float]
    taken: Mapping[int, float]


def border_changes(old: Regions, new: Regions) -> tuple[BorderChange, ...]:
    """What became of the submaps of `old` in `new`, by id; both are in one frame."""
    before, after = _owners(old, new)
    cell_m2 = old.grid.resolution**2
    return tuple(_change(submap, before, after, cell_m2) for submap in sorted(old.outlines))


def _owners(old: Regions, new: Regions) -> tuple[IntArray, IntArray]:
    """(n,) who had and who has the cells of the old map that are free in both."""
    cells = np.argwhere(old.grid.free)
    places = old.grid.centres_of(cells)
    both = new.grid.values_at(places) == FREE
    was, now = old.grid.cells_of(places[both]), new.grid.cells_of(places[both])
    return _of(old, was), _of(new, now)


def _of(regions: Regions, cells: IntArray) -> IntArray:
    return np.asarray(regions.owner[cells[:, 0], cells[:, 1]], dtype=np.int64)


def _change(submap: int, before: IntArray, after: IntArray, cell_m2: float) -> BorderChange:
    was, now = before == submap, after == submap
    return BorderChange(
        submap=submap,
        iou=int(np.count_nonzero(was & now)) / max(1, int(np.count_nonzero(was | now))),
        was_m2=float(np.count_nonzero(was)) * cell_m2,
        given=_areas(after[was & ~now], cell_m2),
        taken=_areas(before[now & ~was], cell_m2),
    )


def _areas(owners: IntArray, cell_m2: float) -> dict[int, float]:
    """Square metres by owner, those that round to nought left out."""
    found, counts = np.unique(owners, return_counts=True)
    areas = np.round(counts * cell_m2, _DECIMALS)
    return {int(i): float(m2) for i, m2 in zip(found, areas, strict=True) if m2 > 0.0}
