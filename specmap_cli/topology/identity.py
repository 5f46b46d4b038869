"""Which submap of one map is which of another, and its border, as it changed or a person wants it.

Both maps are in one frame. A submap is the same when most of its floor is: over the cells that both
maps saw, intersection over union above a half, which at most one submap of the other map can reach.
Of borders only cells that are free in both maps count: what nobody had seen before, or has not seen
since, is neither kept nor lost.

Merges and splits that a person wants are made in order, and undone in the opposite one: what a map
keeps of them is enough to find the submaps as they were before.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.json_values import Count, Value, runs_of, titled
from specmap_cli.core.records import IntArray, Labels
from specmap_cli.grids.gridmap import FREE, UNKNOWN, BoolArray, GridMap, Piece, flood
from specmap_cli.topology.regions import (
    NOBODY,
    OwnerArray,
    Regions,
    along_and_across,
    divide,
    drawn,
)
from specmap_cli.topology.topological_map import BorderEdit, Line, Merge, Split, bare, fences_of

SAME = 0.5  # intersection over union above which two submaps are one, and no other is
_MOST = 0.5  # share of a submap that makes it part of another, or seen

_TINY_M2 = 1e-9  # keeps submaps that nobody saw from dividing by nought


@dataclass(frozen=True, slots=True, kw_only=True)
class Same(Value):
    """A submap of either map that are one, and intersection over union of what both maps saw."""

    old: Count
    new: Count
    iou: float  # in (0.5, 1]


@dataclass(frozen=True, slots=True, kw_only=True)
class Divided(Value):
    """An old submap that is several new ones."""

    __pydantic_config__ = titled("SplitRecord")

    old: Count
    new: tuple[Count, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class United(Value):
    """Several old submaps that are one new one."""

    __pydantic_config__ = titled("MergeRecord")

    old: tuple[Count, ...]
    new: Count


@dataclass(frozen=True, slots=True, kw_only=True)
class Identity(Value):
    """What became of the submaps.

    `new`: space that the old map did not see; `unseen`: submaps that the new map did not see;
    `gone`: the new map saw their place, where there is no floor any more; `redrawn_old` and
    `redrawn_new`: what is left, whose borders are drawn elsewhere.
    """

    __pydantic_config__ = titled("SubmapsRecord")

    same: tuple[Same, ...]
    split: tuple[Divided, ...]
    merged: tuple[United, ...]
    new: tuple[Count, ...]
    unseen: tuple[Count, ...]
    gone: tuple[Count, ...]
    redrawn_old: tuple[Count, ...]
    redrawn_new: tuple[Count, ...]


def identify(old: Regions, new: Regions, old_from_new: Pose2) -> Identity:
    """Which submap of `new` is which of `old`; `old_from_new` is between their frames.

    All ids are ascending. A submap is split or merged into those that lie in it, or in which it
    lies, for the most part: two or more.
    """
    old_ids, new_ids = sorted(old.outlines), sorted(new.outlines)
    shared, floor_m2 = _shared(old, new, old_from_new)
    common, old_m2, new_m2 = shared[:-1, :-1], shared[:-1].sum(axis=1), shared[:, :-1].sum(axis=0)
    iou = common / np.maximum(old_m2[:, None] + new_m2[None, :] - common, _TINY_M2)
    same = tuple(
        Same(old=old_ids[i], new=new_ids[j], iou=float(iou[i, j]))
        for i, j in np.argwhere(iou > SAME).tolist()
    )
    old_seen, new_seen = old_m2 > _MOST * _areas(old), new_m2 > _MOST * _areas(new)
    floored = floor_m2 > _MOST * old_m2
    part_of_old = common / np.maximum(new_m2, _TINY_M2)[None, :]
    part_of_new = common / np.maximum(old_m2, _TINY_M2)[:, None]
    split = _groups(part_of_old * new_seen, new_ids, old_ids)
    merged = _groups((part_of_new * old_seen[:, None]).T, old_ids, new_ids)
    kept_old = {one.old for one in same} | split.keys() | set(chain.from_iterable(merged.values()))
    kept_new = {one.new for one in same} | merged.keys() | set(chain.from_iterable(split.values()))
    return Identity(
        same=same,
        split=tuple(Divided(old=whole, new=parts) for whole, parts in split.items()),
        merged=tuple(United(old=parts, new=whole) for whole, parts in merged.items()),
        new=_chosen(new_ids, ~new_seen, kept_new),
        unseen=_chosen(old_ids, ~old_seen, kept_old),
        gone=_chosen(old_ids, old_seen & ~floored, kept_old),
        redrawn_old=_chosen(old_ids, old_seen & floored, kept_old),
        redrawn_new=_chosen(new_ids, new_seen, kept_new),
    )


def _shared(old: Regions, new: Regions, old_from_new: Pose2) -> tuple[FloatArray, FloatArray]:
    """(n + 1, m + 1) square metres of each old and new submap, the last for nobody, over what both
    maps saw; and (n,) how much of the old ones is free in the new map. Cells are the old map's.
    """
    cells = np.argwhere(old.grid.cells != UNKNOWN)
    places = old_from_new.inverse().apply(old.grid.centres_of(cells))
    values = new.grid.values_at(places)
    both = values != UNKNOWN
    one = _numbers(old, cells[both])
    other = _numbers(new, new.grid.cells_of(places[both]))
    m2 = old.grid.resolution**2
    shared = np.zeros((len(old.outlines) + 1, len(new.outlines) + 1))
    np.add.at(shared, (one, other), m2)
    floor = np.zeros(len(shared))
    np.add.at(floor, one, m2 * (values[both] == FREE))
    return shared, floor[:-1]


def _numbers(regions: Regions, cells: NDArray[np.intp]) -> NDArray[np.intp]:
    """(N,) the place of each cell's submap among all, ascending; their count for nobody."""
    ids, owners = sorted(regions.outlines), regions.owner[tuple(cells.T)]
    if not ids:
        return np.zeros(len(owners), dtype=np.intp)
    places = np.searchsorted(ids, owners).clip(0, len(ids) - 1)
    return np.where(np.asarray(ids)[places] == owners, places, len(ids))


def _areas(regions: Regions) -> FloatArray:
    """(n,) square metres of each submap, ascending."""
    counts = np.bincount(regions.owner[regions.owner != NOBODY].ravel(), minlength=1)
    areas = [counts[id_] for id_ in sorted(regions.outlines)]
    return np.array(areas, dtype=np.float64) * regions.grid.resolution**2


def _groups(
    part: FloatArray, members: Sequence[int], owners: Sequence[int]
) -> dict[int, tuple[int, ...]]:
    """The members, two or more, that lie in each owner by `part` (owner, member) above a half."""
    inside = {
        owner: tuple(m for m, share in zip(members, row, strict=True) if share > _MOST)
        for owner, row in zip(owners, part.tolist(), strict=True)
    }
    return {owner: group for owner, group in inside.items() if len(group) > 1}


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
    before = old.owner[tuple(cells[both].T)]
    after = new.owner[tuple(new.grid.cells_of(places[both]).T)]
    cell_m2 = old.grid.resolution**2
    changes = []
    for submap in sorted(old.outlines):
        was, now = before == submap, after == submap
        shared, either = np.count_nonzero(was & now), np.count_nonzero(was | now)
        changes.append(
            BorderChange(
                submap=submap,
                iou=int(shared) / max(1, int(either)),
                was_m2=float(np.count_nonzero(was)) * cell_m2,
                given=_areas_by_owner(after[was & ~now], cell_m2),
                taken=_areas_by_owner(before[now & ~was], cell_m2),
            )
        )
    return tuple(changes)


def _areas_by_owner(owners: OwnerArray, cell_m2: float) -> dict[int, float]:
    """Square metres by owner, those that round to nought left out."""
    found, counts = np.unique(owners, return_counts=True)
    areas = np.round(counts * cell_m2, _DECIMALS)
    return {int(i): float(m2) for i, m2 in zip(found, areas, strict=True) if m2 > 0.0}


@dataclass(frozen=True, slots=True)
class Redrawn:
    """Keyframes after all borders that could be made: `submaps` (n,) and the `borders` made.

    `skipped` says, by place in the list that was requested, why the others could not.
    """

    submaps: IntArray
    borders: tuple[BorderEdit, ...]
    next_id: int
    skipped: Mapping[int, str] = field(default_factory=dict)


def redrawn(
    whole: GridMap,
    labels: Labels,
    borders: Sequence[BorderEdit],
    requested: Sequence[BorderEdit],
    next_id: int,
    rooms: Collection[Piece] | None = None,
) -> Redrawn:
    """Make the borders that are `requested`, in order, instead of those that the labels have.

    What has not changed keeps its keyframes. `next_id` and what follows it are ids that no submap
    ever had: splits without an id get one of these. A submap ends where its `rooms` do, as in
    `divide`.
    """
    if [bare(border) for border in borders] == list(requested):
        return Redrawn(labels.submaps, tuple(borders), next_id)
    before = undone(whole, labels, borders)
    taken = [border.new for border in requested if isinstance(border, Split)]
    free = max([next_id, *(1 + new for new in taken if new is not None)])
    state = Redrawn(before, (), free)
    for place, border in enumerate(requested):
        made = _made(whole, labels, state, border, rooms)
        if isinstance(made, str):
            state = replace(state, skipped={**state.skipped, place: made})
        else:
            state = made
    if [bare(border) for border in borders] == [bare(border) for border in state.borders]:
        return replace(state, submaps=labels.submaps, borders=tuple(borders))
    return state


def undone(whole: GridMap, labels: Labels, borders: Sequence[BorderEdit]) -> IntArray:
    """The submap (n,) of each keyframe before the `borders` were made; `whole` is the map's grid.

    Keyframes that came after a merge go to the submap of the keyframe nearest to them on foot.
    """
    before, poses = labels.submaps.copy(), labels.poses
    number = np.arange(len(before))
    for border in reversed(borders):
        if isinstance(border, Split):
            before[before == border.new] = border.submap
            continue
        later = np.flatnonzero((number >= border.known) & (before == border.kept))
        came = np.array(border.keyframes, dtype=np.int64)
        before[came[before[came] == border.kept]] = border.gone
        both = np.isin(before, (border.kept, border.gone))
        own = np.flatnonzero((number < border.known) & both)
        if len(later) and len(own):
            before[later] = _on_foot(whole, poses[own], before[own], poses[later])
    return before


def carried(
    borders: Sequence[BorderEdit], whole: GridMap, old: FloatArray, new: FloatArray
) -> tuple[BorderEdit, ...]:
    """The borders of a map with keyframes `old` (n, 3) for one of `new` (m, 3) in the same frame.

    What came with a merge is what is nearest to the old keyframes that came with it, on foot in
    `whole`, the grid of the old map.
    """

    def came(border: Merge) -> IntArray:
        """The numbers of the new keyframes that came with a merge."""
        with_it = np.isin(np.arange(len(old)), border.keyframes).astype(np.int64)
        return np.flatnonzero(_on_foot(whole, old, with_it, new))

    return tuple(
        border
        if isinstance(border, Split)
        else replace(border, runs=runs_of(came(border).tolist()), known=len(new))
        for border in borders
    )


def _on_foot(grid: GridMap, poses: FloatArray, submaps: IntArray, places: FloatArray) -> IntArray:
    """(m,) the submap of the keyframe nearest to each of `places` (m, 3) on foot.

    The keyframes stood at `poses` (n, 3) in `submaps` (n,). Where none of them can be reached, the
    one on the shortest line counts.
    """
    known = Labels(stamps_ns=np.zeros(len(poses), dtype=np.int64), poses=poses, submaps=submaps)
    found = divide(grid, known).owners(places)
    nearest = submaps[cKDTree(poses[:, :2]).query(places[:, :2])[1]]
    return np.where(found == NOBODY, nearest, found)


def _made(
    whole: GridMap,
    labels: Labels,
    state: Redrawn,
    border: BorderEdit,
    rooms: Collection[Piece] | None,
) -> Redrawn | str:
    """The keyframes with one border more, or why it cannot be made."""
    for id_ in (border.kept, border.gone) if isinstance(border, Merge) else (border.submap,):
        if not (state.submaps == id_).any():
            return f"there is no submap {id_}"
    submaps, next_id = state.submaps.copy(), state.next_id
    made: BorderEdit
    if isinstance(border, Merge):
        moved, owner = np.flatnonzero(submaps == border.gone), border.kept
        made = replace(border, runs=runs_of(moved.tolist()), known=len(submaps))
    else:
        own = np.flatnonzero(submaps == border.submap)
        owner = next_id if border.new is None else border.new
        if (submaps == owner).any():
            return f"submap {owner} exists already"
        divided = replace(labels, submaps=submaps)
        regions = divide(whole, divided, fences_of(state.borders), rooms)
        mine = regions.owner == border.submap
        fence = fence_of(mine, whole, border.line)
        if fence is None:
            return f"the line does not cross submap {border.submap}"
        right = is_right_of(fence, mine, whole, labels.poses[own])
        if right.all() or not right.any():
            return f"the robot was on one side of the line only in submap {border.submap}"
        moved, next_id = own[right], max(next_id, 1 + owner)
        made = replace(border, new=owner, fence=fence)
    submaps[moved] = owner
    return replace(state, submaps=submaps, borders=(*state.borders, made), next_id=next_id)


_STEP = 0.5  # cells: no cell is passed over, but for its corner
_BESIDE = 2.0  # cells: so near to a line a place is on one side of it for sure
_LEFT, _RIGHT = 1, 2


def fence_of(mine: BoolArray, grid: GridMap, line: Line) -> Line | None:
    """The line from border to border of the cells `mine` (H, W); None where it crosses none.

    An end that lies in them is moved on until it does not; one outside stays.
    """
    if not (mine & drawn([line], grid)).any():
        return None
    start, end = np.array(line[0]), np.array(line[1])
    step = (end - start) / np.hypot(*(end - start)) * _STEP * grid.resolution
    return _moved_on(mine, grid, start, -step), _moved_on(mine, grid, end, step)


def is_right_of(fence: Line, mine: BoolArray, grid: GridMap, places: FloatArray) -> BoolArray:
    """(n,) whether each place (n, 2 or more) is right of a fence across the cells `mine` (H, W).

    A place is on the side from which one comes to it first on foot, without crossing the fence; one
    that is out of reach is on its side of the straight line.
    """
    beyond = mine & ~drawn([fence], grid)
    along, across, length = along_and_across(grid.centres_of(np.argwhere(beyond)), fence)
    near = (np.abs(across) <= _BESIDE * grid.resolution) & (along >= 0.0) & (along <= length)
    markers = np.zeros(mine.shape, dtype=np.int16)
    markers[beyond] = np.where(near, np.where(across < 0.0, _RIGHT, _LEFT), 0)
    sides = flood(beyond, markers)
    sides[sides == 0] = NOBODY
    found = Regions(grid, sides, {}).owners(places)
    along, across, _ = along_and_across(places[:, :2], fence)
    close = (np.abs(across) <= _BESIDE * grid.resolution) & (along >= 0.0) & (along <= length)
    return np.where(close | (found == NOBODY), across < 0.0, found == _RIGHT)


def _moved_on(
    mine: BoolArray, grid: GridMap, place: FloatArray, step: FloatArray
) -> tuple[float, float]:
    """The first place of a way in equal steps that is not in the cells `mine`."""
    steps = round(2.0 * sum(mine.shape) / _STEP)  # beyond the edge of the grid
    way = place + step * np.arange(steps)[:, None]
    x, y = way[int(np.argmin(grid.under(way, mine, False)))].tolist()
    return x, y
