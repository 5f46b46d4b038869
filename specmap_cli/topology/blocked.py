"""Ways between submaps that are open in one map and blocked in another one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import BoolArray
from specmap_cli.grids.bent import BentMotion
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from specmap_cli.topology.regions import Regions
from specmap_cli.topology.space import borders_of
from specmap_cli.topology.things import Surveyed

_LEAST_M = 0.6  # of a way: through a narrower one hardly a robot goes, and noise closes it
_REACH_M = 0.6  # of a way beyond its border, besides half its width: a step into either room
_APART_M = 0.25  # what lies farther than this from a border is on one side of it
_PASSABLE_M = 0.1  # from obstacles: a leaf of a door has gaps of a cell or two
_SEEN = 0.5  # share of a side that the other map must have seen

_Cells = NDArray[np.intp]


@dataclass(frozen=True, slots=True, kw_only=True)
class Crossing:
    """Where two submaps of a map meet, `between` the smaller id and the larger.

    `place` (2,) is the widest part of their border in that map, `width_m` the free width there.
    """

    between: tuple[int, int]
    place: FloatArray
    width_m: float


def blocked_ways(regions: Regions, seen: Surveyed, other_from_map: BentMotion) -> list[Crossing]:
    """The ways of a divided map that are blocked in another map, which saw one side at the least.

    What hides the other side must stand all across: behind a closed door nothing is seen.

    In order of the pairs of submaps, then of the places.
    """
    other = seen.grid, seen.grid.obstacle_distance()
    return [
        way
        for way, border in _ways(regions)
        if seen.saw_well(other_from_map.apply(way.place[None]))[0]
        and _is_blocked(regions, way, border, other, other_from_map)
    ]


def _ways(regions: Regions) -> Iterator[tuple[Crossing, FloatArray]]:
    """Each way with the cells (n, 2) of its border, metres of the map."""
    grid, clearance = regions.grid, regions.grid.clearance()
    for border in borders_of(regions.owner):
        cells = np.unique(np.concatenate([border.low, border.high]), axis=0)
        widths = clearance[tuple(cells.T)]
        width_m = 2.0 * float(widths.max())
        if width_m >= _LEAST_M:
            places = grid.centres_of(cells)
            widest = places[int(widths.argmax())]
            yield Crossing(between=border.pair, place=widest, width_m=width_m), places


def _is_blocked(
    regions: Regions,
    way: Crossing,
    border: FloatArray,
    other: tuple[GridMap, FloatArray],
    other_from_map: BentMotion,
) -> bool:
    """Whether the other map saw a side of a way, and something all across it."""
    grid, near_m = other
    cells, shape, sides = _around(regions, way, border)
    placed = grid.cells_of(other_from_map.apply(regions.grid.centres_of(cells)))
    inside = grid.inside(placed)
    values = np.full(len(cells), UNKNOWN, dtype=np.uint8)
    away = np.zeros(len(cells))
    rows, columns = placed[inside].T
    values[inside], away[inside] = grid.cells[rows, columns], near_m[rows, columns]
    free = (values == FREE) & (away > _PASSABLE_M)
    unknown = values == UNKNOWN
    low = cells.min(axis=0)
    if not any(side.any() and np.mean(values[side] == FREE) >= _SEEN for side in sides):
        return False
    return not _connects(cells - low, shape, free | unknown, sides) and bool(
        (values[~(sides[0] | sides[1])] == OCCUPIED).any()
    )


def _around(
    regions: Regions, way: Crossing, border: FloatArray
) -> tuple[_Cells, tuple[int, int], tuple[BoolArray, BoolArray]]:
    """The cells (n, 2) of the two submaps round a way, how many rows and columns they span, and
    which of them are on either side of it.
    """
    reach_m = way.width_m / 2 + _REACH_M
    box = regions.grid
    low = box.cells_of((way.place - reach_m)[None])[0].clip(0)
    high = box.cells_of((way.place + reach_m)[None])[0] + 1
    window = regions.owner[low[0] : high[0], low[1] : high[1]]
    cells = np.argwhere(np.isin(window, way.between)) + low
    owners = regions.owner[tuple(cells.T)]
    away = np.full(box.cells.shape, 1, dtype=np.uint8)
    away[tuple(box.cells_of(border).T)] = 0
    window_away = cv2.distanceTransform(
        away[low[0] : high[0], low[1] : high[1]], cv2.DIST_L2, cv2.DIST_MASK_PRECISE
    )
    far = window_away[tuple((cells - low).T)] * box.resolution > _APART_M
    sides = far & (owners == way.between[0]), far & (owners == way.between[1])
    span = cells.max(axis=0) - cells.min(axis=0) + 1
    return cells, (int(span[0]), int(span[1])), sides


def _connects(
    cells: _Cells, shape: tuple[int, int], passable: BoolArray, sides: tuple[BoolArray, BoolArray]
) -> bool:
    """Whether one can go from one side to the other through cells (n, 2) that are passable (n,)."""
    picture = np.zeros(shape, dtype=np.uint8)
    picture[tuple(cells[passable].T)] = 1
    _, labels = cv2.connectedComponents(picture, connectivity=4)
    one, other = (set(labels[tuple(cells[side & passable].T)].tolist()) for side in sides)
    return bool(one & other)
