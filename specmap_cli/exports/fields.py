"""What a map tells of its submaps, doors and links, as flat values: the same in every format.

Lengths are metres, places are in the frame of the map. A value that is unknown is None; formats
that know no such thing leave it out with `known`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from specmap_cli.maps.schema import EdgeRecord, NodeRecord
from specmap_cli.maps.schema_graph import DoorRecord
from specmap_cli.maps.schema_values import Point

Fields = dict[str, Any]


def centre_of(node: NodeRecord) -> Point:
    """A place in a submap: its centroid, or the origin of its frame when it owns no cell."""
    return node.centroid or (node.x, node.y)


def submap_fields(node: NodeRecord) -> Fields:
    """A submap, without what a person noted (`properties`) and without its outline."""
    x, y = centre_of(node)
    anchor_x, anchor_y = node.anchor or (None, None)
    return {
        "name": node.name,
        "kind": node.kind,
        "x": x,
        "y": y,
        "anchor_x": anchor_x,
        "anchor_y": anchor_y,
        "anchor_clearance_m": node.anchor_clearance_m,
        "area_m2": node.area_m2,
        "scans": node.scans,
        "visits": len(node.visits),
    }


def link_fields(edge: EdgeRecord) -> Fields:
    """A link between two submaps; `doors` are ids in one text, as flat formats need it."""
    return {
        "kind": edge.kind,
        "passable": edge.path is not None,
        "forbidden": edge.forbidden,
        "length_m": edge.length_m,
        "clearance_m": edge.clearance_m,
        "width_m": edge.width_m,
        "doors": " ".join(map(str, edge.doors)),
        "distance_m": edge.distance_m,
        "traversals": len(edge.traversals),
        "x": edge.x,
        "y": edge.y,
    }


def door_fields(door: DoorRecord) -> Fields:
    """A door between two submaps."""
    return {
        "width_m": door.width_m,
        "theta": door.theta,
        "driven": door.driven,
        "crossings": len(door.crossings),
        "forbidden": door.forbidden,
    }


def known(fields: Mapping[str, Any]) -> Fields:
    """The fields that have a value."""
    return {key: value for key, value in fields.items() if value is not None}
