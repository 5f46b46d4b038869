"""GraphML, the graph alone: for yEd, Gephi, networkx and other tools that draw or search graphs."""

from __future__ import annotations

from typing import IO, Any

import networkx as nx

from specmap_cli.maps.schema import EdgeRecord, NodeRecord
from specmap_cli.maps.store import StoredMap


class GraphMl:
    """Nodes are submaps with their place, area and visits; edges the links between them."""

    description = "GraphML: the graph, for yEd, Gephi and networkx"

    def write(self, stored: StoredMap, target: IO[bytes]) -> None:
        """Write the graph of a map; lengths are metres, places are in the frame of the map."""
        graph = nx.Graph(frame=stored.record.graph.frame)
        for node in stored.record.nodes:
            graph.add_node(node.id, **_of_node(node))
        for edge in stored.record.edges:
            graph.add_edge(edge.source, edge.target, **_of_edge(edge))
        nx.write_graphml_xml(graph, target, prettyprint=True)


def _of_node(node: NodeRecord) -> dict[str, Any]:
    """The properties of a submap, a person's own under `property.`: GraphML holds single values."""
    x, y = node.centroid or (node.x, node.y)
    return {
        **{f"property.{key}": value for key, value in node.properties.items()},
        **({} if node.kind is None else {"kind": node.kind}),
        **_of_anchor(node),
        "name": node.name,
        "x": x,
        "y": y,
        "area_m2": node.area_m2,
        "scans": node.scans,
        "visits": len(node.visits),
    }


def _of_anchor(node: NodeRecord) -> dict[str, Any]:
    """Where a robot can stand in a submap, if it can."""
    if node.anchor is None:
        return {}
    x, y = node.anchor
    return {"anchor_x": x, "anchor_y": y, "anchor_clearance_m": node.anchor_clearance_m}


def _of_edge(edge: EdgeRecord) -> dict[str, Any]:
    """The properties of a link; those that are not known are left out."""
    found = {
        "kind": edge.kind,
        "distance_m": edge.distance_m,
        "traversals": len(edge.traversals),
        "x": edge.x,
        "y": edge.y,
        "width_m": edge.width_m,
        "doors": " ".join(map(str, edge.doors)),
        "passable": edge.path is not None,
        "length_m": edge.length_m,
        "clearance_m": edge.clearance_m,
        "forbidden": edge.forbidden,
    }
    return {key: value for key, value in found.items() if value is not None}
