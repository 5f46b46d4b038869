"""Routes over a whole map: from any place to any other, through rooms and doors.

A route is the cheapest way over the free cells of submaps, as the ways of links are, but through as
many submaps as it takes. It goes through no forbidden door, and not from one submap into another
where the link between them is forbidden. Where there is none, it says why.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from specmap_cli.core.arrays import runs, unchanging
from specmap_cli.core.geometry import FloatArray, path_length
from specmap_cli.core.json_values import Point
from specmap_cli.core.records import BoolArray, IntArray
from specmap_cli.topology.navigation import crossing_of, walled
from specmap_cli.topology.regions import NOBODY, Regions, Space, borders_of
from specmap_cli.topology.topological_map import Door, Edge
from specmap_cli.topology.ways import cells_on, prices_of, straightened, tree, widest

_ASIDE_M = 1.0  # from where it stands to where there is room for it, a robot gets by itself
_TOUCH_M = 0.3  # along a way


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Route:
    """How a robot gets from one place to another; false in a condition where it does not.

    `points` (N, 2) are the corners of the route in metres of the map, from the start to the goal,
    `length_m` the metres along it, `clearance_m` the least distance that it keeps from all that is
    not free. `rooms` are the ids of the rooms that it leads through, and `doors` the doors, both in
    order. Where there is no route `why` says the reason, all else is empty, and the length
    infinite.
    """

    points: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    length_m: float = math.inf
    clearance_m: float = 0.0
    rooms: tuple[int, ...] = ()
    doors: tuple[Door, ...] = ()
    why: str = ""

    def __bool__(self) -> bool:
        return not self.why


class Roads:
    """What of a map a robot can drive on; `route` finds the way on it from place to place.

    Of a map of an earlier version nobody knows the robot's radius.
    """

    def __init__(
        self, regions: Regions, doors: Sequence[Door], edges: Iterable[Edge], radius_m: float | None
    ) -> None:
        self._doors, self._radius_m = doors, radius_m
        if radius_m is None:
            return
        self._shut = [door for door in doors if door.forbidden]
        self._apart = {(edge.source, edge.target) for edge in edges if edge.forbidden}
        self._open = self._allowed = _Ground.of(regions, radius_m)
        if self._shut or self._apart:
            sides = [door.sides for door in self._shut]
            self._allowed = _Ground.of(walled(regions, sides), radius_m)
            for border in borders_of(regions.owner) if self._apart else ():
                if border.pair in self._apart:
                    self._allowed.price[tuple(border.low.T)] = np.inf

    def route(self, start: Point, goal: Point) -> Route:
        """The cheapest route between two places of the map (x, y), metres."""
        if self._radius_m is None:
            return Route(why="nobody looked for ways when the map was made: build it again")
        ends = []
        for place in (start, goal):
            cell = self._allowed.beside(place)
            if cell is None:
                robot = f"a robot of {self._radius_m:g} m radius can stand nowhere in a room"
                return Route(why=f"{robot} within {_ASIDE_M:g} m of {place[0]:g}, {place[1]:g}")
            ends.append(cell)
        cells = self._allowed.way(*ends)
        if cells is None:
            return Route(why=self._why_none(*ends))
        points, corners = self._allowed.line(cells, start, goal)
        unchanging(points)
        legs = [cells_on(a, b) for a, b in pairwise(corners)]
        touched = np.concatenate([leg for leg, _ in legs] or [corners])
        crossed = np.concatenate([leg[lengths > 0.0] for leg, lengths in legs] or [corners])
        return Route(
            points=points,
            length_m=path_length(points),
            clearance_m=float(self._allowed.clearance[tuple(touched.T)].min()),
            rooms=_in_order(self._allowed.space, crossed),
            doors=_crossed(points, self._doors),
        )

    def _why_none(self, start: IntArray, goal: IntArray) -> str:
        """Why no way leads from one cell to another."""
        cells = self._open.way(start, goal)
        if cells is not None:
            points = self._open.space.grid.centres_of(cells)
            through = [f"door {door.id}" for door in _crossed(points, self._shut)]
            rooms = pairwise(_in_order(self._open.space, cells))
            pairs = [tuple(sorted(pair)) for pair in rooms]
            through += [f"the link {a}-{b}" for a, b in pairs if (a, b) in self._apart]
            what = ", ".join(through) or "too near to a forbidden door"
            return f"it leads through what is forbidden: {what}"
        room = np.where(self._open.space.owner == NOBODY, 0.0, self._open.clearance)
        most = widest(room, tuple(start), tuple(goal))
        if most is None:
            return "no free cells of rooms join the two"
        needed = f"a robot of {self._radius_m:g} m radius needs more"
        return f"the widest way keeps {most:.2f} m off walls, and {needed}"


@dataclass(frozen=True, slots=True)
class _Ground:
    """The cells of a map, their `clearance` and `price` (H, W), infinite where nobody can drive."""

    space: Space
    clearance: FloatArray
    price: FloatArray

    @classmethod
    def of(cls, regions: Regions, radius_m: float) -> _Ground:
        space = Space.of(regions)
        clearance = space.clearance()
        price = prices_of(clearance, radius_m)
        price[space.owner == NOBODY] = np.inf
        return cls(space, clearance, price)

    def beside(self, place: Point) -> IntArray | None:
        """The row and column nearest to a place where the robot can stand, within `_ASIDE_M`.

        In the room of the place itself, where it lies in one.
        """
        grid, owner = self.space.grid, self.space.owner
        cell = grid.cells_of(np.array([place]))
        reach = math.ceil(_ASIDE_M / grid.resolution)
        low, high = np.clip([cell[0] - reach, cell[0] + reach + 1], 0, owner.shape)
        window = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
        standing: BoolArray = np.isfinite(self.price[window])
        if grid.inside(cell)[0] and owner[tuple(cell[0])] != NOBODY:
            standing &= owner[window] == owner[tuple(cell[0])]
        cells = np.argwhere(standing) + low
        away = np.hypot(*(grid.centres_of(cells) - place).T)
        if not len(cells) or away.min() > _ASIDE_M:
            return None
        return np.asarray(cells[np.argmin(away)])

    def way(self, start: IntArray, goal: IntArray) -> IntArray | None:
        """(k, 2) the cells of the cheapest way between two cells; None for none."""
        row, column = start.tolist()
        cells = np.argwhere(np.isfinite(self.price))
        found = tree(cells, self.price[tuple(cells.T)], (row, column))
        return found.way_to(goal) if np.isfinite(found.cost_to(goal[None])[0]) else None

    def line(self, cells: IntArray, start: Point, goal: Point) -> tuple[FloatArray, IntArray]:
        """The points (n, 2) of a straightened way from place to place, and its corners (m, 2)."""
        corners, grid = straightened(cells, self.price.__getitem__), self.space.grid
        points = grid.centres_of(corners)
        first, last = (  # a place is in its cell, or aside of where the robot can stand
            [place] if math.dist(place, end) < grid.resolution else [place, end]
            for place, end in ((start, points[0].tolist()), (goal, points[-1].tolist()))
        )
        return np.array([*first, *points[1:-1].tolist(), *last[::-1]]), corners


def _in_order(space: Space, way: IntArray) -> tuple[int, ...]:
    """The submaps of the cells along a way (n, 2), each as often as it is entered.

    Where the way runs along a border it may touch the other side: that is not to enter it.
    """
    owners, brief = space.owner[tuple(way.T)], _TOUCH_M / space.grid.resolution
    stays = runs(owners)
    kept = [
        int(owners[start])
        for start, end in stays
        if end - start >= brief or start == 0 or end == len(owners)
    ]
    return tuple(kept[start] for start, _ in runs(kept))


def _crossed(points: FloatArray, doors: Sequence[Door]) -> tuple[Door, ...]:
    """The doors that a way (n, 2) goes through, in order."""
    met = [(crossing_of(points, door), door.id, door) for door in doors]
    return tuple(door for _, _, door in sorted(one for one in met if one[0] is not None))
