"""Doors: the narrow passages between submaps, driven through or only seen.

A door is where the way from one submap to its neighbour is narrower than the space on both sides.
The clearance of free cells is a landscape: rooms are its hills, doors the saddles between them.
Cells are taken from the highest level down. The level at which a hill of one submap first joins a
hill of the other is the saddle between them, and so half the width of the passage.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import BoolArray, IntArray
from specmap_cli.grids.gridmap import cell_distances
from specmap_cli.topology.regions import Border, Pair, Space, borders_of
from specmap_cli.topology.topological_map import Door, Traversal


@dataclass(frozen=True, slots=True)
class Passages:
    """How one can go from submap to submap: through `doors`, and across `openings`.

    An opening is a border without a narrow place: the space is as wide there as on one side of it.
    `openings` holds the middles (m, 2) of their cells, metres of the map, by pair.
    """

    doors: tuple[Door, ...]
    openings: Mapping[Pair, FloatArray]


def passages(
    space: Space, traversals: Mapping[Pair, Sequence[Traversal]], least_m: float
) -> Passages:
    """The doors and openings at least `least_m` wide between the submaps of a map.

    Doors are numbered by the pair of submaps, then from the lowest y on. Of the `traversals` of a
    pair each counts for the door that is nearest to it, unless an opening is nearer.
    """
    least = least_m / space.grid.resolution
    places: dict[Pair, list[Narrow]] = {}
    openings: dict[Pair, list[FloatArray]] = {}
    for border in borders_of(space.owner):
        if 2.0 * border.clearance(space.away) >= least:
            found = list(narrows(space, border, least))
            if found:
                places.setdefault(border.pair, []).extend(found)
            else:
                openings.setdefault(border.pair, []).append(_cells(space, border))
    open_borders = {pair: np.concatenate(cells) for pair, cells in openings.items()}
    doors: list[Door] = []
    for pair in sorted(places):
        mine = [_door(space, pair, place) for place in _different(places[pair])]
        mine.sort(key=lambda door: (door.y, door.x))
        doors.extend(_crossed(mine, traversals.get(pair, ()), open_borders.get(pair)))
    numbered = tuple(replace(door, id=number) for number, door in enumerate(doors))
    return Passages(numbered, open_borders)


def _cells(space: Space, border: Border) -> FloatArray:
    """(m, 2) the middles of a border's pairs of cells, metres of the map."""
    return space.grid.centres_of((border.low + border.high) / 2.0)


def _different(found: Iterable[Narrow]) -> list[Narrow]:
    """Narrow places without those that were found from another stretch of the border, too."""
    kept: list[Narrow] = []
    for place in found:
        if all(
            float(np.linalg.norm(place.middle - other.middle)) >= (place.width + other.width) / 2.0
            for other in kept
        ):
            kept.append(place)
    return kept


def _door(space: Space, pair: Pair, place: Narrow) -> Door:
    """The door at a narrow place, not yet numbered."""
    x, y = space.place(place.middle)
    theta = math.atan2(place.along[0], place.along[1])  # rows run along y, columns along x
    width_m = place.width * space.grid.resolution
    return Door(id=0, x=x, y=y, width_m=width_m, theta=theta, between=pair)


def _crossed(
    doors: Sequence[Door], traversals: Iterable[Traversal], opening: FloatArray | None
) -> list[Door]:
    """The doors of one pair with the traversals that went through them."""
    crossings: list[list[Traversal]] = [[] for _ in doors]
    for traversal in traversals:
        here = np.array([traversal.x, traversal.y])
        away = [math.dist(here, (door.x, door.y)) - door.width_m / 2.0 for door in doors]
        nearest = int(np.argmin(away))
        in_the_open = math.inf if opening is None else _distance(opening, here)
        if away[nearest] <= in_the_open:
            crossings[nearest].append(traversal)
    return [
        replace(door, crossings=tuple(mine), driven=bool(mine))
        for door, mine in zip(doors, crossings, strict=True)
    ]


def _distance(places: FloatArray, here: FloatArray) -> float:
    """Metres from a place to the nearest of some (m, 2)."""
    return float(np.linalg.norm(places - here, axis=1).min())


# Space wider than this is no narrowing any more: rooms whose border is 0.8 times as wide as they
# are count as one room, about (segmentation.merge_ratio); what is no border of rooms is no door.
_HILL = 1.25
_REACH_M = 1.5  # from a border: the half of a corridor, a step into a room
_STEP = 0.5  # cells, between the levels that are looked at first
_OPPOSITE = -0.5  # cosine between the ways to the two sides of a passage: 120 degrees and more
_EIGHT = np.ones((3, 3), dtype=np.uint8)

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
    view = _View.of(space, border)
    heights = view.heights.copy()
    while (saddle := _saddle(heights, view.is_low, view.from_border, least)) is not None:
        found = _measured(space, view, saddle)
        if found.width >= least:
            yield found
        blocked = np.ones(heights.shape, dtype=np.uint8)
        blocked[saddle.cell] = 0
        heights[cell_distances(blocked) <= saddle.height + 1.0] = 0.0


@dataclass(frozen=True, slots=True)
class _View:
    """The cells round a border: `corner` is the row and column of its first cell on the map.

    `heights` (h, w) are the cells to the nearest one that is not free, 0 for those that do not
    belong to the two submaps or hang together with the border; `is_low` those of the first one;
    `from_border` (h, w) their distance, in cells.
    """

    corner: IntArray
    heights: FloatArray
    is_low: BoolArray
    from_border: FloatArray

    @classmethod
    def of(cls, space: Space, border: Border) -> _View:
        reach = math.ceil(_REACH_M / space.grid.resolution)
        cells = np.concatenate([border.low, border.high])
        corner = np.maximum(cells.min(axis=0) - reach, 0)
        end = cells.max(axis=0) + reach + 1
        window = slice(corner[0], end[0]), slice(corner[1], end[1])
        owner = space.owner[window]
        own = tuple((cells - corner).T)
        line = np.ones(owner.shape, dtype=np.uint8)
        line[own] = 0
        from_border = cell_distances(line)
        near = np.isin(owner, border.pair) & (from_border <= reach)
        parts = _parts(near)
        joined = np.isin(parts, np.unique(parts[own]))
        heights = np.where(near & joined, space.away[window], 0.0)
        return cls(corner, heights, owner == border.pair[0], from_border)


@dataclass(frozen=True, slots=True)
class _Saddle:
    """A cell of the view between two hills, its height, and those hills (h, w)."""

    cell: tuple[int, int]
    height: float
    low: BoolArray
    high: BoolArray


def _saddle(
    heights: FloatArray, is_low: BoolArray, from_border: FloatArray, least: float
) -> _Saddle | None:
    """The highest saddle between a hill of each submap that is near enough to their border."""
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
    low: float, high: float, heights: FloatArray, is_low: BoolArray, from_border: FloatArray
) -> _Saddle | None:
    """As `_saddle`, among the saddles from one level up to another."""
    levels = np.unique(heights[(heights >= low) & (heights < high)])
    for level in levels[::-1].tolist():
        above, here = _parts(heights > level), _parts(heights >= level)
        pair = _joined(above, here, heights, is_low, _HILL * level)
        if pair is not None:
            hills = above == pair[0], above == pair[1]
            cell = _between(*hills, here == here[hills[0]][0], heights == level)
            if from_border[cell] <= 2.0 * level:
                return _Saddle(cell, level, *hills)
    return None


def _joined(
    above: Parts, here: Parts, heights: FloatArray, is_low: BoolArray, least: float
) -> tuple[int, int] | None:
    """The parts above a level that become one at it: a hill of the first submap, of the second.

    A hill is `least` high, at the least, inside its submap; of several the two highest.
    """
    count = int(above.max()) + 1
    if count < 3:
        return None
    tops = np.zeros((2, count))
    hills = heights >= least
    np.maximum.at(tops, (1 - is_low[hills].astype(np.intp), above[hills]), heights[hills])
    become = np.zeros(count, dtype=np.intp)
    become[above[above > 0]] = here[above > 0]
    best, found = 0.0, None
    for i in np.flatnonzero(tops[0]).tolist():
        for j in np.flatnonzero(tops[1] * (become == become[i])).tolist():
            if i != j and min(tops[0, i], tops[1, j]) > best:
                best, found = float(min(tops[0, i], tops[1, j])), (i, j)
    return found


def _between(low: BoolArray, high: BoolArray, part: BoolArray, level: BoolArray) -> tuple[int, int]:
    """The cell of the `level`, inside `part`, half way on the shortest way between two hills."""
    steps = np.stack([_steps(low, part), _steps(high, part)])
    cells = np.argwhere(level & part)
    of_low, of_high = steps[:, cells[:, 0], cells[:, 1]]
    best = np.lexsort([np.abs(of_low - of_high), of_low + of_high])[0]
    row, column = cells[best].tolist()
    return row, column


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


def _measured(space: Space, view: _View, saddle: _Saddle) -> Narrow:
    """The narrow place at a saddle: from the nearest wall to the nearest one on the other side."""
    cell = np.array(saddle.cell) + view.corner
    side, other = _sides(space, cell, saddle.height)
    across = (other - side) / np.linalg.norm(other - side)
    along = np.array([-across[1], across[0]])
    onward = _nearest(saddle.high, saddle.cell) - _nearest(saddle.low, saddle.cell)
    if float(np.sum(along * onward)) < 0.0:
        along = -along
    width = float(np.linalg.norm(other - side)) - 1.0 + 2.0 * space.wall_depth
    return Narrow((side + other) / 2.0, width, along)


def _sides(space: Space, cell: IntArray, height: float) -> tuple[FloatArray, FloatArray]:
    """Row and column of the cells that are not free next to a place, one on each side of it."""
    reach = math.ceil(2.0 * height) + 2
    low = np.maximum(cell - reach, 0)
    window = slice(low[0], cell[0] + reach + 1), slice(low[1], cell[1] + reach + 1)
    # what is off the map is not free; off the window, something as far off is beyond the other side
    taken = np.argwhere(np.pad(space.away[window], 1) == 0.0) + low - 1
    way = taken - cell
    length = np.sqrt(np.sum(way**2, axis=1))
    nearest = int(np.argmin(length))
    cosine = np.sum(way * way[nearest], axis=1) / (length * length[nearest])
    opposite = np.flatnonzero(cosine <= _OPPOSITE)
    other = opposite[np.argmin(length[opposite])]
    return taken[nearest].astype(np.float64), taken[other].astype(np.float64)


def _nearest(cells: BoolArray, place: tuple[int, int]) -> IntArray:
    """Row and column of the cell nearest to a place."""
    found = np.argwhere(cells)
    return np.asarray(found[np.argmin(np.sum((found - place) ** 2, axis=1))])


def _parts(cells: BoolArray) -> Parts:
    """(h, w) the number of the connected part, also across corners, of each cell; 0 for none."""
    _, parts = cv2.connectedComponents(cells.astype(np.uint8), connectivity=8)
    return np.asarray(parts, dtype=np.int32)
