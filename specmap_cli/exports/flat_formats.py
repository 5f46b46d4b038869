"""Formats of general use: CSV, GraphML and GeoJSON of rooms, doors and links; g2o of the layout."""

from __future__ import annotations

from collections.abc import Iterable
from typing import IO

import networkx as nx

from specmap_cli.core.errors import InputError, MapError
from specmap_cli.core.files import write_zip
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.progress import Progress
from specmap_cli.core.tables import csv_text
from specmap_cli.core.text import plain, to_json
from specmap_cli.layout.pose_graph import Link, graph_text, read_g2o
from specmap_cli.maps import filenames
from specmap_cli.maps.rooms import DOOR, LINK, SUBMAP, Fields, features_of, fields_of, told_of
from specmap_cli.maps.store import Map
from specmap_cli.maps.text_files import map_text


def csv_tables(stored: Map, target: IO[bytes], _: Progress) -> None:
    """a zip of nodes.csv, edges.csv and doors.csv, for spreadsheets and pandas."""
    rooms = [told_of(room) for room in stored.rooms.values()]
    noted = sorted({key for room in rooms for key in room} - {"id", *SUBMAP})
    links = [
        {"source": edge.source, "target": edge.target, **fields_of(edge, LINK)}
        for edge in stored.record.edges
    ]
    doors = [
        {"id": door.id, "source": door.between[0], "target": door.between[1]}
        | {"x": door.x, "y": door.y, **fields_of(door, DOOR)}
        for door in stored.doors
    ]
    tables = {
        "nodes.csv": (["id", *SUBMAP, *noted], rooms),
        "edges.csv": (["source", "target", *LINK], links),
        "doors.csv": (["id", "source", "target", "x", "y", *DOOR], doors),
    }
    files = {}
    for name, (columns, found) in tables.items():  # RFC 4180
        rows = ([row.get(column) for column in columns] for row in map(plain, found))
        files[name] = csv_text(columns, rows, "\r\n").encode()
    write_zip(target, files)


def graphml(stored: Map, target: IO[bytes], _: Progress) -> None:
    """GraphML: the graph, for yEd, Gephi and networkx.

    Nodes are submaps with their place, area and visits; edges the links between them.
    """
    graph = stored.to_networkx()
    for told in [*graph.nodes.values(), *graph.edges.values()]:
        for key in [key for key, value in told.items() if value is None]:
            del told[key]
    nx.write_graphml_xml(graph, target, prettyprint=True)


def geojson(stored: Map, target: IO[bytes], _: Progress) -> None:
    """GeoJSON: outlines, doors and ways in metres of the map, for QGIS.

    A polygon for each submap that owns space, a line for each link and each door (RFC 7946).
    The line of a door leads from wall to wall. A point is an anchor: where a robot can stand.
    """
    target.write(to_json(collection(features_of(stored))).encode())


def collection(features: Iterable[Fields]) -> Fields:
    """Features in metres. Without the key `crs` tools take the numbers for degrees (RFC 7946)."""
    crs = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::3857"}}
    numbered = [{**each, "id": number} for number, each in enumerate(features)]
    return {"type": "FeatureCollection", "crs": crs, "features": numbered}


def pose_graph(stored: Map, target: IO[bytes], progress: Progress) -> None:
    """g2o: the pose graph of the layout, for GTSAM and g2o.

    Vertices are keyframes, edges are motions, closures and nearby passes. The first vertex of
    each part that edges join is fixed, so that a solver has one answer. Maps of earlier
    versions are written in an order that GTSAM reads, too. Raises MapError for a map without a
    trajectory.
    """
    poses, links = _read(stored)
    graph = nx.Graph()
    graph.add_nodes_from(poses)
    graph.add_edges_from((link.source, link.target) for link in links)
    starts = sorted(min(part) for part in nx.connected_components(graph))
    if len(starts) > 1:
        progress.warn(
            f"the pose graph is in {len(starts)} parts that no edge joins: the first vertex of "
            "each is fixed"
        )
    target.write(graph_text(poses, links, starts).encode())


def _read(stored: Map) -> tuple[dict[int, FloatArray], list[Link]]:
    path = stored.path / filenames.POSE_GRAPH
    if not path.exists():
        raise MapError(
            f"has no {path.name}: `specmap segment` makes maps without",
            "a pose graph needs one that `specmap build` made of a recording",
            mark=";",
            where=stored.path,
        )
    try:
        poses, links = read_g2o(stored.checked(map_text(path, stored.limits), path.name))
    except InputError as error:
        raise MapError.damaged(error.found, path) from None
    strangers = {end for link in links for end in (link.source, link.target)} - poses.keys()
    if strangers:
        raise MapError.damaged(f"there is no vertex {min(strangers)}", path)
    if not poses:
        raise MapError.damaged("has no vertices", path)
    return poses, links
