"""GraphML, the graph alone: for yEd, Gephi, networkx and other tools that draw or search graphs."""

from __future__ import annotations

from typing import IO

import networkx as nx

from specmap_cli.core.progress import Progress
from specmap_cli.exports.fields import LINK, SUBMAP, fields_of, known, noted_fields
from specmap_cli.maps.store import StoredMap


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
