"""The graph that a robot drives: stops joined by straight legs, which run along the ways of a map.

Stops stand at the anchors of submaps, where ways go through doors, and where they bend: so each
leg is a straight line through free cells, and the legs of a way are as long as the way. Links
without a way and forbidden ones have no legs. A stop belongs to one way, an anchor to all of its
submap.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import count, pairwise
from typing import Literal

import networkx as nx
import numpy as np

from specmap_cli.core.geometry import FloatArray
from specmap_cli.maps.schema import TopologyRecord
from specmap_cli.topology.topological_map import Door, Edge

StopKind = Literal["anchor", "door", "bend"]

_SAME_M = 1e-3  # a corner of a way this near to a door's line lies on it


@dataclass(frozen=True, slots=True, kw_only=True)
class Stop:
    """A place on the ways: the anchor of `submap`, the passage of `door`, or a bend, of neither."""

    id: int
    kind: StopKind
    x: float
    y: float
    submap: int | None = None
    door: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Leg:
    """A straight line from one stop to another, by their ids, along the way of a link."""

    start: int
    end: int
    length_m: float
    link: Edge


@dataclass(frozen=True, slots=True)
class Routes:
    """All stops, in the order of their ids, and the legs, each once: all are driven both ways."""

    stops: tuple[Stop, ...]
    legs: tuple[Leg, ...]


def is_way(edge: Edge) -> bool:
    """Whether a robot can and may drive along a link."""
    return edge.path is not None and len(edge.path) > 1 and not edge.forbidden


def parts(record: TopologyRecord) -> list[list[int]]:
    """Submap ids by the parts that ways join, the largest first, then the one with the least id."""
    graph = nx.Graph()
    graph.add_nodes_from(node.id for node in record.nodes)
    graph.add_edges_from((edge.source, edge.target) for edge in record.edges if is_way(edge))
    found = [sorted(part) for part in nx.connected_components(graph)]
    return sorted(found, key=lambda part: (-len(part), part))


def routes(record: TopologyRecord) -> Routes:
    """The stops and the legs of a map.

    An anchor's stop has the id of its submap, which stays when the map is updated; other ids are
    given afresh, beyond all ids of submaps.
    """
    anchors = {
        node.id: Stop(id=node.id, kind="anchor", x=x, y=y, submap=node.id)
        for node in record.nodes
        for x, y in ([node.anchor] if node.anchor is not None else [])
    }
    doors = {door.id: door for door in record.graph.doors}
    stops, legs, ids = list(anchors.values()), list[Leg](), count(record.graph.next_id)
    for edge in record.edges:
        if not is_way(edge) or not {edge.source, edge.target} <= anchors.keys():
            continue
        between = list(_between(edge, doors, ids))
        chain = [anchors[edge.source], *between, anchors[edge.target]]
        stops += between
        legs += [_leg(start, end, edge) for start, end in pairwise(chain)]
    return Routes(tuple(stops), tuple(legs))


def without_bends(found: Routes) -> Routes:
    """The same for who plans around corners: legs from anchors to doors, as long as their ways."""
    bends = {stop.id for stop in found.stops if stop.kind == "bend"}
    legs: list[Leg] = []
    for leg in found.legs:
        if leg.start in bends:  # goes on where the leg before ended
            before = legs.pop()
            leg = replace(before, end=leg.end, length_m=before.length_m + leg.length_m)
        legs.append(leg)
    return Routes(tuple(stop for stop in found.stops if stop.id not in bends), tuple(legs))


def _leg(start: Stop, end: Stop, edge: Edge) -> Leg:
    length = float(np.hypot(end.x - start.x, end.y - start.y))
    return Leg(start=start.id, end=end.id, length_m=length, link=edge)


def _between(edge: Edge, doors: Mapping[int, Door], ids: Iterator[int]) -> Iterator[Stop]:
    """The stops of a way between its two anchors, in their order."""
    path = np.array(edge.path, dtype=np.float64)
    marks: dict[float, int | None] = dict.fromkeys(map(float, range(1, len(path) - 1)))
    for door in edge.doors:
        marks[_on_corner(path, _passage(path, doors[door]))] = door
    for place, passed in sorted(marks.items()):
        if 0.0 < place < len(path) - 1:  # at an end stands an anchor
            x, y = _point(path, place).tolist()
            kind: StopKind = "bend" if passed is None else "door"
            yield Stop(id=next(ids), kind=kind, x=x, y=y, door=passed)


def _passage(path: FloatArray, door: Door) -> float:
    """Where a path (N, 2) crosses the line of a door, else where it comes nearest to its middle.

    In corners: 2.5 is half way from corner 2 to corner 3.
    """
    right, left = (np.array(side) for side in door.sides)
    for number, (start, end) in enumerate(pairwise(path)):
        share = _crossing(start, end, right, left)
        if share is not None:
            return number + share
    return _nearest(path, np.array([door.x, door.y]))


def _crossing(
    start: FloatArray, end: FloatArray, right: FloatArray, left: FloatArray
) -> float | None:
    """The share of the way from `start` to `end` at which it crosses a line; None: it does not."""
    way, line, gap = end - start, left - right, right - start
    turn = way[0] * line[1] - way[1] * line[0]
    if turn == 0.0:
        return None
    along = (gap[0] * line[1] - gap[1] * line[0]) / turn
    across = (gap[0] * way[1] - gap[1] * way[0]) / turn
    return float(along) if 0.0 <= along <= 1.0 and 0.0 <= across <= 1.0 else None


def _nearest(path: FloatArray, place: FloatArray) -> float:
    """Where a path comes nearest to a place, in corners."""
    starts, ways = path[:-1], np.diff(path, axis=0)
    squares = np.maximum((ways**2).sum(axis=1), np.finfo(float).tiny)
    shares = np.clip(((place - starts) * ways).sum(axis=1) / squares, 0.0, 1.0)
    misses = np.hypot(*(starts + shares[:, None] * ways - place).T)
    best = int(np.argmin(misses))
    return best + float(shares[best])


def _point(path: FloatArray, place: float) -> FloatArray:
    """The place on a path, rounded as coordinates are written."""
    number = min(int(place), len(path) - 2)
    step = path[number + 1] - path[number]
    return np.asarray(np.round(path[number] + (place - number) * step, 6))


def _on_corner(path: FloatArray, place: float) -> float:
    """A place on a path, moved to a corner that is there as well."""
    corner = round(place)
    apart = float(np.hypot(*(_point(path, place) - path[corner])))
    return float(corner) if apart <= _SAME_M else place
