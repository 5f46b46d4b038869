"""Doors: the narrow passages between submaps, driven through or only seen.

A door is where the way from one submap to its neighbour is narrower than the space on both sides.
The clearance of free cells is a landscape: rooms are its hills, doors the saddles between them.
Cells are taken from the highest level down. The level at which a hill of one submap first joins a
hill of the other is the saddle between them, and so half the width of the passage.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import BoolArray, IntArray
from specmap_cli.grids.gridmap import LengthArray, cell_distances
from specmap_cli.topology.regions import Border, Pair, Space, borders_of
from specmap_cli.topology.topological_map import Door, Traversal


def passages(
    space: Space, traversals: Mapping[Pair, Sequence[Traversal]], least_m: float
) -> tuple[tuple[Door, ...], dict[Pair, FloatArray]]:
    """The doors and openings at least `least_m` wide between the submaps of a map.

    An opening is a border without a narrow place, by the middles (m, 2) of its cells, metres. Doors
    are numbered by pair, then from the lowest y on. Of the `traversals` of a pair each counts for
    the door that is nearest to it, unless an opening is nearer.
    """
    least = least_m / space.grid.resolution
    places: dict[Pair, list[Narrow]] = {}
    open_cells: dict[Pair, list[FloatArray]] = {}
    for border in borders_of(space.owner):
        both = np.minimum(space.away[tuple(border.low.T)], space.away[tuple(border.high.T)])
        if 2.0 * float(both.max()) < least:
            continue
        found = list(narrows(space, border, least))
        if not found:
            middles = space.grid.centres_of((border.low + border.high) / 2.0)
            open_cells.setdefault(border.pair, []).append(middles)
        for place in found:  # some were found from another stretch of the border, too
            mine = places.setdefault(border.pair, [])
            if all(
                float(np.linalg.norm(place.middle - one.middle)) >= (place.width + one.width) / 2.0
                for one in mine
            ):
                mine.append(place)
    openings = {pair: np.concatenate(cells) for pair, cells in open_cells.items()}
    doors: list[Door] = []
    for pair in sorted(places):
        own, opening = [], openings.get(pair, _NO_PLACES)
        for place in places[pair]:
            x, y = space.place(place.middle)
            theta = math.atan2(place.along[0], place.along[1])  # rows run along y, columns along x
            width_m = place.width * space.grid.resolution
            own.append(Door(id=0, x=x, y=y, width_m=width_m, theta=theta, between=pair))
        own.sort(key=lambda door: (door.y, door.x))
        crossings: list[list[Traversal]] = [[] for _ in own]
        for traversal in traversals.get(pair, ()):
            here = np.array([traversal.x, traversal.y])
            away = [math.dist(here, (door.x, door.y)) - door.width_m / 2.0 for door in own]
            nearest = int(np.argmin(away))
            most = np.linalg.norm(opening - here, axis=1).min(initial=own[nearest].width_m)
            if away[nearest] <= most:
                crossings[nearest].append(traversal)
        for door, went in zip(own, crossings, strict=True):
            doors.append(replace(door, id=len(doors), crossings=tuple(went), driven=bool(went)))
    return tuple(doors), openings


# Space wider than this is no narrowing any more: rooms whose border is three quarters as wide as
# they are count as one, about (segmentation.merge_ratio); what is no border of rooms is no door.
_HILL = 1.25
_REACH_M = 1.5  # from a border: the half of a corridor, a step into a room
_STEP = 0.5  # cells, between the levels that are looked at first
_OPPOSITE = -0.5  # cosine between the ways to the two sides of a passage: 120 degrees and more
_EIGHT = np.ones((3, 3), dtype=np.uint8)
_NO_PLACES = np.zeros((0, 2))

Parts = NDArray[np.int32]


@dataclass(frozen=True, slots=True)
class Narrow:
    """A narrow place: row and column of its middle, cells from wall to wall between their sides.

    `along` is the direction (2,) of the passage, as rows and columns, from the smaller id on.
    """

    middle: FloatArray
    width: float
    along: FloatArray


def narrows(space: Space, border: Border, least: float) -> Iterator[Narrow]:
    """The narrow places at a border, at least `least` cells wide, the widest first.

    A border lies no farther from its door than the door is wide: submaps that meet in the open end
    somewhere, and a gap between chairs beyond is not their border.
    """
    reach = math.ceil(_REACH_M / space.grid.resolution)
    cells = np.concatenate([border.low, border.high])
    corner = np.maximum(cells.min(axis=0) - reach, 0)
    end = cells.max(axis=0) + reach + 1
    window = slice(corner[0], end[0]), slice(corner[1], end[1])
    owner, own = space.owner[window], tuple((cells - corner).T)
    line = np.ones(owner.shape, dtype=np.uint8)
    line[own] = 0
    from_border = cell_distances(line)
    near = np.isin(owner, border.pair) & (from_border <= reach)
    parts = _parts(near)
    joined = near & np.isin(parts, np.unique(parts[own]))  # what hangs together with the border
    heights = np.where(joined, space.away[window], 0.0)
    is_low = owner == border.pair[0]
    while (saddle := _saddle(heights, is_low, from_border, least)) is not None:
        found = _measured(space, corner, saddle)
        if found.width >= least:
            yield found
        blocked = np.ones(heights.shape, dtype=np.uint8)
        blocked[saddle.cell] = 0
        heights[cell_distances(blocked) <= saddle.height + 1.0] = 0.0


@dataclass(frozen=True, slots=True)
class _Saddle:
    """A cell of a window of the map between two hills, its height, and those hills (h, w)."""

    cell: tuple[int, int]
    height: float
    low: BoolArray
    high: BoolArray


def _saddle(
    heights: LengthArray, is_low: BoolArray, from_border: LengthArray, least: float
) -> _Saddle | None:
    """The highest saddle between a hill of each submap that is near enough to their border.

    `heights` (h, w) are the cells to the nearest one that is not free, `is_low` (h, w) which cells
    are the first submap's, `from_border` (h, w) how far they are from the border, in cells.
    """
    tops = [float(np.max(heights[side], initial=0.0)) for side in (is_low, ~is_low)]
    # steps so low that no hill is high enough for a saddle and yet vanishes in one of them
    step = min(_STEP, (_HILL - 1.0) * least / 2.0)
    above: Parts | None = None
    for level in np.arange(least / 2.0, min(tops) / _HILL + step, step)[::-1].tolist():
        here = _parts(heights >= level)
        if above is not None and _joined(above, here, heights, is_low, _HILL * level):
            saddle = _within(level, level + step, heights, is_low, from_border)
            if saddle is not None:
                return saddle
        above = here
    return None


def _within(
    low: float, high: float, heights: LengthArray, is_low: BoolArray, from_border: LengthArray
) -> _Saddle | None:
    """As `_saddle`, among the saddles from one level up to another."""
    levels = np.unique(heights[(heights >= low) & (heights < high)])
    for level in levels[::-1].tolist():
        above, here = _parts(heights > level), _parts(heights >= level)
        pair = _joined(above, here, heights, is_low, _HILL * level)
        if pair is not None:
            hills = above == pair[0], above == pair[1]
            part = here == here[hills[0]][0]
            # half way on the shortest way between the two hills
            cells = np.argwhere((heights == level) & part)
            to_low, to_high = (_steps(hill, part)[tuple(cells.T)] for hill in hills)
            best = np.lexsort([np.abs(to_low - to_high), to_low + to_high])[0]
            row, column = cells[best].tolist()
            if from_border[row, column] <= 2.0 * level:
                return _Saddle((row, column), level, *hills)
    return None


def _joined(
    above: Parts, here: Parts, heights: LengthArray, is_low: BoolArray, least: float
) -> tuple[int, int] | None:
    """The parts that become one at a level: the highest hills, `least` high, of either submap.

    A hill is of the submap that has most of it: what narrows within one submap is no passage.
    """
    count = int(above.max()) + 1
    if count < 3:
        return None
    become = np.zeros(count, dtype=np.intp)
    become[above] = here  # of what is lower the part is 0 above, and any here
    if len(np.unique(become[1:])) == count - 1:
        return None  # none has joined another
    tops, hills = np.zeros((2, count)), np.flatnonzero(heights >= least)
    own = above.ravel()[hills] + np.where(is_low.ravel()[hills], 0, count)
    np.maximum.at(tops.ravel(), own, heights.ravel()[hills])
    low, high = np.bincount(own, minlength=2 * count).reshape(2, count)
    tops[:, :] *= np.array([low >= high, high >= low])
    best, found = 0.0, None
    for i in np.flatnonzero(tops[0]).tolist():
        for j in np.flatnonzero(tops[1] * (become == become[i])).tolist():
            if i != j and min(tops[0, i], tops[1, j]) > best:
                best, found = float(min(tops[0, i], tops[1, j])), (i, j)
    return found


def _steps(start: BoolArray, part: BoolArray) -> IntArray:
    """(h, w) how many steps, also across corners, lead from `start` to each cell inside `part`."""
    reached = start.astype(np.uint8)
    inside = part.astype(np.uint8)
    steps = np.where(start, 0, np.iinfo(np.int32).max).astype(np.int64)
    for step in range(1, part.size):
        grown = np.minimum(cv2.dilate(reached, _EIGHT), inside)
        new = grown > reached
        if not new.any():
            break
        steps[new] = step
        reached = grown | reached
    return steps


def _measured(space: Space, corner: IntArray, saddle: _Saddle) -> Narrow:
    """The narrow place at a saddle in the window at `corner`: from a wall to the one opposite."""
    cell = np.array(saddle.cell) + corner
    reach = math.ceil(2.0 * saddle.height) + 2
    low = np.maximum(cell - reach, 0)
    window = slice(low[0], cell[0] + reach + 1), slice(low[1], cell[1] + reach + 1)
    # what is off the map is not free; off the window, something as far off is beyond the other side
    taken = np.argwhere(np.pad(space.away[window], 1) == 0.0) + low - 1
    way = taken - cell
    length = np.sqrt(np.sum(way**2, axis=1))
    nearest = int(np.argmin(length))
    cosine = np.sum(way * way[nearest], axis=1) / (length * length[nearest])
    opposite = np.flatnonzero(cosine <= _OPPOSITE)
    farther = opposite[np.argmin(length[opposite])]
    side, other = taken[[nearest, farther]].astype(np.float64)
    across = (other - side) / np.linalg.norm(other - side)
    along = np.array([-across[1], across[0]])
    hills = [np.argwhere(hill) for hill in (saddle.low, saddle.high)]
    start, end = (hill[np.argmin(np.sum((hill - saddle.cell) ** 2, axis=1))] for hill in hills)
    if float(np.sum(along * (end - start))) < 0.0:
        along = -along
    width = float(np.linalg.norm(other - side)) - 1.0 + 2.0 * space.wall_depth
    return Narrow((side + other) / 2.0, width, along)


def _parts(cells: BoolArray) -> Parts:
    """(h, w) the number of the connected part, also across corners, of each cell; 0 for none."""
    _, parts = cv2.connectedComponents(cells.astype(np.uint8), connectivity=8)
    return np.asarray(parts, dtype=np.int32)
