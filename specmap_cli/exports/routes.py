"""The graph that a robot drives: waypoints joined by straight legs along the ways of a map.

Waypoints stand at the anchors of submaps, where ways go through doors, and where they bend: so each
leg is a straight line through free cells, and the legs of a way are as long as the way. Links
without a way and forbidden ones have no legs. A waypoint belongs to one way, an anchor to all of
its submap. What would mislead a robot that follows the graph is told before it is written.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count, pairwise
from typing import Literal

import numpy as np

from specmap_cli.core.errors import MapError
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.progress import Progress
from specmap_cli.core.text import counted
from specmap_cli.maps.schema import TopologyRecord
from specmap_cli.maps.store import Map
from specmap_cli.topology.navigation import crossing_of, is_way, parts
from specmap_cli.topology.topological_map import Door, Edge

WaypointKind = Literal["anchor", "door", "bend"]

_SAME_M = 1e-3  # a corner of a way this near to a door's line lies on it


@dataclass(frozen=True, slots=True, kw_only=True)
class Waypoint:
    """A place on the ways: the anchor of `submap`, the passage of `door`, or a bend, of neither."""

    id: int
    kind: WaypointKind
    x: float
    y: float
    submap: int | None = None
    door: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Leg:
    """A straight line from one waypoint to another, by their ids, along the way of a link."""

    start: int
    end: int
    length_m: float
    link: Edge


@dataclass(frozen=True, slots=True)
class Routes:
    """All waypoints by id, and the legs, each once: all are driven both ways."""

    waypoints: tuple[Waypoint, ...]
    legs: tuple[Leg, ...]


def routes(record: TopologyRecord) -> Routes:
    """The waypoints and the legs of a map.

    An anchor's waypoint has the id of its submap, which stays when the map is updated; other ids
    are given afresh, beyond all ids of submaps.
    """
    anchors = {
        node.id: Waypoint(id=node.id, kind="anchor", x=x, y=y, submap=node.id)
        for node in record.nodes
        for x, y in ([node.anchor] if node.anchor is not None else [])
    }
    doors = {door.id: door for door in record.graph.doors}
    waypoints, legs, ids = list(anchors.values()), list[Leg](), count(record.graph.next_id)
    for edge in record.edges:
        if not is_way(edge) or not {edge.source, edge.target} <= anchors.keys():
            continue
        between = list(_between(edge, doors, ids))
        chain = [anchors[edge.source], *between, anchors[edge.target]]
        waypoints += between
        for start, end in pairwise(chain):
            length = float(np.hypot(end.x - start.x, end.y - start.y))
            legs.append(Leg(start=start.id, end=end.id, length_m=length, link=edge))
    return Routes(tuple(waypoints), tuple(legs))


def without_bends(found: Routes) -> Routes:
    """The same for who plans around corners: legs from anchors to doors, as long as their ways."""
    bends = {waypoint.id for waypoint in found.waypoints if waypoint.kind == "bend"}
    legs: list[Leg] = []
    for leg in found.legs:
        if leg.start in bends:  # goes on where the leg before ended
            before = legs.pop()
            leg = replace(before, end=leg.end, length_m=before.length_m + leg.length_m)
        legs.append(leg)
    return Routes(
        tuple(waypoint for waypoint in found.waypoints if waypoint.id not in bends), tuple(legs)
    )


def _between(edge: Edge, doors: Mapping[int, Door], ids: Iterator[int]) -> Iterator[Waypoint]:
    """The waypoints of a way between its two anchors, in their order."""
    path = np.array(edge.path, dtype=np.float64)
    marks: dict[float, int | None] = dict.fromkeys(map(float, range(1, len(path) - 1)))
    for door in edge.doors:
        crossing = crossing_of(path, doors[door])
        where = _nearest(path, doors[door]) if crossing is None else sum(crossing)
        corner = round(where)  # one that is there as well is taken
        apart = float(np.hypot(*(_point(path, where) - path[corner])))
        marks[float(corner) if apart <= _SAME_M else where] = door
    for place, passed in sorted(marks.items()):
        if 0.0 < place < len(path) - 1:  # at an end stands an anchor
            x, y = _point(path, place).tolist()
            kind: WaypointKind = "bend" if passed is None else "door"
            yield Waypoint(id=next(ids), kind=kind, x=x, y=y, door=passed)


def _nearest(path: FloatArray, door: Door) -> float:
    """Where a path comes nearest to the middle of a door, in corners; 2.5 lies between 2 and 3."""
    place = np.array([door.x, door.y])
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


_MOST = 5  # submaps, links or parts that a message names


def check_routes(stored: Map, progress: Progress) -> None:
    """Tell what would mislead a robot that follows the ways of a map.

    Raises MapError for a map without any way: nothing could be planned with it.
    """
    record = stored.record
    radius = record.graph.robot_radius_m
    if not any(map(is_way, record.edges)):
        if radius is None:
            why = "nobody looked for ways when it was made: build the map again"
        elif len(record.nodes) < 2:
            why = "it has one submap: record a drive through more rooms, or cut it with "
            why += "`specmap edit --split`"
        elif any(edge.forbidden and edge.corners for edge in record.edges):
            why = "those that there are were forbidden: allow one with `specmap edit --undo`"
        else:
            why = f"all are too narrow for a robot of {radius:g} m radius: build the map again "
            why += "with a smaller ways.robot_radius_m, if the robot is smaller"
        raise MapError(f"nothing to plan a route with: {why}", where=stored.path)
    for warning in _warnings(record):
        progress.warn(warning)
    forbidden = [edge for edge in record.edges if edge.forbidden]
    narrow = [edge for edge in record.edges if not edge.corners and not edge.forbidden]
    if forbidden:
        progress.note(f"left out: {_links(forbidden)} forbidden")
    if narrow:
        progress.note(f"left out: {_links(narrow)} without a way wide enough")


def _warnings(record: TopologyRecord) -> list[str]:
    """What is in the file, or missing in it, and would mislead."""
    found = []
    quality = record.graph.quality
    if quality is not None and quality.verdict != "good":
        found.append(
            f"the map is judged {quality.verdict}: a robot that follows its ways may meet walls"
        )
    unanchored = [node.id for node in record.nodes if node.anchor is None]
    if unanchored:
        noun = "submap" if len(unanchored) == 1 else "submaps"
        found.append(f"no place to stand in {noun} {_few(unanchored)}: left out")
    apart = parts([node.id for node in record.nodes], record.edges)
    if len(apart) > 1:
        groups = "; ".join(map(_few, apart[:_MOST]))
        more = f"; and {len(apart) - _MOST} more" if len(apart) > _MOST else ""
        found.append(
            f"{len(apart)} parts that no way joins, no route leads from one to another: submaps "
            f"{groups}{more}"
        )
    loose = [edge for edge in record.edges if is_way(edge) and edge.kind == "loose"]
    if loose:
        found.append(
            f"{_links(loose)} joined by a guess only, where tracking was lost: check the map "
            "before a robot drives there"
        )
    return found


def _links(edges: Sequence[Edge]) -> str:
    """`1 link (3-4)`."""
    names = [f"{edge.source}-{edge.target}" for edge in edges]
    return f"{counted(len(edges), 'link')} ({_few(names)})"


def _few(names: Sequence[object]) -> str:
    """The first few and how many more."""
    more = f" and {len(names) - _MOST} more" if len(names) > _MOST else ""
    return ", ".join(map(str, names[:_MOST])) + more
