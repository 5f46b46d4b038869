"""Which submap of one map is which of another, and how its border changed.

Both maps are in one frame. A submap is the same when most of its floor is: over the cells that both
maps saw, intersection over union above a half, which at most one submap of the other map can reach.
Of borders only cells that are free in both maps count: what nobody had seen before, or has not seen
since, is neither kept nor lost.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.json_values import Count, Value
from specmap_cli.core.records import IntArray
from specmap_cli.grids.gridmap import FREE, UNKNOWN
from specmap_cli.topology.regions import NOBODY, Regions

SAME = 0.5  # intersection over union above which two submaps are one, and no other is
_MOST = 0.5  # share of a submap that makes it part of another, or seen

_TINY_M2 = 1e-9  # keeps submaps that nobody saw from dividing by nought

_Owners = NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Same(Value):
    """A submap of either map that are one, and intersection over union of what both maps saw."""

    old: Count
    new: Count
    iou: float  # in (0.5, 1]


@dataclass(frozen=True, kw_only=True)  # without slots: the mapping is made once
class Identity:
    """What became of the submaps of an old map in a new one, by ids, ascending.

    `splits`: an old submap and the new ones, two or more, that lie in it for the most part.
    `merges`: a new submap and the old ones, two or more, in it. `added`: new ones where the old map
    saw little; `unseen`: old ones where the new map saw little; `gone`: old ones whose place the
    new map saw, where there is no floor any more. `redrawn` (old, new): the others, whose borders
    are elsewhere.
    """

    same: tuple[Same, ...]
    splits: Mapping[int, tuple[int, ...]]
    merges: Mapping[int, tuple[int, ...]]
    added: tuple[int, ...]
    unseen: tuple[int, ...]
    gone: tuple[int, ...]
    redrawn: tuple[tuple[int, ...], tuple[int, ...]]


def identify(old: Regions, new: Regions, old_from_new: Pose2) -> Identity:
    """Which submap of `new` is which of `old`; `old_from_new` is between their frames."""
    old_ids, new_ids = sorted(old.outlines), sorted(new.outlines)
    shared, floor_m2 = _shared(old, new, old_from_new)
    common, old_m2, new_m2 = shared[:-1, :-1], shared[:-1].sum(axis=1), shared[:, :-1].sum(axis=0)
    iou = common / np.maximum(old_m2[:, None] + new_m2[None, :] - common, _TINY_M2)
    same = tuple(
        Same(old=old_ids[i], new=new_ids[j], iou=float(iou[i, j]))
        for i, j in np.argwhere(iou > SAME).tolist()
    )
    old_seen = old_m2 > _MOST * _areas(old, old_ids)
    new_seen = new_m2 > _MOST * _areas(new, new_ids)
    floored = floor_m2 > _MOST * old_m2
    part_of_old = common / np.maximum(new_m2, _TINY_M2)[None, :]
    part_of_new = common / np.maximum(old_m2, _TINY_M2)[:, None]
    splits = _groups(part_of_old * new_seen, new_ids, old_ids)
    merges = _groups((part_of_new * old_seen[:, None]).T, old_ids, new_ids)
    kept_old = {pair.old for pair in same} | set(splits) | _members(merges)
    kept_new = {pair.new for pair in same} | set(merges) | _members(splits)
    return Identity(
        same=same,
        splits=splits,
        merges=merges,
        added=_chosen(new_ids, ~new_seen, kept_new),
        unseen=_chosen(old_ids, ~old_seen, kept_old),
        gone=_chosen(old_ids, old_seen & ~floored, kept_old),
        redrawn=(
            _chosen(old_ids, old_seen & floored, kept_old),
            _chosen(new_ids, new_seen, kept_new),
        ),
    )


def _shared(old: Regions, new: Regions, old_from_new: Pose2) -> tuple[FloatArray, FloatArray]:
    """(n + 1, m + 1) square metres of each old and new submap, the last for nobody, over what both
    maps saw; and (n,) how much of the old ones is free in the new map. Cells are the old map's.
    """
    old_ids, new_ids = sorted(old.outlines), sorted(new.outlines)
    cells = np.argwhere(old.grid.cells != UNKNOWN)
    places = old_from_new.inverse().apply(old.grid.centres_of(cells))
    values = new.grid.values_at(places)
    both = values != UNKNOWN
    one = _numbers(old.owner[cells[both, 0], cells[both, 1]], old_ids)
    other = _numbers(_owners_at(new, places[both]), new_ids)
    m2 = old.grid.resolution**2
    shared = np.zeros((len(old_ids) + 1, len(new_ids) + 1))
    np.add.at(shared, (one, other), m2)
    floor = np.zeros(len(old_ids) + 1)
    np.add.at(floor, one, m2 * (values[both] == FREE))
    return shared, floor[:-1]


def _numbers(owners: _Owners, ids: list[int]) -> NDArray[np.intp]:
    """(N,) the place of each owner among some ids, ascending; their count for nobody."""
    if not ids:
        return np.zeros(len(owners), dtype=np.intp)
    places = np.searchsorted(ids, owners).clip(0, len(ids) - 1)
    return np.where(np.asarray(ids)[places] == owners, places, len(ids))


def _owners_at(regions: Regions, places: FloatArray) -> _Owners:
    """(N,) the submap at each place (N, 2), all on the grid."""
    rows, columns = regions.grid.cells_of(places).T
    return np.asarray(regions.owner[rows, columns], dtype=np.int64)


def _areas(regions: Regions, ids: list[int]) -> FloatArray:
    """(n,) square metres of each submap."""
    counts = np.bincount(regions.owner[regions.owner != NOBODY].ravel(), minlength=1)
    return np.array([counts[i] for i in ids], dtype=np.float64) * regions.grid.resolution**2


def _groups(
    part: FloatArray, members: Sequence[int], owners: Sequence[int]
) -> dict[int, tuple[int, ...]]:
    """The members, two or more, that lie in each owner by `part` (owner, member) above a half."""
    groups = {}
    for owner, row in zip(owners, part, strict=True):
        inside = tuple(m for m, share in zip(members, row.tolist(), strict=True) if share > _MOST)
        if len(inside) > 1:
            groups[owner] = inside
    return groups


def _members(groups: Mapping[int, tuple[int, ...]]) -> set[int]:
    return {member for group in groups.values() for member in group}


def _chosen(ids: Sequence[int], wanted: NDArray[np.bool_], taken: set[int]) -> tuple[int, ...]:
    """The ids that are wanted (n,) and not taken."""
    return tuple(i for i, want in zip(ids, wanted.tolist(), strict=True) if want and i not in taken)


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
    cells = np.argwhere(old.grid.free)
    places = old.grid.centres_of(cells)
    both = new.grid.values_at(places) == FREE
    before, after = (_owners_at(regions, places[both]) for regions in (old, new))
    cell_m2 = old.grid.resolution**2
    return tuple(_change(submap, before, after, cell_m2) for submap in sorted(old.outlines))


def _change(submap: int, before: IntArray, after: IntArray, cell_m2: float) -> BorderChange:
    was, now = before == submap, after == submap
    return BorderChange(
        submap=submap,
        iou=int(np.count_nonzero(was & now)) / max(1, int(np.count_nonzero(was | now))),
        was_m2=float(np.count_nonzero(was)) * cell_m2,
        given=_areas_by_owner(after[was & ~now], cell_m2),
        taken=_areas_by_owner(before[now & ~was], cell_m2),
    )


def _areas_by_owner(owners: IntArray, cell_m2: float) -> dict[int, float]:
    """Square metres by owner, those that round to nought left out."""
    found, counts = np.unique(owners, return_counts=True)
    areas = np.round(counts * cell_m2, _DECIMALS)
    return {int(i): float(m2) for i, m2 in zip(found, areas, strict=True) if m2 > 0.0}
