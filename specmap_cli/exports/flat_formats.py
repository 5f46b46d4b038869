"""What a map tells of its submaps, doors and links as flat values: CSV, GraphML, GeoJSON.

Lengths are metres, places are in the frame of the map. A value that is unknown is None; formats
that know no such thing leave it out with `known`.
"""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from operator import attrgetter
from typing import IO, Any

import networkx as nx

from specmap_cli.core.json_values import Point, PropertyValue
from specmap_cli.core.progress import Progress
from specmap_cli.core.tables import csv_text
from specmap_cli.core.text import plain, to_json
from specmap_cli.maps.schema import NodeRecord
from specmap_cli.maps.store import StoredMap
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


def told_of(node: NodeRecord) -> Fields:
    """What a viewer tells of a submap."""
    return {"id": node.id, **fields_of(node, SUBMAP), **noted_fields(node)}


def fields_of(record: Any, wanted: Mapping[str, Callable[[Any], Any]]) -> Fields:
    """The fields of a submap, a link or a door: `wanted` is SUBMAP, LINK or DOOR."""
    return {name: of(record) for name, of in wanted.items()}


def known(fields: Mapping[str, Any]) -> Fields:
    """The fields that have a value."""
    return {key: value for key, value in fields.items() if value is not None}


_SAME_DAY = (1980, 1, 1, 0, 0, 0)  # the first a zip knows: the same map gives the same bytes
_FOR_ALL = 0o644 << 16  # readable, once unpacked

_ENDS: Mapping[str, Callable[[Any], Any]] = {
    "source": attrgetter("source"),
    "target": attrgetter("target"),
}
_PLACE: Mapping[str, Callable[[Any], Any]] = {
    "id": attrgetter("id"),
    "source": lambda door: door.between[0],
    "target": lambda door: door.between[1],
    "x": attrgetter("x"),
    "y": attrgetter("y"),
}


class CsvTables:
    """`nodes.csv`, `edges.csv` and `doors.csv`, each with a line of headings, in a zip."""

    description = "a zip of nodes.csv, edges.csv and doors.csv, for spreadsheets and pandas"
    ending = ".zip"

    def write(self, stored: StoredMap, target: IO[bytes], _: Progress) -> None:
        """Write the tables of a map."""
        record = stored.record
        keys = sorted({key for node in record.nodes for key in node.properties})
        noted = {f"property.{key}": _noted(key) for key in keys}
        tables = {
            "nodes.csv": _table(record.nodes, {"id": attrgetter("id"), **SUBMAP, **noted}),
            "edges.csv": _table(record.edges, {**_ENDS, **LINK}),
            "doors.csv": _table(record.graph.doors, {**_PLACE, **DOOR}),
        }
        with zipfile.ZipFile(target, "w") as archive:
            for name, text in tables.items():
                entry = zipfile.ZipInfo(name, _SAME_DAY)
                entry.external_attr = _FOR_ALL
                archive.writestr(entry, text, zipfile.ZIP_DEFLATED)


def _noted(key: str) -> Callable[[NodeRecord], PropertyValue | None]:
    return lambda node: node.properties.get(key)


def _table(records: Iterable[Any], columns: Mapping[str, Callable[[Any], Any]]) -> str:
    """A table as CSV (RFC 4180)."""
    rows = (plain(fields_of(record, columns)) for record in records)
    return csv_text(list(columns), (list(row.values()) for row in rows), "\r\n")


class GraphMl:
    """Nodes are submaps with their place, area and visits; edges the links between them."""

    description = "GraphML: the graph, for yEd, Gephi and networkx"

    def write(self, stored: StoredMap, target: IO[bytes], _: Progress) -> None:
        """Write the graph of a map; lengths are metres, places are in the frame of the map."""
        graph = nx.Graph(frame=stored.record.graph.frame)
        for node in stored.record.nodes:
            graph.add_node(node.id, **noted_fields(node), **known(fields_of(node, SUBMAP)))
        for edge in stored.record.edges:
            graph.add_edge(edge.source, edge.target, **known(fields_of(edge, LINK)))
        nx.write_graphml_xml(graph, target, prettyprint=True)


class GeoJson:
    """A polygon for each submap that owns space, a line for each link and each door (RFC 7946).

    The line of a door leads from wall to wall. A point is an anchor: where a robot can stand.
    """

    description = "GeoJSON: outlines, doors and ways in metres of the map, for QGIS"

    def write(self, stored: StoredMap, target: IO[bytes], _: Progress) -> None:
        """Write the features of a map, submaps first."""
        nodes = {node.id: node for node in stored.record.nodes}
        features: list[Fields] = []
        told: Fields
        for node in nodes.values():
            if node.polygon:
                ring = [*node.polygon, node.polygon[0]]
                kinds = {"kind": "submap", "submap_kind": node.kind}
                own = {"id": node.id, "properties": node.properties}
                features.append(feature("Polygon", [ring], fields_of(node, SUBMAP) | kinds | own))
        for node in nodes.values():
            if node.anchor:
                told = {"kind": "anchor", "submap": node.id, "clearance_m": node.anchor_clearance_m}
                features.append(feature("Point", list(node.anchor), told))
        for door in stored.record.graph.doors:
            sides = [[round(value, 6) for value in side] for side in door.sides]
            told = {"kind": "door", "id": door.id, "between": list(door.between)}
            features.append(feature("LineString", sides, fields_of(door, DOOR) | told))
        for edge in stored.record.edges:
            told = {"source": edge.source, "target": edge.target, "doors": edge.doors}
            line = link_line(edge, nodes)
            features.append(feature("LineString", line, fields_of(edge, LINK) | told))
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
