"""The graph that a robot drives: waypoints joined by straight legs along the ways of a map.

Waypoints stand at the anchors of submaps, where ways go through doors, and where they bend: so each
leg is a straight line through free cells, and the legs of a way are as long as the way. Links
without a way and forbidden ones have no legs. A waypoint belongs to one way, an anchor to all of
its submap. What would mislead a robot that follows the graph is told before it is written.

Two properties that a person notes of a submap hold for the legs in it: `speed_limit`, metres a
second, and `penalty`, which makes a route through it cost more.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count, pairwise
from typing import Literal, TypeGuard

import numpy as np

from specmap_cli.core.errors import MapError
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.progress import Progress
from specmap_cli.core.text import counted, seconds
from specmap_cli.maps.schema import TopologyRecord
from specmap_cli.maps.store import Map
from specmap_cli.topology.navigation import crossing_of, is_way, parts
from specmap_cli.topology.topological_map import Door, Edge

WaypointKind = Literal["anchor", "door", "bend"]

_SAME_M = 1e-3  # a corner of a way this near to a door's line lies on it


@dataclass(frozen=True, slots=True, kw_only=True)
class Waypoint:
    """A place on the ways: the anchor of `submap`, the passage of `door`, or a bend, of neither.

    A way goes `straight` through most doors.
    """

    id: int
    kind: WaypointKind
    x: float
    y: float
    submap: int | None = None
    door: int | None = None
    straight: bool = False

    @property
    def name(self) -> str:
        """Its name in files, where names are ids: people call submaps what they like."""
        of = self.submap if self.kind == "anchor" else self.door if self.kind == "door" else self.id
        return f"{'Submap' if self.kind == 'anchor' else self.kind.capitalize()}{of}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Leg:
    """A straight line from one waypoint to another, by their ids, along the way of a link.

    It lies in `submaps`, and touches or crosses `doors`, ids. `speed_limit` is metres a second.
    """

    start: int
    end: int
    length_m: float
    link: Edge
    submaps: frozenset[int]
    doors: tuple[int, ...]
    speed_limit: float | None
    penalty: float = 0.0

    @property
    def cost(self) -> float:
        """What Nav2's scorers of distance and penalty make of it together."""
        return self.length_m / (self.speed_limit or 1.0) + self.penalty


@dataclass(frozen=True, slots=True)
class Routes:
    """All waypoints by id, and the legs, each once: all are driven both ways."""

    waypoints: tuple[Waypoint, ...]
    legs: tuple[Leg, ...]

    def without(self, left_out: Callable[[Waypoint], bool]) -> Routes:
        """The same without some waypoints between anchors: legs are as long as their ways."""
        gone = {one.id: one for one in self.waypoints if left_out(one)}
        legs: list[Leg] = []
        for leg in self.legs:
            legs.append(_joined(legs.pop(), leg) if leg.start in gone else leg)
        return Routes(tuple(one for one in self.waypoints if one.id not in gone), tuple(legs))


def _joined(one: Leg, other: Leg) -> Leg:
    limits = [leg.speed_limit for leg in (one, other) if leg.speed_limit is not None]
    return replace(
        one,
        end=other.end,
        length_m=one.length_m + other.length_m,
        submaps=one.submaps | other.submaps,
        doors=tuple(dict.fromkeys([*one.doors, *other.doors])),
        speed_limit=min(limits, default=None),
        penalty=one.penalty + other.penalty,
    )


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
    limits, penalties = noted(record, SPEED_LIMIT), noted(record, PENALTY)
    waypoints, legs, ids = list(anchors.values()), list[Leg](), count(record.graph.next_id)
    for edge in record.edges:
        if not is_way(edge) or not {edge.source, edge.target} <= anchors.keys():
            continue
        between = list(_between(edge, doors, ids))
        chain = [anchors[edge.source], *between, anchors[edge.target]]
        waypoints += between
        legs += _legs(edge, chain, limits, penalties)
    return Routes(tuple(waypoints), tuple(legs))


def _legs(
    edge: Edge,
    chain: Sequence[Waypoint],
    limits: Mapping[int, float],
    penalties: Mapping[int, float],
) -> list[Leg]:
    """The legs of a way. Before its first door it is in one submap, behind the last in the other.

    The legs of a way in a submap share its penalty by their lengths.
    """
    passed = [number for number, one in enumerate(chain) if one.door is not None]
    whole = frozenset({edge.source, edge.target})
    legs, metres = list[Leg](), defaultdict[frozenset[int], float](float)
    for number, (start, end) in enumerate(pairwise(chain)):
        here = whole
        if passed and not passed[0] <= number < passed[-1]:
            here = frozenset({edge.source if number < passed[0] else edge.target})
        leg = Leg(
            start=start.id,
            end=end.id,
            length_m=float(np.hypot(end.x - start.x, end.y - start.y)),
            link=edge,
            submaps=here,
            doors=tuple(one.door for one in (start, end) if one.door is not None),
            speed_limit=min((limits[id_] for id_ in here & limits.keys()), default=None),
        )
        legs.append(leg)
        metres[here] += leg.length_m
    prices = {here: sum(penalties.get(id_, 0.0) for id_ in here) for here in metres}
    return [
        replace(leg, penalty=prices[leg.submaps] * leg.length_m / (metres[leg.submaps] or 1.0))
        for leg in legs
    ]


SPEED_LIMIT, PENALTY = "speed_limit", "penalty"  # properties of submaps


def noted(record: TopologyRecord, key: str) -> dict[int, float]:
    """What a person noted of submaps under `key`, by id, where it is a number above zero."""
    values = {node.id: node.properties.get(key) for node in record.nodes}
    return {id_: float(value) for id_, value in values.items() if _is_amount(value)}


def _is_amount(value: object) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool) and value > 0.0


def misnoted(record: TopologyRecord) -> list[str]:
    """A warning for each speed limit and penalty that is none."""
    return [
        f"submap {node.id}: {key} is {node.properties[key]!r}, no number above 0: not exported"
        for node in record.nodes
        for key in (SPEED_LIMIT, PENALTY)
        if key in node.properties and not _is_amount(node.properties[key])
    ]


def ended(record: TopologyRecord) -> float:
    """When the last of the recordings ended, seconds (UTC): the same map gives the same date."""
    return max([0.0, *(seconds(log.end_ns) for log in record.graph.logs if log.end_ns)])


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
            straight = not place.is_integer()
            yield Waypoint(id=next(ids), kind=kind, x=x, y=y, door=passed, straight=straight)


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


def routes_of(stored: Map, progress: Progress) -> Routes:
    """The routes of a map; what would mislead a robot is told, and MapError raised without any."""
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
    return routes(record)


def _warnings(record: TopologyRecord) -> list[str]:
    """What is in the file, or missing in it, and would mislead."""
    found = misnoted(record)
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
