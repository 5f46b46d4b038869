"""GeoJSON, the outlines, the doors and the ways: for QGIS and other tools that show shapes.

Coordinates are metres in the frame of the map, not degrees: load the file into a project without a
coordinate reference system, or place it by hand.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import IO, Any

from specmap_cli.core.progress import Progress
from specmap_cli.core.text import to_json
from specmap_cli.exports.fields import DOOR, LINK, SUBMAP, centre_of, fields_of
from specmap_cli.maps.schema import EdgeRecord, NodeRecord
from specmap_cli.maps.schema_graph import DoorRecord
from specmap_cli.maps.store import StoredMap
from specmap_cli.maps.way_conversion import door_of

Place = tuple[float, float]


class GeoJson:
    """A polygon for each submap that owns space, a line for each link and each door (RFC 7946).

    The line of a door leads from wall to wall. A point is an anchor: where a robot can stand.
    """

    description = "GeoJSON: outlines, doors and ways in metres of the map, for QGIS"

    def write(self, stored: StoredMap, target: IO[bytes], _: Progress) -> None:
        """Write the features of a map, submaps first."""
        nodes = {node.id: node for node in stored.record.nodes}
        places = {id_: node.anchor or centre_of(node) for id_, node in nodes.items()}
        features = [
            *(_submap(node) for node in nodes.values() if node.polygon),
            *(_anchor(node) for node in nodes.values() if node.anchor),
            *(_door(door) for door in stored.record.graph.doors),
            *(_link(edge, places) for edge in stored.record.edges),
        ]
        target.write(to_json({"type": "FeatureCollection", "features": features}).encode())


def _submap(node: NodeRecord) -> dict[str, Any]:
    """The outline of a submap: a ring that ends where it starts."""
    ring = [*node.polygon, node.polygon[0]]
    properties = {
        **fields_of(node, SUBMAP),
        "kind": "submap",
        "submap_kind": node.kind,
        "id": node.id,
        "properties": node.properties,
    }
    return _feature("Polygon", [ring], properties)


def _anchor(node: NodeRecord) -> dict[str, Any]:
    """The place where a robot can stand in a submap."""
    return _feature(
        "Point",
        list(node.anchor or ()),
        {"kind": "anchor", "submap": node.id, "clearance_m": node.anchor_clearance_m},
    )


def _door(record: DoorRecord) -> dict[str, Any]:
    """The line of a door."""
    return _feature(
        "LineString",
        [[round(value, 6) for value in side] for side in door_of(record).sides],
        {
            **fields_of(record, DOOR),
            "kind": "door",
            "id": record.id,
            "between": list(record.between),
        },
    )


def _link(edge: EdgeRecord, places: Mapping[int, Place]) -> dict[str, Any]:
    """A link along its way; without one from anchor to anchor through its crossing."""
    crossing = [] if edge.x is None or edge.y is None else [(edge.x, edge.y)]
    line = edge.path or [places[edge.source], *crossing, places[edge.target]]
    return _feature(
        "LineString",
        line,
        {
            **fields_of(edge, LINK),
            "source": edge.source,
            "target": edge.target,
            "doors": edge.doors,
        },
    )


def _feature(kind: str, coordinates: list[Any], properties: dict[str, Any]) -> dict[str, Any]:
    """One GeoJSON feature."""
    return {
        "type": "Feature",
        "geometry": {"type": kind, "coordinates": coordinates},
        "properties": properties,
    }
