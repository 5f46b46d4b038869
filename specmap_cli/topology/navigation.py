"""What a robot needs of a topological map: doors, places to stand, ways between, routes over all.

A person may forbid doors and links: ways keep off forbidden doors where another one is left. A
route is the cheapest way through as many submaps as it takes; it goes through no forbidden door,
and not from one submap into another where the link between them is forbidden.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from specmap_cli.core.arrays import runs, unchanging
from specmap_cli.core.geometry import FloatArray, Pose2, path_length
from specmap_cli.core.json_values import Point
from specmap_cli.core.records import BoolArray, IntArray
from specmap_cli.core.settings import WaysConfig
from specmap_cli.grids.gridmap import OCCUPIED
from specmap_cli.topology.doors import passages
from specmap_cli.topology.regions import NOBODY, Pair, Regions, Space, borders_of, drawn
from specmap_cli.topology.topological_map import (
    BorderEdit,
    Door,
    Edge,
    EdgeKind,
    Line,
    TopologicalMap,
    edge_between,
    heirs,
)
from specmap_cli.topology.ways import (
    Anchor,
    Way,
    anchors_of,
    cells_on,
    prices_of,
    straightened,
    tree,
    ways,
    widest,
)

PLACE_MARGIN_M = 0.1  # a place to stand is so much farther from walls than the robot's radius


def with_ways(
    topology: TopologicalMap,
    regions: Regions,
    config: WaysConfig,
    stood: FloatArray | None = None,
    kind: EdgeKind = "seen",
) -> TopologicalMap:
    """The map with its doors, an anchor for each submap, and a way for each edge.

    `stood` (n, 2 or more) are places where the robot was, in the map; None for a map that somebody
    drew, whose walls fill their cells. Two submaps that touch at a door or in the open have an
    edge, too, if they had none: it is of that `kind`.
    """
    space = Space.of(regions, scanned=stood is not None)
    driven = {pair: edge.traversals for pair, edge in topology.edges.items()}
    doors, openings = passages(space, driven, config.door_min_m)
    cells = space.grid.cells_of(np.zeros((0, 2)) if stood is None else stood[:, :2])
    cells = cells[space.grid.inside(cells)]
    anchors = anchors_of(space, cells, config.robot_radius_m, PLACE_MARGIN_M, doors)
    submaps = dict(topology.submaps)
    for id_, submap in topology.submaps.items():
        if id_ in anchors:
            place, clearance_m = space.place(np.array(anchors[id_].cell)), anchors[id_].clearance_m
            submaps[id_] = replace(submap, anchor=place, anchor_clearance_m=clearance_m)
    edges = dict(topology.edges)
    for pair in sorted({door.between for door in doors} | openings.keys()):
        if pair not in edges:
            edges[pair] = edge_between(submaps, pair, kind)
    there = ways(space, anchors, edges, config.robot_radius_m)
    return replace(
        topology,
        submaps=submaps,
        edges={pair: _with_way(edge, there[pair], doors) for pair, edge in edges.items()},
        doors=doors,
        robot_radius_m=config.robot_radius_m,
    )


def _with_way(edge: Edge, way: Way, doors: Iterable[Door]) -> Edge:
    """An edge with its way and the doors on it; without a path all doors between its submaps."""
    through = [door for door in doors if door.between == (edge.source, edge.target)]
    if way.path is not None:
        through = [*_crossed(way.path, through)]
    first = through[0] if through else None
    return replace(
        edge,
        x=None if first is None else first.x,
        y=None if first is None else first.y,
        width_m=None if first is None else first.width_m,
        doors=tuple(door.id for door in through),
        path=way.path,
        length_m=way.length_m,
        clearance_m=way.clearance_m,
    )


def crossing_of(path: FloatArray, door: Door) -> tuple[int, float] | None:
    """The piece of a path (N, 2) that crosses the line of a door, and the share of it before that.

    None where it does not cross.
    """
    door_from_map = Pose2(door.x, door.y, door.theta).inverse()
    ahead, aside = door_from_map.apply(path).T
    for step, (a, b) in enumerate(pairwise(range(len(path)))):
        if ahead[a] * ahead[b] <= 0.0 and ahead[a] != ahead[b]:
            share = ahead[a] / (ahead[a] - ahead[b])
            if abs(aside[a] + share * (aside[b] - aside[a])) <= door.width_m / 2.0:
                return step, float(share)
    return None


def with_detours(
    topology: TopologicalMap, regions: Regions, shut: Collection[int]
) -> TopologicalMap:
    """The map with ways through none of the doors that are `shut`, by their ids, where there are.

    Where no such way is left, or a door is open again, the way is the one through any door.
    """
    changed = [door for door in topology.doors if door.forbidden or door.id in shut]
    pairs = {door.between for door in changed} & topology.edges.keys()
    places = {id_: each.anchor for id_, each in topology.submaps.items() if each.anchor is not None}
    grid, radius_m = regions.grid, topology.robot_radius_m
    if not pairs or radius_m is None or not places.keys() >= set(regions.outlines):
        return topology
    rows = grid.cells_of(np.array(list(places.values())).reshape(-1, 2)).tolist()
    anchors = {
        id_: Anchor((row, column), 0.0) for id_, (row, column) in zip(places, rows, strict=True)
    }
    open_ways = ways(Space.of(regions), anchors, pairs, radius_m)
    closed = walled(regions, [door.sides for door in topology.doors if door.id in shut])
    detours = ways(Space.of(closed), anchors, pairs, radius_m)
    left = [door for door in topology.doors if door.id not in shut]
    edges = dict(topology.edges)
    for pair in pairs:
        if detours[pair].path is None:
            edges[pair] = _with_way(edges[pair], open_ways[pair], topology.doors)
        else:
            edges[pair] = _with_way(edges[pair], detours[pair], left)
    return replace(topology, edges=edges)


def walled(regions: Regions, lines: Iterable[Line]) -> Regions:
    """The regions with walls along some lines of the map."""
    walls = drawn(lines, regions.grid)
    cells = np.where(walls, np.uint8(OCCUPIED), regions.grid.cells)
    owner = np.where(walls, NOBODY, regions.owner)
    return Regions(replace(regions.grid, cells=cells), owner, regions.outlines)


def is_way(edge: Edge) -> bool:
    """Whether a robot can and may drive along a link."""
    return edge.path is not None and len(edge.path) > 1 and not edge.forbidden


def parts(ids: Iterable[int], edges: Iterable[Edge]) -> list[list[int]]:
    """Submap ids by the parts that ways join, the largest first, then the one with the least id."""
    import networkx as nx  # slow to load: whoever asks for a place need not wait for it

    graph = nx.Graph()
    graph.add_nodes_from(ids)
    graph.add_edges_from((edge.source, edge.target) for edge in edges if is_way(edge))
    found = [sorted(part) for part in nx.connected_components(graph)]
    return sorted(found, key=lambda part: (-len(part), part))


_AT_M = 2.0  # a person who points at a door points beside it


@dataclass(frozen=True, slots=True)
class Shut:
    """What a person's word shuts: links, and doors by their ids."""

    links: frozenset[Pair] = frozenset()
    doors: frozenset[int] = frozenset()

    def __or__(self, other: Shut) -> Shut:
        return Shut(self.links | other.links, self.doors | other.doors)


def shut_by(
    topology: TopologicalMap, between: Pair, place: Point | None, later: Iterable[BorderEdit]
) -> Shut | str:
    """The links and doors that a person means who forbade the way between two submaps, or why none.

    Without a place all of them between the two; with one the door nearest to it, or where the two
    meet in the open the link that crosses there. The word holds for what the submaps became by the
    borders that were made `later`.
    """
    one, other = (heirs(id_, later) for id_ in between)
    edges = {
        (a, b): edge
        for (a, b), edge in topology.edges.items()
        if (a in one and b in other) or (b in one and a in other)
    }
    if not edges:
        return f"there is no link between {between[0]} and {between[1]}"
    doors = [door for door in topology.doors if door.between in edges]
    if place is None:
        return Shut(frozenset(edges), frozenset(door.id for door in doors))
    in_the_open = [
        (math.dist(edge.crossing, place), pair)
        for pair, edge in edges.items()
        if edge.crossing is not None and not edge.doors
    ]
    through = [(math.dist((door.x, door.y), place), door.id) for door in doors]
    door_m, door = min(through, default=(math.inf, 0))
    link_m, link = min(in_the_open, default=(math.inf, (0, 0)))
    if min(door_m, link_m) > _AT_M:
        return f"no door between the two is within {_AT_M:g} m of {place[0]:g}, {place[1]:g}"
    if door_m <= link_m:
        return Shut(doors=frozenset({door}))
    return Shut(links=frozenset({link}))


def with_shut(topology: TopologicalMap, shut: Shut) -> TopologicalMap:
    """The map in which these links and doors are forbidden, and no others.

    A link is forbidden, too, when its way leads through a forbidden door: see `with_detours`.
    """
    return replace(
        topology,
        edges={
            pair: replace(edge, forbidden=pair in shut.links or bool(shut.doors & {*edge.doors}))
            for pair, edge in topology.edges.items()
        },
        doors=tuple(replace(door, forbidden=door.id in shut.doors) for door in topology.doors),
    )


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
        """The cell, in the room of a place, nearest to it where the robot can stand; or None."""
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
    """The submaps of cells along a way (n, 2), as often as entered; brief touches do not count."""
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
