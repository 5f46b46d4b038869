"""What a map tells of its rooms, doors and links as flat values, for graphs, tables and features.

Lengths are metres, places are in the frame of the map. A value that is unknown is None; formats
that know no such thing leave it out with `known`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import networkx as nx

from specmap_cli.core.errors import PACKAGE, UsageError
from specmap_cli.core.json_values import Point
from specmap_cli.maps.rooms import Room
from specmap_cli.topology.topological_map import Door, Edge

if TYPE_CHECKING:
    from specmap_cli.maps.store import Map

Fields = dict[str, Any]


def link_line(edge: Edge, rooms: Mapping[int, Room]) -> list[Point]:
    """The way of a link; without one straight from place to place over its crossing."""
    if edge.corners:
        return edge.corners
    start, end = (rooms[id_].place for id_ in (edge.source, edge.target))
    return [start, *([] if edge.x is None or edge.y is None else [(edge.x, edge.y)]), end]


def _same(*names: str) -> dict[str, Callable[[Any], Any]]:
    """Fields that are called as in topology.json."""
    return {name: attrgetter(name) for name in names}


# A submap without what a person noted (`properties`) and without its outline.
SUBMAP: Mapping[str, Callable[[Room], Any]] = {
    **_same("name", "kind"),
    "x": lambda room: room.centre[0],
    "y": lambda room: room.centre[1],
    "anchor_x": lambda room: None if room.anchor is None else room.anchor[0],
    "anchor_y": lambda room: None if room.anchor is None else room.anchor[1],
    **_same("anchor_clearance_m", "area_m2", "scans"),
    "visits": lambda room: len(room.visits),
}
# A link between two submaps; the ids of its doors are one text, as flat formats need it.
LINK: Mapping[str, Callable[[Edge], Any]] = {
    **_same("kind"),
    "passable": lambda edge: edge.path is not None,
    **_same("forbidden", "length_m", "clearance_m", "width_m"),
    "doors": lambda edge: " ".join(map(str, edge.doors)),
    **_same("distance_m"),
    "traversals": lambda edge: len(edge.traversals),
    **_same("x", "y"),
}
# A door between two submaps.
DOOR: Mapping[str, Callable[[Door], Any]] = {
    **_same("width_m", "theta", "driven"),
    "crossings": lambda door: len(door.crossings),
    **_same("forbidden"),
}


def noted_fields(room: Room) -> Fields:
    """What a person noted of a submap, under `property.`: flat formats hold single values."""
    return {f"property.{key}": value for key, value in room.properties.items()}


def told_of(room: Room) -> Fields:
    """What a viewer tells of a submap."""
    return {"id": room.id, **fields_of(room, SUBMAP), **noted_fields(room)}


def fields_of(record: Any, wanted: Mapping[str, Callable[[Any], Any]]) -> Fields:
    """The fields of a submap, a link or a door: `wanted` is SUBMAP, LINK or DOOR."""
    return {name: of(record) for name, of in wanted.items()}


def known(fields: Mapping[str, Any]) -> Fields:
    """The fields that have a value."""
    return {key: value for key, value in fields.items() if value is not None}


def feature(kind: str, coordinates: Sequence[Any], properties: Fields) -> Fields:
    """One feature."""
    return {
        "type": "Feature",
        "geometry": {"type": kind, "coordinates": coordinates},
        "properties": properties,
    }


def graph_of(map_: Map) -> nx.Graph:
    """The rooms by their ids, and the links between them, each with its figures."""
    graph = nx.Graph(frame=map_.record.graph.frame)
    for room in map_.rooms.values():
        graph.add_node(room.id, **noted_fields(room), **fields_of(room, SUBMAP))
    for edge in map_.record.edges:
        graph.add_edge(edge.source, edge.target, **fields_of(edge, LINK))
    return graph


def features_of(map_: Map) -> Iterator[Fields]:
    """GeoJSON features: outlines of rooms, their anchors, doors from wall to wall, and links."""
    told: Fields
    for room in map_.rooms.values():
        if len(room.outline):
            ring = room.outline[[*range(len(room.outline)), 0]].tolist()
            kinds = {"kind": "submap", "submap_kind": room.kind}
            own = {"id": room.id, "properties": dict(room.properties)}
            yield feature("Polygon", [ring], fields_of(room, SUBMAP) | kinds | own)
    for room in map_.rooms.values():
        if room.anchor:
            told = {"kind": "anchor", "submap": room.id, "clearance_m": room.anchor_clearance_m}
            yield feature("Point", list(room.anchor), told)
    for door in map_.doors:
        sides = [[round(value, 6) for value in side] for side in door.sides]
        told = {"kind": "door", "id": door.id, "between": list(door.between)}
        yield feature("LineString", sides, fields_of(door, DOOR) | told)
    for edge in map_.record.edges:
        told = {"source": edge.source, "target": edge.target, "doors": edge.doors}
        line = link_line(edge, map_.rooms)
        yield feature("LineString", line, fields_of(edge, LINK) | told)


def geodataframe_of(map_: Map) -> Any:
    """The features as a table of geopandas; UsageError where it is not installed."""
    try:
        import geopandas
    except ImportError:
        what = "to_geopandas needs geopandas, which is not installed"
        raise UsageError(what, "pip install geopandas", code=PACKAGE) from None
    return geopandas.GeoDataFrame.from_features(list(features_of(map_)))
