"""The topological map for LCAS, read by the rules of its manager, its validator and its graph."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jsonschema
import networkx as nx
import numpy as np
import pytest
import yaml

from specmap_cli.exports.table import export_map
from specmap_cli.maps.store import Map
from tests.exports.conftest import lengths_agree

TEXT, OBJECT = {"type": "string"}, {"type": "object"}
# What the consumer's schema asks for, in our words.
STAMP = {"pattern": r"^\d{4}-\d\d-\d\d_\d\d-\d\d-\d\d$"}
EDGES = {"items": {"required": ["edge_id", "node", "action", "action_type"]}}
NODE = {
    "required": ["edges", "name", "parent_frame", "pose", "verts"],
    "properties": {"name": TEXT, "parent_frame": TEXT, "properties": OBJECT, "edges": EDGES},
}
ENTRY = {
    "required": ["meta", "node"],
    "properties": {"meta": {"required": ["map", "node", "pointset"]}, "node": NODE},
}
RULES = {
    **OBJECT,
    "required": ["meta", "metric_map", "name", "nodes", "pointset", "transformation"],
    "properties": {
        "meta": {"required": ["last_updated"], "properties": {"last_updated": STAMP}},
        **dict.fromkeys(("metric_map", "name", "pointset"), TEXT),
        "nodes": {"type": "array", "items": ENTRY},
    },
}


def document(stored: Map, out: Path) -> Any:
    export_map(stored, "tmap2", out, overwrite=True)
    return yaml.safe_load(out.read_text(encoding="utf-8"))


def graph_of(found: Any) -> nx.DiGraph:
    """As the consumer's navigation makes it: edges weighed by their property `weight`."""
    graph = nx.DiGraph()
    for entry in found["nodes"]:
        node = entry["node"]
        assert entry["meta"]["node"] == node["name"]
        assert node["name"] not in graph
        position, turn = node["pose"]["position"], node["pose"]["orientation"]
        assert all(isinstance(position[axis], float) for axis in "xyz")
        assert all(isinstance(turn[axis], float) for axis in "xyzw")
        graph.add_node(node["name"], x=position["x"], y=position["y"], **node)
    for entry in found["nodes"]:
        for edge in entry["node"]["edges"]:
            assert edge["node"] in graph, "an edge to a node that exists"
            assert edge["edge_id"] == f"{entry['node']['name']}_{edge['node']}"
            weight = edge["properties"]["weight"]
            assert isinstance(weight, float)
            graph.add_edge(entry["node"]["name"], edge["node"], weight=weight)
    return graph


def test_the_manager_reads_the_figures_of_the_map(home: Map, rooms: Map, tmp_path: Path) -> None:
    for stored in (home, rooms):
        found = document(stored, tmp_path / "map.tmap2")
        jsonschema.validate(found, RULES)
        assert {"parent", "child", "rotation", "translation"} <= found["transformation"].keys()
        graph = graph_of(found)
        ways = [edge for edge in stored.record.edges if edge.corners]
        passed = sum(len(edge.doors) for edge in ways)
        assert len(graph) == len(stored.record.nodes) + passed
        assert graph.number_of_edges() == 2 * (len(ways) + passed)
        lengths_agree(graph, stored, {id_: f"Submap{id_}" for id_ in stored.ids}, "weight")


def test_a_zone_is_the_outline_of_its_submap_seen_from_the_node(home: Map, tmp_path: Path) -> None:
    found = document(home, tmp_path / "home.tmap2")
    nodes = {entry["node"]["name"]: entry["node"] for entry in found["nodes"]}
    kitchen, record = nodes["Submap1"], home.record.nodes[1]
    corners = np.array([[corner["x"], corner["y"]] for corner in kitchen["verts"]])
    place = kitchen["pose"]["position"]
    assert np.allclose(corners + [place["x"], place["y"]], record.polygon, atol=1e-5)
    assert kitchen["properties"]["label"] == "submap 1"
    assert max([abs(corner["x"]) for corner in nodes["Door0"]["verts"]]) == pytest.approx(0.45)
