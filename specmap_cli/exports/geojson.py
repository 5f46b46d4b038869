"""GeoJSON, the outlines, the doors and the ways: for QGIS and other tools that show shapes.

Coordinates are metres in the frame of the map, not degrees. The file names a reference system of
metres (EPSG:3857), so that tools measure lengths and areas right; the place on earth means nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import IO, Any

from specmap_cli.core.progress import Progress
from specmap_cli.core.text import to_json
from specmap_cli.exports.fields import DOOR, LINK, SUBMAP, Fields, fields_of, link_line
from specmap_cli.maps.schema import NodeRecord
from specmap_cli.maps.store import StoredMap
from specmap_cli.topology.topological_map import Door, Edge


class GeoJson:
    """A polygon for each submap that owns space, a line for each link and each door (RFC 7946).

    The line of a door leads from wall to wall. A point is an anchor: where a robot can stand.
    """

    description = "GeoJSON: outlines, doors and ways in metres of the map, for QGIS"

    def write(self, stored: StoredMap, target: IO[bytes], _: Progress) -> None:
        """Write the features of a map, submaps first."""
        nodes = {node.id: node for node in stored.record.nodes}
        features = [
            *(_submap(node) for node in nodes.values() if node.polygon),
            *(_anchor(node) for node in nodes.values() if node.anchor),
            *(_door(door) for door in stored.record.graph.doors),
            *(_link(edge, nodes) for edge in stored.record.edges),
        ]
        target.write(to_json(collection(features)).encode())


def collection(features: Iterable[Fields]) -> Fields:
    """Features in metres. Without the key `crs` tools take the numbers for degrees (RFC 7946)."""
    crs = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::3857"}}
    numbered = [{**each, "id": number} for number, each in enumerate(features)]
    return {"type": "FeatureCollection", "crs": crs, "features": numbered}


def feature(kind: str, coordinates: Sequence[Any], properties: Fields) -> Fields:
    """One feature."""
    return {
        "type": "Feature",
        "geometry": {"type": kind, "coordinates": coordinates},
        "properties": properties,
    }


def _submap(node: NodeRecord) -> Fields:
    """The outline of a submap: a ring that ends where it starts."""
    ring = [*node.polygon, node.polygon[0]]
    properties = {
        **fields_of(node, SUBMAP),
        "kind": "submap",
        "submap_kind": node.kind,
        "id": node.id,
        "properties": node.properties,
    }
    return feature("Polygon", [ring], properties)


def _anchor(node: NodeRecord) -> Fields:
    """The place where a robot can stand in a submap."""
    return feature(
        "Point",
        list(node.anchor or ()),
        {"kind": "anchor", "submap": node.id, "clearance_m": node.anchor_clearance_m},
    )


def _door(record: Door) -> Fields:
    """The line of a door."""
    return feature(
        "LineString",
        [[round(value, 6) for value in side] for side in record.sides],
        {
            **fields_of(record, DOOR),
            "kind": "door",
            "id": record.id,
            "between": list(record.between),
        },
    )


def _link(edge: Edge, nodes: Mapping[int, NodeRecord]) -> Fields:
    """A link along its way."""
    return feature(
        "LineString",
        link_line(edge, nodes),
        {
            **fields_of(edge, LINK),
            "source": edge.source,
            "target": edge.target,
            "doors": edge.doors,
        },
    )
