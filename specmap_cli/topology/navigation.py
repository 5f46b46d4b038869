"""What a robot needs of a topological map: doors, a place to stand in each submap, ways between.

A person may forbid doors and links: ways keep off forbidden doors where another one is left.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.settings import WaysConfig
from specmap_cli.grids.gridmap import OCCUPIED
from specmap_cli.topology.doors import passages
from specmap_cli.topology.regions import NOBODY, Pair, Regions, Space, drawn
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
from specmap_cli.topology.ways import NO_WAY, Anchor, Way, anchors_of, ways

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
    found = passages(space, driven, config.door_min_m)
    cells = space.grid.cells_of(np.zeros((0, 2)) if stood is None else stood[:, :2])
    cells = cells[space.grid.inside(cells)]
    anchors = anchors_of(space, cells, config.robot_radius_m, PLACE_MARGIN_M)
    submaps = dict(topology.submaps)
    for id_, submap in topology.submaps.items():
        if id_ in anchors:
            place, clearance_m = space.place(np.array(anchors[id_].cell)), anchors[id_].clearance_m
            submaps[id_] = replace(submap, anchor=place, anchor_clearance_m=clearance_m)
    edges = dict(topology.edges)
    for pair in sorted({door.between for door in found.doors} | set(found.openings)):
        if pair not in edges:
            edges[pair] = edge_between(submaps, pair, kind)
    there = ways(space, anchors, edges, config.robot_radius_m)
    return replace(
        topology,
        submaps=submaps,
        edges={
            pair: _with_way(edge, there.get(pair, NO_WAY), found.doors)
            for pair, edge in edges.items()
        },
        doors=found.doors,
        robot_radius_m=config.robot_radius_m,
    )


def _with_way(edge: Edge, way: Way, doors: Iterable[Door]) -> Edge:
    """An edge with its way and those of the doors that it goes through.

    An edge without a path names all doors between its submaps: the robot is too wide for them, or
    for what is behind them.
    """
    through = [door for door in doors if door.between == (edge.source, edge.target)]
    if way.path is not None:
        met = [(crossing_of(way.path, door), door) for door in through]
        pieces = [(where[0], door.id, door) for where, door in met if where is not None]
        through = [door for *_, door in sorted(pieces, key=lambda one: one[:2])]
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

Place = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Forbidden:
    """A person forbade the way between two submaps, or the one `at` a place in the map.

    `later` are the borders made after it was said: it holds for what the submaps became.
    """

    between: Pair
    at: Place | None = None
    later: tuple[BorderEdit, ...] = ()


@dataclass(frozen=True, slots=True)
class Shut:
    """What a person's word shuts: links, and doors by their ids."""

    links: frozenset[Pair] = frozenset()
    doors: frozenset[int] = frozenset()

    def __or__(self, other: Shut) -> Shut:
        return Shut(self.links | other.links, self.doors | other.doors)


def shut_by(topology: TopologicalMap, request: Forbidden) -> Shut | str:
    """The links and doors that are meant, or why there are none.

    Without a place all of them between the two; with one the door nearest to it, or where the two
    meet in the open the link that crosses there.
    """
    one, other = (heirs(id_, request.later) for id_ in request.between)
    edges = {
        (a, b): edge
        for (a, b), edge in topology.edges.items()
        if (a in one and b in other) or (b in one and a in other)
    }
    if not edges:
        return f"there is no link between {request.between[0]} and {request.between[1]}"
    doors, place = [door for door in topology.doors if door.between in edges], request.at
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
