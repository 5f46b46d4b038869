"""A reader of layouts: vdma-lif, whose models are made of the schema of LIF 1.0.0 (VDMA, 2024).

Beyond a schema: nothing else is in the file, ids are unique, edges lead between nodes, stations
have a node, and no list of vehicles is empty.
"""

import json
import math
import re
from pathlib import Path

import networkx as nx

from tests.exports.consumers import consumer


def load(path: Path) -> nx.DiGraph:
    """The nodes and edges of a layout, its `stations` by their nodes; edges have `length_m`."""
    collection = consumer("vdma_lif.parser").LIFParser.from_file(str(path))
    known, told = collection.to_dict(), json.loads(path.read_text(encoding="utf-8"))
    stamp = told["metaInformation"]["exportTimestamp"]
    stamps = [one["metaInformation"].pop("exportTimestamp")[:19] for one in (known, told)]
    assert known == told
    assert stamps[0] == stamps[1]
    assert re.fullmatch(r"[\d-]{10}T[\d:]{8}\.\d\dZ", stamp), "ISO 8601 in UTC"
    (layout,) = collection.layouts
    stations = {one.interaction_node_ids[0]: one for one in layout.stations}
    graph = nx.DiGraph(stations=stations)
    for node in layout.nodes:
        assert node.node_id not in graph
        assert node.vehicle_type_node_properties
        graph.add_node(node.node_id, at=(node.node_position.x, node.node_position.y))
    assert len({edge.edge_id for edge in layout.edges}) == len(layout.edges)
    for edge in layout.edges:
        start, end = edge.start_node_id, edge.end_node_id
        length = math.dist(graph.nodes[start]["at"], graph.nodes[end]["at"])
        (vehicle,) = edge.vehicle_type_edge_properties
        graph.add_edge(start, end, length_m=length, max_speed=vehicle.max_speed)
    assert stations.keys() <= set(graph)
    return graph
