"""What differs between two maps in one frame: submaps, the ways between them, what stands where."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from specmap_cli.core.geometry import BentMotion, FloatArray
from specmap_cli.core.json_values import Amount, Corners, Count, Number, Value, titled
from specmap_cli.core.records import BoolArray
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap, LengthArray
from specmap_cli.topology.identity import Identity, identify
from specmap_cli.topology.regions import NOBODY, Regions, borders_of

_Cells = NDArray[np.intp]  # (n, 2) rows and columns

_DOORWAY_M = 0.5  # from a way, besides half its width: what stands there is its door
_NEAR_M = 1.0  # from a submap's floor: what stands there stands in it


@dataclass(frozen=True, slots=True, kw_only=True)
class Obstacle(Value):
    """Something that stands in one map where the other saw free space, in the smallest box.

    The submaps are those that it stands in by the old map and by the new one.
    """

    __pydantic_config__ = titled("ThingRecord")

    x: Number
    """of the middle of the box, metres"""
    y: Number
    """of the same place, metres"""
    length_m: Amount
    """the longer side of the box, metres"""
    width_m: Amount
    """the shorter side, metres"""
    area_m2: Amount
    corners: Corners  # (4, 2)
    old_submap: Count | None = None
    new_submap: Count | None = None

    @property
    def place(self) -> FloatArray:
        """(2,) its middle."""
        return np.array([self.x, self.y])


@dataclass(frozen=True, slots=True, kw_only=True)
class Crossing(Value):
    """A way between two submaps of the map in which it is open."""

    __pydantic_config__ = titled("DoorRecord")

    between: tuple[Count, Count]
    """ids of the two, the smaller one first"""
    x: Number
    """of the widest part of their border, metres"""
    y: Number
    """of the same place, metres"""
    width_m: Amount
    """the free width there, metres"""

    @property
    def place(self) -> FloatArray:
        """(2,) where it is."""
        return np.array([self.x, self.y])


@dataclass(frozen=True, slots=True, kw_only=True)
class Differences:
    """Two maps against each other; all places are in the old map.

    `closed`: ways of the old map, between its submaps, that are blocked in the new one; `opened`:
    ways of the new map, between its submaps, that were blocked. `appeared` and `vanished`: the
    obstacles of one map where the other saw free space.
    """

    identity: Identity
    closed: tuple[Crossing, ...] = ()
    opened: tuple[Crossing, ...] = ()
    appeared: tuple[Obstacle, ...] = ()
    vanished: tuple[Obstacle, ...] = ()


def differences(
    old: Regions, new: Regions, tracks: tuple[FloatArray, FloatArray], old_from_new: BentMotion
) -> Differences:
    """What differs between two divided maps; `tracks` (n, 2 or more) of the robot are theirs."""
    new_from_old = old_from_new.inverse()
    before, after = Surveyed(old.grid, tracks[0]), Surveyed(new.grid, tracks[1])
    closed = blocked_ways(old, after, new_from_old)
    opened = []
    for way in blocked_ways(new, before, old_from_new):
        x, y = old_from_new.apply(way.place[None])[0].tolist()
        opened.append(replace(way, x=x, y=y))
    vanished = obstacles_in(old.grid, after, new_from_old)
    appeared = []
    for obstacle in obstacles_in(new.grid, before, old_from_new):
        near = old_from_new.near(obstacle.place)
        x, y = near.apply(obstacle.place[None])[0].tolist()
        appeared.append(replace(obstacle, x=x, y=y, corners=near.apply(obstacle.corners)))

    def placed(obstacles: Iterable[Obstacle], ways: Sequence[Crossing]) -> tuple[Obstacle, ...]:
        """Those that are not the doors of these ways, with the submaps that they stand in."""
        return tuple(
            replace(
                obstacle,
                old_submap=_submap_at(old, obstacle.place),
                new_submap=_submap_at(new, new_from_old.apply(obstacle.place[None])[0]),
            )
            for obstacle in obstacles
            if all(
                math.dist(obstacle.place, way.place) > way.width_m / 2 + _DOORWAY_M
                or obstacle.length_m > way.width_m + 2 * _DOORWAY_M
                for way in ways
            )
        )

    return Differences(
        identity=identify(old, new, old_from_new.rigid),
        closed=tuple(closed),
        opened=tuple(opened),
        appeared=placed(appeared, closed),
        vanished=placed(vanished, opened),
    )


def _submap_at(regions: Regions, place: FloatArray) -> int | None:
    """The submap whose floor is nearest to a place (2,), if one is near."""
    cell_m = regions.grid.resolution
    row, column = regions.grid.cells_of(place[None])[0].tolist()
    reach = math.ceil(_NEAR_M / cell_m)
    top, left = max(0, row - reach), max(0, column - reach)
    window = regions.owner[top : max(0, row + reach + 1), left : max(0, column + reach + 1)]
    cells = np.argwhere(window != NOBODY)
    if not len(cells):
        return None
    away = ((cells + (top, left) - (row, column)) ** 2).sum(axis=1)
    nearest = int(away.argmin())
    return int(window[tuple(cells[nearest])]) if away[nearest] * cell_m**2 <= _NEAR_M**2 else None


# An obstacle is another one when it stands farther than this from all obstacles of the other map:
# what cells, the noise of a laser and a map that is bent a little leave open.
_APART_M, _APART_CELLS = 0.15, 2.5
_ROUNDING_M = 1e-6  # of a whole number of cells
# It must stand so deep in free space of the other map: its edge is where beams ended by chance.
_DEPTH_M, _DEPTH_CELLS = 0.12, 2.0
NEAR_M = 5.0  # farther off, half a degree and a slanting wall are more than that
_ADJOINING_CELLS = 1.5  # what hangs together with it belongs to it when it is off by more than this
_LEAST_M, _LEAST_CELLS = 0.15, 5  # a hand's breadth and its noise; single cells flicker
_GAP_M = 0.2  # between pieces of one obstacle: its faces are seen, and some of these from aside


@dataclass(frozen=True, slots=True)
class Surveyed:
    """The grid of a map, and the `track` (n, 2 or more) of the robot that saw it."""

    grid: GridMap
    track: FloatArray

    def saw_well(self, places: FloatArray) -> BoolArray:
        """(N,) whether the robot came near each place (N, 2): from afar it sees at a slant."""
        if not len(places) or not len(self.track):
            return np.zeros(len(places), dtype=np.bool_)
        away = cKDTree(self.track[:, :2]).query(places, distance_upper_bound=NEAR_M)[0]
        return np.asarray(np.isfinite(away))


def obstacles_in(grid: GridMap, survey: Surveyed, other_from_grid: BentMotion) -> list[Obstacle]:
    """The obstacles of a map where another one saw free space, the largest first."""
    cells, other = np.argwhere(grid.occupied), survey.grid
    apart_m, depth_m = other.obstacle_distance(), other.clearance()
    places = other_from_grid.apply(grid.centres_of(cells))
    placed = other.cells_of(places)
    inside = other.inside(placed)
    inside[inside] = survey.saw_well(places[inside])
    cells, (rows, columns) = cells[inside], placed[inside].T
    free = other.cells[rows, columns] == FREE
    apart = apart_m[rows, columns]
    sure = free & (apart > max(_APART_M, _APART_CELLS * other.resolution) + _ROUNDING_M)
    sure &= depth_m[rows, columns] > max(_DEPTH_M, _DEPTH_CELLS * other.resolution)
    adjoining = free & (apart > _ADJOINING_CELLS * other.resolution)
    obstacles = []
    for part in _parts(grid, cells[sure], cells[sure | adjoining]):
        points = grid.centres_of(part)
        (x, y), sides, _ = box = cv2.minAreaRect(points.astype(np.float32))
        length_m, width_m = sorted((float(side) + grid.resolution for side in sides), reverse=True)
        if length_m >= _LEAST_M:
            obstacles.append(
                Obstacle(
                    x=float(x),
                    y=float(y),
                    length_m=length_m,
                    width_m=width_m,
                    area_m2=length_m * width_m,
                    corners=np.asarray(cv2.boxPoints(box), dtype=np.float64),
                )
            )
    return sorted(obstacles, key=lambda one: (-one.length_m, one.x, one.y))


def _parts(grid: GridMap, sure: _Cells, some: _Cells) -> list[_Cells]:
    """The cells (n, 2) of each obstacle: those that are sure and `some` that hang together."""
    picture = np.zeros(grid.cells.shape, dtype=np.uint8)
    picture[tuple(some.T)] = 1
    reach = max(1, round(0.5 * _GAP_M / grid.resolution))
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    count, labels = cv2.connectedComponents(cv2.dilate(picture, kernel), connectivity=8)
    of_cell = labels[tuple(some.T)]
    known = np.bincount(labels[tuple(sure.T)], minlength=count)
    return [some[of_cell == k] for k in range(1, count) if known[k] >= _LEAST_CELLS]


def walls_in_common(grid: GridMap, other: GridMap, other_from_grid: BentMotion) -> BoolArray:
    """(H, W) which obstacles of a map stand where the other one has some, too."""
    cells = np.argwhere(grid.cells == OCCUPIED)
    placed = other_from_grid.apply(grid.centres_of(cells))
    reach_m = max(_APART_M, _APART_CELLS * other.resolution)
    near = other.under(placed, other.obstacle_distance(), np.inf) <= reach_m
    common = np.zeros(grid.cells.shape, dtype=np.bool_)
    common[tuple(cells[near].T)] = True
    return common


_WAY_M = 0.6  # of a way: through a narrower one hardly a robot goes, and noise closes it
_REACH_M = 0.6  # of a way beyond its border, besides half its width: a step into either room
_ASIDE_M = 0.25  # what lies farther than this from a border is on one side of it
_PASSABLE_M = 0.1  # from obstacles: a leaf of a door has gaps of a cell or two
_SEEN = 0.5  # share of a side that the other map must have seen


def blocked_ways(regions: Regions, survey: Surveyed, other_from_map: BentMotion) -> list[Crossing]:
    """The ways of a divided map that are blocked in another map, which saw one side at the least.

    What hides the other side must stand all across: behind a closed door nothing is seen.

    In order of the pairs of submaps, then of the places.
    """
    grid, clearance = regions.grid, regions.grid.clearance()
    away_m, blocked = survey.grid.obstacle_distance(), []
    for border in borders_of(regions.owner):
        cells = np.unique(np.concatenate([border.low, border.high]), axis=0)
        widths = clearance[tuple(cells.T)]
        width_m = 2.0 * float(widths.max())
        if width_m < _WAY_M:
            continue
        x, y = grid.centres_of(cells)[int(widths.argmax())].tolist()
        way = Crossing(between=border.pair, x=x, y=y, width_m=width_m)
        if survey.saw_well(other_from_map.apply(way.place[None]))[0]:
            around, sides = _around(regions, way, cells)
            placed = other_from_map.apply(grid.centres_of(around))
            if _is_blocked(survey.grid, away_m, placed, around, sides):
                blocked.append(way)
    return blocked


def _around(
    regions: Regions, way: Crossing, border: _Cells
) -> tuple[_Cells, tuple[BoolArray, BoolArray]]:
    """The cells (n, 2) of the two submaps round a way, and which of them are on either side."""
    reach_m = way.width_m / 2 + _REACH_M
    box = regions.grid
    low = box.cells_of((way.place - reach_m)[None])[0].clip(0)
    high = box.cells_of((way.place + reach_m)[None])[0] + 1
    window = slice(low[0], high[0]), slice(low[1], high[1])
    cells = np.argwhere(np.isin(regions.owner[window], way.between)) + low
    apart = np.ones(box.cells.shape, dtype=np.uint8)
    apart[tuple(border.T)] = 0
    away = cv2.distanceTransform(apart[window], cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    far = away[tuple((cells - low).T)] * box.resolution > _ASIDE_M
    owners = regions.owner[tuple(cells.T)]
    return cells, (far & (owners == way.between[0]), far & (owners == way.between[1]))


def _is_blocked(
    other: GridMap,
    away_m: LengthArray,
    placed: FloatArray,
    cells: _Cells,
    sides: tuple[BoolArray, BoolArray],
) -> bool:
    """Whether another map, where cells (n, 2) are `placed`, saw a side and obstacles all across."""
    values, away = other.values_at(placed), other.under(placed, away_m, 0.0)
    if not any(side.any() and np.mean(values[side] == FREE) >= _SEEN for side in sides):
        return False
    passable = ((values == FREE) & (away > _PASSABLE_M)) | (values == UNKNOWN)
    local = cells - cells.min(axis=0)
    picture = np.zeros(local.max(axis=0) + 1, dtype=np.uint8)
    picture[tuple(local[passable].T)] = 1
    _, parts = cv2.connectedComponents(picture, connectivity=4)
    one, two = (set(parts[tuple(local[side & passable].T)].tolist()) for side in sides)
    return not one & two and bool((values[~(sides[0] | sides[1])] == OCCUPIED).any())
