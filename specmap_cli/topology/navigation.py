"""What a robot needs of a topological map: doors, a place to stand in each submap, ways between."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import IntArray
from specmap_cli.core.settings import WaysConfig
from specmap_cli.topology.anchors import Anchor, anchors_of
from specmap_cli.topology.doors import Passages, passages
from specmap_cli.topology.regions import Regions
from specmap_cli.topology.space import Pair, Space
from specmap_cli.topology.topological_map import (
    Door,
    Edge,
    EdgeKind,
    Submap,
    TopologicalMap,
)
from specmap_cli.topology.ways import NO_WAY, Way, ways

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
    doors = _doors_of(found)
    return replace(
        topology,
        submaps={
            id_: _anchored(space, submap, anchors.get(id_))
            for id_, submap in topology.submaps.items()
        },
        edges={
            pair: with_way(edge, there.get(pair, NO_WAY), doors.get(pair, ()))
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
    new = {pair: _edge(topology, pair, kind) for pair in touching if pair not in topology.edges}
    return {**topology.edges, **new}


def _edge(topology: TopologicalMap, pair: Pair, kind: EdgeKind) -> Edge:
    """An edge between two submaps that only touch."""
    source, target = (topology.submaps[id_].map_from_submap for id_ in pair)
    return Edge(
        source=pair[0],
        target=pair[1],
        kind=kind,
        source_from_target=source.inverse() @ target,
    )


def _doors_of(found: Passages) -> dict[Pair, list[Door]]:
    """The doors between each pair of submaps."""
    doors: dict[Pair, list[Door]] = {}
    for door in found.doors:
        doors.setdefault(door.between, []).append(door)
    return doors


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
    met = [(step, door) for door in doors if (step := _step_across(path, door)) is not None]
    return [door for _, door in sorted(met, key=lambda found: (found[0], found[1].id))]


def _step_across(path: FloatArray, door: Door) -> int | None:
    """The number of the piece of a path that crosses the line of a door, None where none does."""
    door_from_map = Pose2(door.x, door.y, door.theta).inverse()
    ahead, aside = door_from_map.apply(path).T
    for step, (a, b) in enumerate(pairwise(range(len(path)))):
        if ahead[a] * ahead[b] <= 0.0 and ahead[a] != ahead[b]:
            share = ahead[a] / (ahead[a] - ahead[b])
            if abs(aside[a] + share * (aside[b] - aside[a])) <= door.width_m / 2.0:
                return step
    return None
