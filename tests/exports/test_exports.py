"""Exports of the small house, read back by the consumers' own code, and one from outside."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import networkx as nx
import numpy as np
import pytest

from specmap_cli.core.errors import UsageError
from specmap_cli.exports.table import GROUP, export_map, exporters
from specmap_cli.maps.store import Map
from tests.exports.consumers import consumer
from tests.plugins import install


def geojson(stored: Map, folder: Path) -> Any:
    out = folder / f"{stored.path.name}.geojson"
    export_map(stored, "geojson", out)
    return json.loads(out.read_text())


def test_graphml_is_the_map_s_graph(stored: Map, home: Map, rooms: Map, tmp_path: Path) -> None:
    for each in (home, rooms, stored):
        record, out = each.record, tmp_path / f"{each.path.name}.graphml"
        export_map(each, "graphml", out)
        graph = nx.read_graphml(out, node_type=int)
        document = json.loads((each.path / "topology.json").read_text())
        own = nx.node_link_graph(document, edges="edges")
        assert sorted(graph.nodes) == [node.id for node in record.nodes]
        ends = {(edge.source, edge.target) for edge in record.edges}
        assert {tuple(sorted(pair)) for pair in graph.edges} == ends
        for node in record.nodes:
            found = graph.nodes[node.id]
            assert (found["x"], found["y"]) == pytest.approx(node.centroid)
            assert (found["name"], found["kind"]) == (node.name, node.kind)
            assert found["area_m2"] == pytest.approx(node.area_m2)
            assert (found.get("anchor_x"), found.get("anchor_y")) == (node.anchor or (None, None))
        for edge in record.edges:
            found = graph.edges[edge.source, edge.target]
            assert (found["kind"], found["passable"]) == (edge.kind, edge.path is not None)
            assert found["distance_m"] == pytest.approx(edge.distance_m)
            assert found["doors"] == " ".join(map(str, edge.doors))
            assert own.edges[edge.source, edge.target]["length_m"] == edge.length_m
            for name in ("length_m", "clearance_m"):
                assert found.get(name) == getattr(edge, name)
        widths = [door["width_m"] for door in own.graph["doors"]]
        assert widths == [door.width_m for door in record.graph.doors]
    nodes, driven, closure = graph.nodes, graph.edges[0, 1], graph.edges[0, 2]  # of the house
    assert [nodes[id_]["kind"] for id_ in (0, 1, 2)] == ["corridor", "room", "room"]
    assert [nodes[id_]["scans"] for id_ in (0, 1, 2)] == [10] * 3
    assert (nodes[1]["property.floor"], nodes[1]["property.heated"]) == (2, True)
    assert "property.floor" not in nodes[0]
    assert (driven["kind"], driven["traversals"]) == ("traversed", 1)
    assert "x" not in closure  # it was never crossed


def test_geojson_has_outlines_links_doors_and_ways(stored: Map, home: Map, tmp_path: Path) -> None:
    document = geojson(stored, tmp_path)
    assert document["type"] == "FeatureCollection"
    kinds = [feature["geometry"]["type"] for feature in document["features"]]
    assert kinds == ["Polygon"] * 3 + ["LineString"] * 2
    for feature, node in zip(document["features"], stored.record.nodes, strict=False):
        (ring,) = feature["geometry"]["coordinates"]
        assert [tuple(point) for point in ring] == [*node.polygon, node.polygon[0]]
        facts = feature["properties"]
        assert (facts["id"], facts["submap_kind"]) == (node.id, node.kind)
        assert facts["properties"] == node.properties
    driven, closure = document["features"][3:]  # without ways, through their crossings
    assert [len(link["geometry"]["coordinates"]) for link in (driven, closure)] == [3, 2]
    assert driven["properties"]["traversals"] == 1
    features = geojson(home, tmp_path)["features"]
    by_kind = {feature["properties"]["kind"]: feature for feature in features[::-1]}
    shapes = {kind: feature["geometry"]["coordinates"] for kind, feature in by_kind.items()}
    assert shapes["anchor"] == [0.0, 0.5]
    assert math.dist(*shapes["door"]) == pytest.approx(0.9, abs=1e-5)
    assert np.mean(shapes["door"], axis=0) == pytest.approx((-3.0, 1.25))
    assert by_kind["door"]["properties"]["driven"] is False
    assert shapes["traversed"] == [[0.0, 0.5], [-3.0, 1.0], [-3.0, 3.5]]
    way = by_kind["traversed"]["properties"]
    assert way["length_m"] == pytest.approx(home.record.edges[0].length_m)
    assert (way["passable"], by_kind["seen"]["properties"]["passable"]) == (True, False)


def test_the_same_map_gives_the_same_bytes(home: Map, tmp_path: Path) -> None:
    for name in exporters().keys() - {"rerun"}:  # whose files hold random numbers
        for out in ("a", "b"):
            export_map(home, name, tmp_path / out, overwrite=True)
        assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


NAMES = """
class Names:
    description = "the names of the submaps"

    def write(self, stored, target, progress):
        progress.warn("names are not unique")
        for node in stored.record.nodes:
            target.write(f"{node.name}\\n".encode())


class Broken:
    description = "fails half way"

    def write(self, stored, target, progress):
        target.write(b"half")
        raise OSError(28, "No space left on device")
"""


def test_another_package_adds_a_format_and_one_that_fails_leaves_nothing(
    stored: Map, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path, monkeypatch, GROUP, {"names": "Names", "broken": "Broken"}, NAMES)
    assert exporters()["names"].description == "the names of the submaps"
    place = tmp_path / "place"  # Python leaves the compiled package beside the package
    place.mkdir()
    with pytest.raises(UsageError, match="No space left"):
        export_map(stored, "broken", place / "x")
    assert list(place.iterdir()) == []
    assert export_map(stored, "names", place / "names.txt") == ["names are not unique"]
    assert (place / "names.txt").read_text() == "submap 0\nsubmap 1\nsubmap 2\n"


def test_gis_tools_measure_shapes_in_metres(home: Map, rooms: Map, tmp_path: Path) -> None:
    shapely = consumer("shapely.geometry")
    for stored in (home, rooms):
        document = geojson(stored, tmp_path)
        assert document["crs"]["properties"]["name"].endswith("EPSG::3857")
        features = document["features"]
        assert [feature["id"] for feature in features] == list(range(len(features)))
        shapes = [(shapely.shape(one["geometry"]), one["properties"]) for one in features]
        assert all(shape.is_valid for shape, _ in shapes)
        ways = [(shape, facts) for shape, facts in shapes if facts.get("length_m") is not None]
        assert len(ways) == len([edge for edge in stored.record.edges if edge.corners])
        for shape, facts in ways:
            assert shape.length == pytest.approx(facts["length_m"], abs=1e-5)


def test_evo_reads_the_trajectory(home: Map) -> None:
    interface = consumer("evo.tools.file_interface")
    found = interface.read_tum_trajectory_file(str(home.path / "trajectory.tum"))
    assert found.check()[0]
    assert np.allclose(found.positions_xyz[:, :2], home.labels.poses[:, :2], atol=1e-5)
