"""A reader of graphs that keeps to the rules of Nav2's route server, and is as strict.

Its loader takes points for nodes and lines for edges and passes over other shapes. It wants at
least one of both, whole numbers of 32 bits as ids, all different, edges between nodes that exist,
and metadata of numbers, booleans, text, lists of these, and objects of all that: null and lists in
lists make it fail. Scorers read numbers of single precision: a whole number is of another type.

Of navigation2: geojson_graph_file_loader.cpp (1293655); distance, penalty and semantic scorers
(08718d0).
"""

import json
from pathlib import Path
from typing import Any

import networkx as nx


def load(path: Path) -> nx.DiGraph:
    """The graph in a file: nodes with `at`, `frame`, `metadata`; edges with `cost`, `id`."""
    features = json.loads(path.read_text(encoding="utf-8"))["features"]
    shapes = [feature["geometry"]["type"] for feature in features]
    nodes = [each for each, shape in zip(features, shapes, strict=True) if shape == "Point"]
    lines = {"LineString", "MultiLineString"}
    edges = [each for each, shape in zip(features, shapes, strict=True) if shape in lines]
    assert nodes, "no nodes"
    assert edges, "no edges"
    ids = [feature["properties"]["id"] for feature in [*nodes, *edges]]
    assert all(isinstance(id_, int) and 0 <= id_ < 2**32 for id_ in ids)
    assert len(set(ids)) == len(ids), "ids of nodes and edges differ"
    graph = nx.DiGraph()
    for feature in nodes:
        properties, (x, y) = feature["properties"], feature["geometry"]["coordinates"]
        assert isinstance(properties["frame"], str)
        _check(properties["metadata"])
        graph.add_node(properties["id"], at=(x, y), **properties)
    for feature in edges:
        properties = feature["properties"]
        start, end = properties["startid"], properties["endid"]
        assert start in graph, start
        assert end in graph, end
        assert isinstance(properties["cost"], float)
        assert isinstance(properties["overridable"], bool)
        _check(properties["metadata"])
        graph.add_edge(start, end, **properties)
    return graph


def _check(value: Any, *, in_list: bool = False) -> None:
    """What the loader can take as metadata."""
    if isinstance(value, dict) and not in_list:
        for inner in value.values():
            _check(inner)
    elif isinstance(value, list) and not in_list:
        for inner in value:
            _check(inner, in_list=True)
    else:
        assert isinstance(value, (bool, int, float, str)), f"{value!r} cannot be metadata"
