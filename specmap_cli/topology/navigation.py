"""What a robot needs of a topological map: doors, a place to stand in each submap, ways between.

A person may forbid doors and links: ways keep off forbidden doors where another one is left.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import IntArray
from specmap_cli.core.settings import WaysConfig
from specmap_cli.grids.gridmap import OCCUPIED
from specmap_cli.topology.doors import Passages, passages
from specmap_cli.topology.regions import NOBODY, Pair, Regions, Space, drawn
from specmap_cli.topology.topological_map import (
    BorderEdit,
    Door,
    Edge,
    EdgeKind,
    Submap,
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
    drew, whose walls fill their cells. Two submaps that touch at a
    door or in the open have an edge, too, if they had none: it is of that `kind`.
    """
    space = Space.of(regions, scanned=stood is not None)
    driven = {pair: edge.traversals for pair, edge in topology.edges.items()}
    found = passages(space, driven, config.door_min_m)
    anchors = anchors_of(space, _cells(space, stood), config.robot_radius_m, PLACE_MARGIN_M)
    edges = _edges(topology, found, kind)
    there = ways(space, anchors, edges, config.robot_radius_m)
    return replace(
        topology,
        submaps={
            id_: _anchored(space, submap, anchors.get(id_))
            for id_, submap in topology.submaps.items()
        },
        edges={
            pair: with_way(edge, there.get(pair, NO_WAY), _between(found.doors, pair))
            for pair, edge in edges.items()
        },
        doors=found.doors,
        robot_radius_m=config.robot_radius_m,
    )


def _cells(space: Space, stood: FloatArray | None) -> IntArray:
    """(k, 2) the cells of the map where the robot stood."""
    if stood is None:
        return np.zeros((0, 2), dtype=np.int64)
    cells = space.grid.cells_of(stood[:, :2])
    return cells[space.grid.inside(cells)].astype(np.int64)


def _edges(topology: TopologicalMap, found: Passages, kind: EdgeKind) -> dict[Pair, Edge]:
    """The edges of a map, and new ones where two submaps touch that had none."""
    touching = sorted({door.between for door in found.doors} | set(found.openings))
    new = [pair for pair in touching if pair not in topology.edges]
    return {**topology.edges, **{pair: edge_between(topology.submaps, pair, kind) for pair in new}}


def _between(doors: Iterable[Door], pair: Pair) -> list[Door]:
    """The doors between two submaps."""
    return [door for door in doors if door.between == pair]


def _anchored(space: Space, submap: Submap, anchor: Anchor | None) -> Submap:
    """A submap with its anchor, if it has a cell to stand on."""
    if anchor is None:
        return submap
    place = space.place(np.array(anchor.cell))
    return replace(submap, anchor=place, anchor_clearance_m=anchor.clearance_m)


def with_way(edge: Edge, way: Way, doors: Sequence[Door]) -> Edge:
    """An edge with its way and the doors that it goes through.

    An edge without a path names all doors between its submaps: the robot is too wide for them, or
    for what is behind them.
    """
    through = doors if way.path is None else _through(way.path, doors)
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


def _through(path: FloatArray, doors: Sequence[Door]) -> list[Door]:
    """The doors whose lines a path (N, 2) crosses, in the order in which it does."""
    met = [(where, door) for door in doors if (where := crossing_of(path, door)) is not None]
    return [door for _, door in sorted(met, key=lambda found: (found[0][0], found[1].id))]


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
    anchors, radius_m = _anchors(topology, regions), topology.robot_radius_m
    if not pairs or radius_m is None or not anchors.keys() >= set(regions.outlines):
        return topology
    closed = [door for door in topology.doors if door.id in shut]
    open_ways = ways(Space.of(regions), anchors, pairs, radius_m)
    detours = ways(Space.of(_walled(regions, closed)), anchors, pairs, radius_m)
    edges = {
        pair: _with_either(topology, pair, open_ways[pair], detours[pair], shut) for pair in pairs
    }
    return replace(topology, edges={**topology.edges, **edges})


def _anchors(topology: TopologicalMap, regions: Regions) -> dict[int, Anchor]:
    """The anchors of the submaps, by the cells that they lie in."""
    places = {id_: each.anchor for id_, each in topology.submaps.items() if each.anchor is not None}
    cells = regions.grid.cells_of(np.array(list(places.values())).reshape(-1, 2)).tolist()
    return {
        id_: Anchor((row, column), 0.0) for id_, (row, column) in zip(places, cells, strict=True)
    }


def _walled(regions: Regions, doors: Iterable[Door]) -> Regions:
    """The regions with walls in some doors, as if there were none."""
    lines = drawn([door.sides for door in doors], regions.grid)
    cells, owner = regions.grid.cells.copy(), regions.owner.copy()
    cells[lines], owner[lines] = OCCUPIED, NOBODY
    return Regions(replace(regions.grid, cells=cells), owner, regions.outlines)


def _with_either(
    topology: TopologicalMap, pair: Pair, way: Way, detour: Way, shut: Collection[int]
) -> Edge:
    """The edge of a pair with its detour, if there is one, and the doors on it."""
    doors = _between(topology.doors, pair)
    if detour.path is None:
        return with_way(topology.edges[pair], way, doors)
    left = [door for door in doors if door.id not in shut]
    return with_way(topology.edges[pair], detour, left)


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
        pair: edge
        for pair, edge in topology.edges.items()
        if _joins(pair, one, other) or _joins(pair[::-1], one, other)
    }
    if not edges:
        return f"there is no link between {request.between[0]} and {request.between[1]}"
    doors = [door for door in topology.doors if door.between in edges]
    if request.at is None:
        return Shut(frozenset(edges), frozenset(door.id for door in doors))
    return _at(edges.values(), doors, request.at)


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


def _at(edges: Iterable[Edge], doors: Iterable[Door], place: Place) -> Shut | str:
    """The door or the open link at a place."""
    through = {(math.dist((door.x, door.y), place), door.id): door for door in doors}
    open_ = {
        (math.dist(edge.crossing, place), edge.source, edge.target): edge
        for edge in edges
        if edge.crossing is not None and not edge.doors
    }
    door, link = min(through, default=(math.inf, 0)), min(open_, default=(math.inf, 0, 0))
    if min(door[0], link[0]) > _AT_M:
        return f"no door between the two is within {_AT_M:g} m of {place[0]:g}, {place[1]:g}"
    if door[0] <= link[0]:
        return Shut(doors=frozenset({door[1]}))
    return Shut(links=frozenset({(link[1], link[2])}))


def _joins(pair: Pair, one: frozenset[int], other: frozenset[int]) -> bool:
    return pair[0] in one and pair[1] in other
