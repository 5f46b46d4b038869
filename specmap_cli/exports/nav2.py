"""GeoJSON for the route server of Nav2: a graph that a robot can be sent along.

The server drives a straight line from node to node, and measures an edge by it. So nodes stand at
anchors, in doors, and wherever a way bends. Its loader takes points for nodes and lines for edges,
and metadata that has neither null nor lists in lists: an outline is two lists, of x and of y.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import count
from typing import IO

from specmap_cli.core.progress import Progress
from specmap_cli.core.text import counted, to_json
from specmap_cli.exports.fields import Fields, known
from specmap_cli.exports.fitness import check_routes
from specmap_cli.exports.geojson import collection, feature
from specmap_cli.exports.routes import Leg, Routes, Stop, routes
from specmap_cli.maps.schema import NodeRecord, TopologyRecord
from specmap_cli.maps.store import StoredMap


class Nav2:
    """A point for each stop, two lines for each leg: there and back."""

    description = "GeoJSON for Nav2's route server: nodes at anchors, doors and bends"

    def write(self, stored: StoredMap, target: IO[bytes], progress: Progress) -> None:
        """Write the routes of a map; `frame` is the map's. MapError for a map without ways."""
        check_routes(stored, progress)
        found = routes(stored.record)
        nodes, edges = list(_nodes(found, stored.record)), list(_edges(found))
        progress.note(f"{counted(len(nodes), 'node')} and {counted(len(edges), 'directed edge')}")
        target.write(to_json(collection([*nodes, *edges])).encode())


def _nodes(found: Routes, record: TopologyRecord) -> Iterator[Fields]:
    submaps = {node.id: node for node in record.nodes}
    doors = {door.id: door for door in record.graph.doors}
    for stop in found.stops:
        metadata: Fields = {"class": stop.kind}
        if stop.submap is not None:
            metadata = _of_submap(submaps[stop.submap])
        elif stop.door is not None:
            door = doors[stop.door]
            metadata |= {"door": door.id, "width_m": door.width_m, "driven": door.driven}
        properties = {"id": stop.id, "frame": record.graph.frame, "metadata": metadata}
        yield feature("Point", [stop.x, stop.y], properties)


def _of_submap(node: NodeRecord) -> Fields:
    """What a node tells of its submap; `class` is its kind."""
    xs, ys = zip(*node.polygon, strict=True) if node.polygon else ((), ())
    region = {"x_values": list(xs), "y_values": list(ys)}
    return known(
        {
            "class": node.kind or "submap",
            "submap": node.id,
            "name": node.name,
            "area_m2": node.area_m2,
            "clearance_m": node.anchor_clearance_m,
            "region": region if node.polygon else None,
            "properties": node.properties or None,
        }
    )


def _edges(found: Routes) -> Iterator[Fields]:
    """Two edges a leg; their ids begin beyond those of the nodes, as ids of both must differ."""
    stops = {stop.id: stop for stop in found.stops}
    ids = count(max(stops) + 1)
    for leg in found.legs:
        start, end = stops[leg.start], stops[leg.end]
        yield _edge(next(ids), start, end, leg)
        yield _edge(next(ids), end, start, leg)


def _edge(id_: int, start: Stop, end: Stop, leg: Leg) -> Fields:
    """A directed edge; the server's own scorers may replace its cost, which is its length."""
    link = leg.link
    metadata = known(
        {
            "submaps": [link.source, link.target],
            "link": link.kind,
            "driven": bool(link.traversals),
            "clearance_m": link.clearance_m,
            "width_m": link.width_m,
        }
    )
    properties = {
        "id": id_,
        "startid": start.id,
        "endid": end.id,
        "cost": leg.length_m,
        "overridable": True,
        "metadata": metadata,
    }
    return feature("LineString", [[start.x, start.y], [end.x, end.y]], properties)
