"""What a map tells of its submaps, doors and links, as flat values: the same in every format.

Lengths are metres, places are in the frame of the map. A value that is unknown is None; formats
that know no such thing leave it out with `known`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from operator import attrgetter
from typing import Any

from specmap_cli.core.json_values import Point
from specmap_cli.maps.schema import NodeRecord
from specmap_cli.topology.topological_map import Door, Edge

Fields = dict[str, Any]


def centre_of(node: NodeRecord) -> Point:
    """A place in a submap: its centroid, or the origin of its frame when it owns no cell."""
    return node.centroid or (node.x, node.y)


def link_line(edge: Edge, nodes: Mapping[int, NodeRecord]) -> list[Point]:
    """The way of a link; without one straight from place to place over its crossing."""
    if edge.corners:
        return edge.corners
    start, end = (nodes[id_].anchor or centre_of(nodes[id_]) for id_ in (edge.source, edge.target))
    return [start, *([] if edge.x is None or edge.y is None else [(edge.x, edge.y)]), end]


def _same(*names: str) -> dict[str, Callable[[Any], Any]]:
    """Fields that are called as in topology.json."""
    return {name: attrgetter(name) for name in names}


# A submap without what a person noted (`properties`) and without its outline.
SUBMAP: Mapping[str, Callable[[NodeRecord], Any]] = {
    **_same("name", "kind"),
    "x": lambda node: centre_of(node)[0],
    "y": lambda node: centre_of(node)[1],
    "anchor_x": lambda node: None if node.anchor is None else node.anchor[0],
    "anchor_y": lambda node: None if node.anchor is None else node.anchor[1],
    **_same("anchor_clearance_m", "area_m2", "scans"),
    "visits": lambda node: len(node.visits),
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


def noted_fields(node: NodeRecord) -> Fields:
    """What a person noted of a submap, under `property.`: flat formats hold single values."""
    return {f"property.{key}": value for key, value in node.properties.items()}


def fields_of(record: Any, wanted: Mapping[str, Callable[[Any], Any]]) -> Fields:
    """The fields of a submap, a link or a door: `wanted` is SUBMAP, LINK or DOOR."""
    return {name: of(record) for name, of in wanted.items()}


def known(fields: Mapping[str, Any]) -> Fields:
    """The fields that have a value."""
    return {key: value for key, value in fields.items() if value is not None}
