"""Which submap of one map is which of another, and how its border changed.

Both maps are in one frame. A submap is the same when most of its floor is: over the cells that both
maps saw, intersection over union above a half, which at most one submap of the other map can reach.
Of borders only cells that are free in both maps count: what nobody had seen before, or has not seen
since, is neither kept nor lost.
"""

from __future__ import annotations

from collections.abc import Mapping
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
    shared = _Shared.of(old, new, old_from_new)
    same = shared.same()
    old_seen = shared.old_m2 > _MOST * shared.all_old_m2
    new_seen = shared.new_m2 > _MOST * shared.all_new_m2
    floored = shared.old_floor_m2 > _MOST * shared.old_m2
    splits = _groups(shared.part_of_old * new_seen, shared.new_ids, shared.old_ids)
    merges = _groups((shared.part_of_new * old_seen[:, None]).T, shared.old_ids, shared.new_ids)
    kept_old = {pair.old for pair in same} | set(splits) | _members(merges)
    kept_new = {pair.new for pair in same} | set(merges) | _members(splits)
    return Identity(
        same=same,
        splits=splits,
        merges=merges,
        added=_chosen(shared.new_ids, ~new_seen, kept_new),
        unseen=_chosen(shared.old_ids, ~old_seen, kept_old),
        gone=_chosen(shared.old_ids, old_seen & ~floored, kept_old),
        redrawn=(
            _chosen(shared.old_ids, old_seen & floored, kept_old),
            _chosen(shared.new_ids, new_seen, kept_new),
        ),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Shared:
    """Square metres: `common` (n, m) of each old and new submap, over what both maps saw.

    `old_m2` (n,) and `new_m2` (m,) are those of each submap that the other map saw, `all_old_m2`
    and `all_new_m2` those of the whole submap; `old_floor_m2` (n,) what is free in the new map.
    """

    old_ids: tuple[int, ...]
    new_ids: tuple[int, ...]
    common: FloatArray
    old_m2: FloatArray
    new_m2: FloatArray
    all_old_m2: FloatArray
    all_new_m2: FloatArray
    old_floor_m2: FloatArray

    @classmethod
    def of(cls, old: Regions, new: Regions, old_from_new: Pose2) -> _Shared:
        """Counted on the cells of the old map."""
        old_ids, new_ids = sorted(old.outlines), sorted(new.outlines)
        cells = np.argwhere(old.grid.cells != UNKNOWN)
        places = old_from_new.inverse().apply(old.grid.centres_of(cells))
        values = new.grid.values_at(places)
        both = values != UNKNOWN
        one = _numbers(old.owner[cells[both, 0], cells[both, 1]], old_ids)
        other = _numbers(_owners_at(new, places[both]), new_ids)
        m2 = old.grid.resolution**2
        table = np.zeros((len(old_ids) + 1, len(new_ids) + 1))
        np.add.at(table, (one, other), m2)
        floor = np.zeros(len(old_ids) + 1)
        np.add.at(floor, one, m2 * (values[both] == FREE))
        return cls(
            old_ids=tuple(old_ids),
            new_ids=tuple(new_ids),
            common=table[:-1, :-1],
            old_m2=table[:-1].sum(axis=1),
            new_m2=table[:, :-1].sum(axis=0),
            all_old_m2=_areas(old, old_ids),
            all_new_m2=_areas(new, new_ids),
            old_floor_m2=floor[:-1],
        )

    @property
    def part_of_old(self) -> FloatArray:
        """(n, m) share of each new submap that lies in an old one."""
        return np.asarray(self.common / np.maximum(self.new_m2, _TINY_M2)[None, :])

    @property
    def part_of_new(self) -> FloatArray:
        """(n, m) share of each old submap that lies in a new one."""
        return np.asarray(self.common / np.maximum(self.old_m2, _TINY_M2)[:, None])

    def same(self) -> tuple[Same, ...]:
        """The pairs that cover each other by more than a half: one-to-one by themselves."""
        union = self.old_m2[:, None] + self.new_m2[None, :] - self.common
        iou = self.common / np.maximum(union, _TINY_M2)
        return tuple(
            Same(old=self.old_ids[i], new=self.new_ids[j], iou=float(iou[i, j]))
            for i, j in np.argwhere(iou > SAME).tolist()
        )


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
    part: FloatArray, members: tuple[int, ...], owners: tuple[int, ...]
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


def _chosen(ids: tuple[int, ...], wanted: NDArray[np.bool_], taken: set[int]) -> tuple[int, ...]:
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
        given=_areas_by_owner(after[was & ~now], cell_m2),
        taken=_areas_by_owner(before[now & ~was], cell_m2),
    )


def _areas_by_owner(owners: IntArray, cell_m2: float) -> dict[int, float]:
    """Square metres by owner, those that round to nought left out."""
    found, counts = np.unique(owners, return_counts=True)
    areas = np.round(counts * cell_m2, _DECIMALS)
    return {int(i): float(m2) for i, m2 in zip(found, areas, strict=True) if m2 > 0.0}
