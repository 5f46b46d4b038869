"""Ways that keep off forbidden doors where another door, or an open border, is left."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import replace

import numpy as np

from specmap_cli.grids.gridmap import OCCUPIED
from specmap_cli.topology.anchors import Anchor
from specmap_cli.topology.flooding import drawn
from specmap_cli.topology.navigation import with_way
from specmap_cli.topology.regions import NOBODY, Regions
from specmap_cli.topology.space import Pair, Space
from specmap_cli.topology.topological_map import Door, Edge, TopologicalMap
from specmap_cli.topology.ways import Way, ways


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
    doors = [door for door in topology.doors if door.between == pair]
    if detour.path is None:
        return with_way(topology.edges[pair], way, doors)
    left = [door for door in doors if door.id not in shut]
    return with_way(topology.edges[pair], detour, left)
