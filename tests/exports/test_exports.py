"""Exports read back by the consumers' code: tables, GTSAM, Rerun, LCAS, and one from outside."""

import csv
import io
import json
import math
import sys
import zipfile
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import networkx as nx
import numpy as np
import pytest
import yaml

from specmap_cli.core.errors import MapError, UsageError
from specmap_cli.core.records import Labels
from specmap_cli.exports.table import GROUP, export_map, exporters
from specmap_cli.maps.store import Map
from specmap_cli.maps.writing import MapResult
from tests.exports.conftest import POSE_GRAPH, lengths_agree, with_submaps, written
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


Rows = list[dict[str, str]]


def tables(stored: Map, out: Path) -> dict[str, Rows]:
    assert export_map(stored, "csv", out) == []
    with zipfile.ZipFile(out) as archive:
        assert archive.testzip() is None
        texts = {name: archive.read(name).decode() for name in archive.namelist()}
    return {name: list(csv.DictReader(io.StringIO(text))) for name, text in texts.items()}


def test_the_rows_are_the_map_s(home: Map, tmp_path: Path) -> None:
    found = tables(home, tmp_path / "home.zip")
    record = home.record
    nodes, edges, doors = (found[f"{name}.csv"] for name in ("nodes", "edges", "doors"))
    assert [int(row["id"]) for row in nodes] == [node.id for node in record.nodes]
    assert [float(row["area_m2"]) for row in nodes] == [node.area_m2 for node in record.nodes]
    assert [(row["anchor_x"], row["anchor_y"]) for row in nodes][1] == ("-3.0", "3.5")
    assert [row["property.owner"] for row in nodes] == ["", "Ann", ""]
    lengths = [float(row["length_m"]) if row["length_m"] else None for row in edges]
    assert lengths == [edge.length_m for edge in record.edges]
    assert [row["passable"] for row in edges] == ["True", "True", "False"]
    assert [row["doors"] for row in edges] == ["0", "1", ""]
    sides = [(row["source"], row["target"], row["width_m"]) for row in doors]
    assert sides == [("0", "1", "0.9"), ("0", "2", "0.8")]


def test_what_a_person_noted_is_no_formula(lived_in: MapResult, tmp_path: Path) -> None:
    said = {"name": "=cmd|' /C calc'!A0", "properties": {"of": "@Ann", "floor": -2}}
    home = with_submaps(tmp_path / "home", lived_in, said)
    row = tables(home, tmp_path / "home.zip")["nodes.csv"][0]
    assert row["name"] == "'=cmd|' /C calc'!A0"
    assert (row["property.of"], row["property.floor"]) == ("'@Ann", "-2")


def test_empty_tables_have_headings_and_a_zip_is_not_csv(stored: Map, tmp_path: Path) -> None:
    tables(stored, tmp_path / "house.zip")
    with zipfile.ZipFile(tmp_path / "house.zip") as archive:
        text = archive.read("doors.csv").decode()
    assert text.startswith("id,source,target,x,y,width_m,")
    assert text.count("\n") == 1
    with pytest.raises(UsageError, match=r"house\.csv: a zip of .*: name it house\.zip"):
        export_map(stored, "csv", tmp_path / "house.csv")
    assert not (tmp_path / "house.csv").exists()


DOCS = Path(__file__).parents[2] / "docs"


def with_graph(directory: Path, result: MapResult, text: str) -> Map:
    return written(directory, replace(result, pose_graph=text))


def test_fixed_vertices_stand_last_one_a_part(lived_in: MapResult, tmp_path: Path) -> None:
    lines = POSE_GRAPH.splitlines(keepends=True)
    earlier = "".join([*lines[:3], lines[-1], *lines[3:-1]])  # as earlier versions wrote it
    for number, text in enumerate((POSE_GRAPH, earlier)):
        stored = with_graph(tmp_path / str(number), lived_in, text)
        assert export_map(stored, "pose-graph", tmp_path / f"{number}.g2o") == []
        assert (tmp_path / f"{number}.g2o").read_text() == POSE_GRAPH
    text = "VERTEX_SE2 7 5 5 0\nVERTEX_SE2 8 6 5 0\nEDGE_SE2 7 8 1 0 0 1 0 0 1 0 1\n" + POSE_GRAPH
    stored = with_graph(tmp_path / "map", lived_in, text)
    (warning,) = export_map(stored, "pose-graph", tmp_path / "x.g2o")
    assert warning.startswith("the pose graph is in 2 parts that no edge joins")
    assert (tmp_path / "x.g2o").read_text().endswith("FIX 0\nFIX 7\n")


def test_gtsam_reads_every_vertex_and_every_edge_and_solves_it(home: Map, tmp_path: Path) -> None:
    """Three springs: each takes a third of the 0.3 m, give or take what the angles take."""
    gtsam = consumer("gtsam")
    out = tmp_path / "home.g2o"
    export_map(home, "pose-graph", out)
    for path in (home.path / "trajectory.g2o", out):
        graph, values = gtsam.readG2o(str(path), False)
        assert (graph.size(), values.size()) == (3, 3)
    last = graph.at(2)
    assert last.measured().x() == 2.3
    assert np.allclose(last.noiseModel().information(), [[100, 1, 2], [1, 90, 3], [2, 3, 1000]])
    graph.addPriorPose2(0, gtsam.Pose2(), gtsam.noiseModel.Isotropic.Sigma(3, 1e-6))
    solved = gtsam.GaussNewtonOptimizer(graph, values).optimize()
    found = [solved.atPose2(number).x() for number in range(3)]
    assert found == pytest.approx([0.0, 1.1, 2.2], abs=1e-3)
    apart = max(abs(values.atPose2(number).x() - found[number]) for number in range(3))
    assert apart > 0.05  # the poses of the file are no solution of its edges, and docs say so
    told = " ".join(DOCS.joinpath("export.md").read_text(encoding="utf-8").split())
    assert "GTSAM's solution is off them" in told
    assert "by half a metre at one end" in told  # what the benchmark found; no bound of millimetres


def test_a_robot_that_never_moved_is_one_vertex(lived_in: MapResult, tmp_path: Path) -> None:
    zero = np.zeros(1, dtype=np.int64)
    one = Labels(stamps_ns=zero, poses=np.array([[1.0, 2.0, 0.5]]), submaps=zero)
    stored = written(tmp_path / "map", replace(lived_in, labels=one, pose_graph=""))
    assert export_map(stored, "pose-graph", tmp_path / "x.g2o") == []
    assert (tmp_path / "x.g2o").read_text() == "VERTEX_SE2 0 1 2 0.5\nFIX 0\n"


def test_a_map_without_one_is_refused_in_a_line(
    stored: Map, rooms: Map, lived_in: MapResult, tmp_path: Path
) -> None:
    lone = "EDGE_SE2 0 9 1 0 0 1 0 0 1 0 1\n"
    built = "a pose graph needs one that `specmap build` made of a recording"
    again = "build the map again"
    bad = with_graph(tmp_path / "bad", lived_in, "VERTEX_SE2 0 0\n")
    for case, found, hint in (
        (stored, "has no vertices", f"{again}, without `--no-relax`"),
        (rooms, "has no trajectory.g2o: `specmap segment` makes maps without", built),
        (with_graph(tmp_path / "1", lived_in, POSE_GRAPH + lone), "there is no vertex 9", again),
        (bad, "g2o, line 1: 'VERTEX_SE2 0 0' is no VERTEX_SE2", again),
    ):
        with pytest.raises(MapError) as told:
            export_map(case, "pose-graph", tmp_path / "x.g2o")
        assert (told.value.found, told.value.hint) == (found, hint)
    assert not (tmp_path / "x.g2o").exists()


Columns = dict[str, list[dict[str, Any]]]


def rows(stored: Map, out: Path) -> Columns:
    consumer("rerun")
    chunks = consumer("rerun.chunk")
    assert export_map(stored, "rerun", out) == []
    found: Columns = defaultdict(list)
    for chunk in chunks.RrdReader(str(out)).stream():
        found[chunk.entity_path.removeprefix("/")] += chunk.to_record_batch().to_pylist()
    return found


def test_graph_submaps_poses_and_scans_are_the_map_s(home: Map, tmp_path: Path) -> None:
    found = rows(home, tmp_path / "home.rrd")
    record = home.record
    links = [entity for entity in found if entity.startswith("graph/links/")]
    assert len(links) == len(record.edges)
    assert len([entity for entity in found if entity.startswith("graph/doors/")]) == 2
    for edge in record.edges:
        (row,) = found[f"graph/links/{edge.source}-{edge.target}"]
        if edge.corners:
            ((strip,),) = (row["LineStrips3D:strips"],)
            line = np.array(strip)[:, :2]
            assert np.hypot(*np.diff(line, axis=0).T).sum() == pytest.approx(edge.length_m, 1e-5)
            assert float(row["length_m"][0]) == edge.length_m
    for node in record.nodes:
        (row,) = found[f"submaps/{node.id}"]
        assert row["Points3D:labels"] == [node.name]
        assert row["kind"] == [node.kind]
        assert tuple(row["Points3D:positions"][0][:2]) == pytest.approx(node.anchor)
    assert {"map", "regions", "trajectory"} <= found.keys()
    poses = sorted(found["robot"], key=lambda row: row["time"])
    places = [row["Transform3D:translation"][0][:2] for row in poses]
    assert np.allclose(places, home.labels.poses[:, :2], atol=1e-5)
    points = [len(row["Points3D:positions"]) for row in found["robot/scan"]]
    assert points == [17] * 30  # of 19, two without return


def test_without_the_sdk_the_line_says_what_to_install(
    home: Map, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(UsageError, match=r"pip install 'specmap-cli\[rerun\]'"):
        export_map(home, "rerun", tmp_path / "home.rrd")
    assert not (tmp_path / "home.rrd").exists()


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
