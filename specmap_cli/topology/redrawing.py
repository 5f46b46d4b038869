"""Submaps with the borders that a person wants: merges and splits made, and undone.

They are made in order, and undone in the opposite one: what a map keeps of them is enough to find
the submaps as they were before.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial import cKDTree

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.json_values import runs_of
from specmap_cli.core.records import IntArray, Labels
from specmap_cli.grids.gridmap import BoolArray, GridMap
from specmap_cli.topology.regions import NOBODY, Regions, along_and_across, divide, drawn, flood
from specmap_cli.topology.topological_map import BorderEdit, Line, Merge, Split, bare, fences_of


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
    unentered: BoolArray | None = None,
) -> Redrawn:
    """Make the borders that are `requested`, in order, instead of those that the labels have.

    What has not changed keeps its keyframes. `next_id` and what follows it are ids that no submap
    ever had: splits without an id get one of these. Rooms that are `unentered` (H, W) are in no
    submap that could be split.
    """
    if [bare(border) for border in borders] == list(requested):
        return Redrawn(labels.submaps, tuple(borders), next_id)
    before = undone(labels.submaps, labels.poses, borders)
    taken = [border.new for border in requested if isinstance(border, Split)]
    free = max([next_id, *(1 + new for new in taken if new is not None)])
    state = Redrawn(before, (), free)
    for place, border in enumerate(requested):
        made = _made(whole, labels, state, border, unentered)
        if isinstance(made, str):
            state = replace(state, skipped={**state.skipped, place: made})
        else:
            state = made
    if [bare(border) for border in borders] == [bare(border) for border in state.borders]:
        return replace(state, submaps=labels.submaps, borders=tuple(borders))
    return state


def undone(submaps: IntArray, poses: FloatArray, borders: Sequence[BorderEdit]) -> IntArray:
    """The submap (n,) of each keyframe before the `borders` were made; `poses` (n, 3).

    Keyframes that came after a merge go to the submap of the keyframe nearest to them.
    """
    before, number = submaps.copy(), np.arange(len(submaps))
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
            nearest = cKDTree(poses[own, :2]).query(poses[later, :2])[1]
            before[later] = before[own[nearest]]
    return before


def carried(
    borders: Sequence[BorderEdit], old: FloatArray, new: FloatArray
) -> tuple[BorderEdit, ...]:
    """The borders of a map with keyframes `old` (n, 3) for one of `new` (m, 3) in the same frame.

    What came with a merge is what is nearest to the old keyframes that came with it.
    """
    nearest = cKDTree(old[:, :2]).query(new[:, :2])[1]
    return tuple(
        border
        if isinstance(border, Split)
        else replace(
            border,
            runs=runs_of(np.flatnonzero(np.isin(nearest, border.keyframes)).tolist()),
            known=len(new),
        )
        for border in borders
    )


def _made(
    whole: GridMap,
    labels: Labels,
    state: Redrawn,
    border: BorderEdit,
    unentered: BoolArray | None,
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
        regions = divide(whole, divided, fences_of(state.borders), unentered)
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
    barrier = drawn([fence], grid)
    along, across, length = along_and_across(grid.centres_of(np.argwhere(mine)), fence)
    near = (np.abs(across) <= _BESIDE * grid.resolution) & (along >= 0.0) & (along <= length)
    markers = np.zeros(mine.shape, dtype=np.int32)
    markers[mine] = np.where(near, np.where(across < 0.0, _RIGHT, _LEFT), 0)
    markers[barrier] = 0
    sides = flood(mine, markers, barrier)
    sides[~mine | (sides < _LEFT)] = NOBODY
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
    cells = grid.cells_of(way)
    inside = grid.inside(cells)
    held = np.zeros(len(way), dtype=np.bool_)
    held[inside] = mine[tuple(cells[inside].T)]
    x, y = way[int(np.argmin(held))].tolist()
    return x, y
