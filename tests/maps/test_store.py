from __future__ import annotations

import csv
import dataclasses
import hashlib
import json
import math
from pathlib import Path
from typing import Any

import cv2
import jsonschema
import networkx as nx
import numpy as np
import pytest

from specmap_cli.core.config import Config
from specmap_cli.core.errors import MapError
from specmap_cli.core.geometry import Pose2
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.grids.map_server import read_grid
from specmap_cli.maps import schema
from specmap_cli.maps.store import MapResult, read_map, write_map, write_segmentation
from specmap_cli.topology.regions import NOBODY, Regions, divide
from specmap_cli.topology.topological_map import Edge, LogInfo, Submap, TopologicalMap
from tests.house import whole_of

FILES = {
    "classifiers.json",
    "labels.csv",
    "map.png",
    "map.yaml",
    "overview.png",
    "run.json",
    "submaps/000.png",
    "submaps/000.yaml",
    "submaps/001.png",
    "submaps/001.yaml",
    "submaps/002.png",
    "submaps/002.yaml",
    "topology.json",
    "trajectory.g2o",
    "trajectory.tum",
}


@pytest.fixture
def stored(tmp_path: Path, result: MapResult) -> Path:
    out = tmp_path / "out"
    out.mkdir()
    write_map(out, result)
    return out


def digests(directory: Path) -> dict[str, str]:
    return {
        str(path.relative_to(directory)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(directory.rglob("*"))
        if path.is_file()
    }


def edit(path: Path, **changes: Any) -> None:
    """Change keys of a JSON file; `graph__frame` reaches into `graph`."""
    document = json.loads(path.read_text())
    for key, value in changes.items():
        *parents, last = key.split("__")
        place = document
        for parent in parents:
            place = place[int(parent) if parent.isdigit() else parent]
        place[last] = value
    path.write_text(json.dumps(document))


def test_all_files_and_no_other(stored: Path) -> None:
    assert set(digests(stored)) == FILES


def test_the_same_bytes_every_time(stored: Path, tmp_path: Path, result: MapResult) -> None:
    again = tmp_path / "again"
    again.mkdir()
    write_map(again, result)
    assert digests(again) == digests(stored)


def test_topology_follows_its_schema(stored: Path) -> None:
    document = json.loads((stored / "topology.json").read_text())
    jsonschema.Draft202012Validator.check_schema(schema.json_schema())
    jsonschema.validate(document, schema.json_schema())
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({**document, "nodes": [{"id": 0}]}, schema.json_schema())


def test_the_shipped_schema_is_that_of_the_models() -> None:
    shipped = json.loads(schema.SCHEMA_FILE.read_text())
    assert shipped == schema.json_schema(), "run specmap_cli.maps.schema.write_schema()"


def test_networkx_reads_topology_as_it_is(stored: Path) -> None:
    document = json.loads((stored / "topology.json").read_text())
    graph = nx.node_link_graph(document, edges="edges")
    assert list(graph.nodes) == [0, 1, 2]
    assert sorted(graph.edges) == [(0, 1), (0, 2)]
    assert graph.edges[0, 1]["kind"] == "traversed"
    assert graph.graph["log"]["scans"] == 30
    assert nx.is_connected(graph)


def test_numbers_in_topology(stored: Path) -> None:
    text = (stored / "topology.json").read_text()
    document = json.loads(text)
    assert text.endswith("}\n")
    assert "NaN" not in text
    assert document["graph"]["closures"][1]["score"] is None
    assert document["graph"]["log"]["start"] == 1_700_000_000.123456
    assert json.dumps(document) == json.dumps(document, sort_keys=True)
    corridor, room, _ = document["nodes"]
    assert corridor["area_m2"] == pytest.approx(24.0, rel=1e-3)
    assert room["centroid"] == pytest.approx([-3.0, 3.5], abs=0.1)
    link, closure = document["edges"]
    assert (link["x"], link["y"]) == (-3.0, 1.25)
    way = math.dist(corridor["centroid"], (-3.0, 1.25)) + math.dist((-3.0, 1.25), room["centroid"])
    assert link["distance_m"] == pytest.approx(way, abs=1e-5)
    assert closure["x"] is None


def test_there_and_back(stored: Path, result: MapResult) -> None:
    read = read_map(stored)
    topology, written = read.topology, result.topology
    assert read.ids == [0, 1, 2]
    assert topology.edges == written.edges
    assert topology.closures[0] == written.closures[0]
    assert math.isnan(topology.closures[1].score)
    for id_, submap in written.submaps.items():
        back = topology.submaps[id_]
        assert (back.grid.cells == submap.grid.cells).all()
        assert back.grid.origin == pytest.approx(submap.grid.origin)
        assert back.keyframes == submap.keyframes
        assert tuple(back.map_from_submap) == pytest.approx(tuple(submap.map_from_submap))
        assert back.visits[0].start_ns == submap.visits[0].start_ns // 1000 * 1000
        assert back.polygon is not None
        assert np.abs(back.polygon).max() < 6.1
    assert read.classifiers == "{}\n"
    assert read.config == Config()
    assert (read.labels.submaps == result.labels.submaps).all()
    assert (read.labels.stamps_ns == result.labels.stamps_ns).all()
    assert read.labels.poses == pytest.approx(result.labels.poses, abs=1e-6)


def test_written_again_from_what_was_read(stored: Path, tmp_path: Path, result: MapResult) -> None:
    """Nothing is lost but what rounding took before."""
    read = read_map(stored)
    again = tmp_path / "again"
    again.mkdir()
    write_map(again, dataclasses.replace(result, topology=read.topology, labels=read.labels))
    before, after = (json.loads((d / "topology.json").read_text()) for d in (stored, again))
    assert after["edges"] == before["edges"]
    assert after["graph"] == before["graph"]


def test_grids_are_read_when_asked_for(stored: Path) -> None:
    (stored / "submaps" / "001.png").unlink()
    read = read_map(stored)
    assert read.grid(0).free_area_m2 == pytest.approx(24.0)
    assert read.grid(0) is read.grid(0)
    with pytest.raises(MapError, match=r"001\.png"):
        read.grid(1)


def test_the_grid_of_the_whole_map_is_that_of_the_regions(
    tmp_path: Path, result: MapResult
) -> None:
    whole = GridMap(np.zeros((40, 50), dtype=np.uint8), 0.1, (-2.0, -2.0))
    regions = divide(whole, result.labels)
    write_map(tmp_path, dataclasses.replace(result, regions=regions))
    assert read_grid(tmp_path / "map.yaml").cells.shape == (40, 50)


def test_a_submap_that_owns_nothing_is_written(tmp_path: Path, result: MapResult) -> None:
    empty = GridMap(np.full((3, 3), 2, dtype=np.uint8), 0.1)
    submaps = {**result.topology.submaps}
    submaps[2] = dataclasses.replace(submaps[2], grid=empty)
    topology = TopologicalMap(submaps, result.topology.edges, [])
    regions = divide(whole_of(submaps.values()), result.labels)
    write_map(tmp_path, dataclasses.replace(result, topology=topology, regions=regions))
    node = read_map(tmp_path).record.nodes[2]
    assert (node.centroid, node.polygon, node.area_m2) == (None, [], 0.0)


def test_a_map_without_links(tmp_path: Path, result: MapResult) -> None:
    only = TopologicalMap({0: result.topology.submaps[0]}, {}, [])
    write_map(tmp_path, dataclasses.replace(result, topology=only))
    assert read_map(tmp_path).topology.edges == {}


def test_a_finished_map_cut_into_regions(tmp_path: Path) -> None:
    grid = GridMap(np.zeros((20, 40), dtype=np.uint8), 0.1, (1.0, 2.0))
    owner = np.zeros((20, 40), dtype=np.int64)
    owner[:, 20:] = 1
    owner[0, :] = NOBODY
    submaps = {}
    for id_ in (0, 1):
        cells = np.where(owner == id_, 0, 2).astype(np.uint8)
        part = GridMap(cells, grid.resolution, grid.origin)
        submaps[id_] = Submap(id_, Pose2(0.0, 0.0, 0.0), [], [], part)
    edges = {(0, 1): Edge(0, 1, "doorway", doorway=(3.0, 3.0), width_m=1.9)}
    topology = TopologicalMap(submaps, edges)
    write_segmentation(
        tmp_path,
        topology,
        Regions.of(grid, owner),
        LogInfo("plan.yaml"),
        np.zeros((5, 5, 3), np.uint8),
    )
    labels = cv2.imread(str(tmp_path / "labels.png"), cv2.IMREAD_UNCHANGED)
    assert labels is not None
    assert labels.dtype == np.uint16
    assert (labels == owner[::-1] + 1).all()
    edge = read_map(tmp_path).topology.edges[0, 1]
    assert (edge.kind, edge.crossing, edge.width_m) == ("doorway", (3.0, 3.0), 1.9)
    assert (tmp_path / "overview.png").is_file()
    with pytest.raises(MapError, match="classifiers"):
        _ = read_map(tmp_path).classifiers


def test_labels_csv(stored: Path) -> None:
    with (stored / "labels.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["stamp", "x", "y", "theta", "submap"]
    assert len(rows) == 30
    assert rows[0]["stamp"] == "1700000000.123456789"
    assert [row["submap"] for row in rows[8:12]] == ["0", "0", "1", "1"]


def test_trajectory_tum(stored: Path, result: MapResult) -> None:
    table = np.loadtxt(stored / "trajectory.tum")
    assert table.shape == (30, 8)
    assert table[:, 1:3] == pytest.approx(result.trajectory.poses[:, :2], abs=1e-6)
    yaw = 2.0 * np.arctan2(table[:, 6], table[:, 7])
    turn = yaw - result.trajectory.poses[:, 2]
    assert np.cos(turn) == pytest.approx(np.ones(30))
    first = (stored / "trajectory.tum").read_text().splitlines()[0].split()
    assert first[0] == "1700000000.123456789"
    assert [len(number.split(".")[1]) for number in first] == [9, 6, 6, 6, 9, 9, 9, 9]


class TestDamage:
    @pytest.mark.parametrize(
        ("changes", "complaint"),
        [
            ({"graph__schema_version": 2}, r"graph\.schema_version is 2"),
            ({"graph": 5}, r"graph\.schema_version is None"),
            ({"nodes__0__area_m2": "large"}, r"nodes\.0\.area_m2"),
            ({"nodes__1__id": 0}, "occurs twice"),
            ({"edges__0__target": 9}, "submap 9 is not among the nodes"),
            ({"nodes__0__image": "../../etc/passwd"}, r"nodes\.0\.image"),
            ({"nodes__0__image": "/etc/passwd"}, r"nodes\.0\.image"),
            ({"nodes__0__image": "submaps\\000.png"}, r"nodes\.0\.image"),
            ({"nodes__0__image": ""}, r"nodes\.0\.image"),
            ({"edges__1__kind": "tunnel"}, r"edges\.1\.kind"),
            ({"nodes__0__surprise": 1}, "surprise"),
        ],
    )
    def test_topology(self, stored: Path, changes: dict[str, Any], complaint: str) -> None:
        edit(stored / "topology.json", **changes)
        with pytest.raises(MapError, match=complaint) as caught:
            read_map(stored)
        assert "\n" not in str(caught.value)
        assert "topology.json" in str(caught.value)

    @pytest.mark.parametrize("text", ["", "{", "[]", "null", "[" * 100_000, '{"graph": NaN}'])
    def test_topology_that_is_no_map(self, stored: Path, text: str) -> None:
        (stored / "topology.json").write_text(text)
        with pytest.raises(MapError, match=r"topology\.json"):
            read_map(stored)

    def test_infinite_numbers(self, stored: Path) -> None:
        path = stored / "topology.json"
        path.write_text(path.read_text().replace('"theta": 0.0', '"theta": Infinity', 1))
        with pytest.raises(MapError, match="theta"):
            read_map(stored)

    def test_no_directory(self, tmp_path: Path) -> None:
        with pytest.raises(MapError, match="no such map"):
            read_map(tmp_path / "gone")
        (tmp_path / "file").write_text("")
        with pytest.raises(MapError, match="is a file"):
            read_map(tmp_path / "file")

    def test_empty_and_foreign_directories(self, tmp_path: Path) -> None:
        with pytest.raises(MapError, match="is empty"):
            read_map(tmp_path)
        (tmp_path / "thesis.tex").write_text("")
        with pytest.raises(MapError, match="is not a map"):
            read_map(tmp_path)

    @pytest.mark.parametrize(
        ("name", "field"),
        [
            ("classifiers.json", "classifiers"),
            ("labels.csv", "labels"),
            ("run.json", "config"),
            ("map.yaml", "map_grid"),
        ],
    )
    def test_missing_and_binary_files(self, stored: Path, name: str, field: str) -> None:
        (stored / name).write_bytes(b"\xff\xfe\x00\x01")
        with pytest.raises(MapError, match=name):
            getattr(read_map(stored), field)
        (stored / name).unlink()
        with pytest.raises(MapError, match=name):
            getattr(read_map(stored), field)

    @pytest.mark.parametrize(
        ("line", "complaint"),
        [("1.0,2,3", "line 2"), ("1.0,a,0,0,0", "line 2"), ("x,0,0,0,0", "line 2")],
    )
    def test_labels(self, stored: Path, line: str, complaint: str) -> None:
        (stored / "labels.csv").write_text("stamp,x,y,theta,submap\n" + line + "\n")
        with pytest.raises(MapError, match=complaint):
            _ = read_map(stored).labels

    def test_configuration(self, stored: Path) -> None:
        edit(stored / "run.json", config__grid__resolution_m=-1)
        with pytest.raises(MapError, match=r"config: grid\.resolution_m"):
            _ = read_map(stored).config
