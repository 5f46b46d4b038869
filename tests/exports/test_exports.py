"""Exports of the small house, read back by the consumers' own code, and one from outside."""

from __future__ import annotations

import json
from pathlib import Path

import networkx as nx
import pytest

from specmap_cli.core.errors import UsageError
from specmap_cli.exports.table import GROUP, export_map, exporters
from specmap_cli.maps.store import StoredMap, read_map
from specmap_cli.maps.writing import MapResult, write_map
from tests.plugins import install


@pytest.fixture
def stored(tmp_path: Path, result: MapResult) -> StoredMap:
    out = tmp_path / "out"
    out.mkdir()
    write_map(out, result)
    return read_map(out)


def test_graphml_is_the_graph_that_networkx_reads(stored: StoredMap, tmp_path: Path) -> None:
    export_map(stored, "graphml", tmp_path / "house.graphml")
    graph = nx.read_graphml(tmp_path / "house.graphml", node_type=int)
    record = stored.record
    assert sorted(graph.nodes) == [node.id for node in record.nodes]
    assert {tuple(sorted(edge)) for edge in graph.edges} == {(0, 1), (0, 2)}
    for node in record.nodes:
        assert node.centroid is not None
        found = graph.nodes[node.id]
        assert (found["x"], found["y"]) == pytest.approx(node.centroid)
        assert (found["name"], found["scans"]) == (node.name, 10)
        assert found["area_m2"] == pytest.approx(node.area_m2)
    assert [graph.nodes[id_]["kind"] for id_ in (0, 1, 2)] == ["corridor", "room", "room"]
    assert (graph.nodes[1]["property.floor"], graph.nodes[1]["property.heated"]) == (2, True)
    assert "property.floor" not in graph.nodes[0]
    assert graph.edges[0, 1]["kind"] == "traversed"
    assert graph.edges[0, 1]["traversals"] == 1
    assert graph.edges[0, 1]["distance_m"] == pytest.approx(record.edges[0].distance_m)
    assert "x" not in graph.edges[0, 2]  # a closure was never crossed


def test_geojson_has_closed_outlines_and_links_through_their_crossings(
    stored: StoredMap, tmp_path: Path
) -> None:
    export_map(stored, "geojson", tmp_path / "house.geojson")
    document = json.loads((tmp_path / "house.geojson").read_text())
    assert document["type"] == "FeatureCollection"
    kinds = [feature["geometry"]["type"] for feature in document["features"]]
    assert kinds == ["Polygon"] * 3 + ["LineString"] * 2
    for feature, node in zip(document["features"], stored.record.nodes, strict=False):
        (ring,) = feature["geometry"]["coordinates"]
        assert ring[0] == ring[-1]
        assert [tuple(point) for point in ring[:-1]] == node.polygon
        assert feature["properties"]["id"] == node.id
        assert feature["properties"]["submap_kind"] == node.kind
        assert feature["properties"]["properties"] == node.properties
    driven, closure = document["features"][3:]
    assert len(driven["geometry"]["coordinates"]) == 3
    assert len(closure["geometry"]["coordinates"]) == 2
    assert driven["properties"]["traversals"] == 1


def test_the_same_map_gives_the_same_bytes(stored: StoredMap, tmp_path: Path) -> None:
    for name in exporters():
        for out in ("a", "b"):
            export_map(stored, name, tmp_path / out, overwrite=True)
        assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_a_format_nobody_knows_lists_those_there_are(stored: StoredMap, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="unknown format 'svg': choose from geojson, graphml"):
        export_map(stored, "svg", tmp_path / "house.svg")
    assert not (tmp_path / "house.svg").exists()


def test_a_file_is_replaced_only_when_asked_to(stored: StoredMap, tmp_path: Path) -> None:
    out = tmp_path / "house.graphml"
    out.write_text("mine")
    with pytest.raises(UsageError, match="exists already"):
        export_map(stored, "graphml", out)
    assert out.read_text() == "mine"
    export_map(stored, "graphml", str(out), overwrite=True)
    assert "graphml" in out.read_text()


NAMES = """
class Names:
    description = "the names of the submaps"

    def write(self, stored, target):
        for node in stored.record.nodes:
            target.write(f"{node.name}\\n".encode())


class Broken:
    description = "fails half way"

    def write(self, stored, target):
        target.write(b"half")
        raise OSError(28, "No space left on device")
"""


def test_another_package_adds_a_format(
    stored: StoredMap, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path, monkeypatch, GROUP, {"names": "Names"}, NAMES)
    assert exporters()["names"].description == "the names of the submaps"
    export_map(stored, "names", tmp_path / "names.txt")
    assert (tmp_path / "names.txt").read_text() == "submap 0\nsubmap 1\nsubmap 2\n"


def test_an_export_that_fails_leaves_nothing(
    stored: StoredMap, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path, monkeypatch, GROUP, {"broken": "Broken"}, NAMES)
    before = set(tmp_path.iterdir())
    with pytest.raises(UsageError, match="No space left"):
        export_map(stored, "broken", tmp_path / "x")
    assert set(tmp_path.iterdir()) == before
