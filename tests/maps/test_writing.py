"""Writing map directories: every file, the same bytes every time."""

from __future__ import annotations

import json
import math
import os
import tempfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.errors import MapError
from specmap_cli.core.geometry import Pose2
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.maps.store import read_map
from specmap_cli.maps.writing import MapResult, write_map, write_segmentation
from specmap_cli.topology.regions import NOBODY, Regions
from specmap_cli.topology.topological_map import Edge, LogInfo, Submap, TopologicalMap
from tests.strategies import seeds

FILES = {
    *("classifiers.json", "labels.csv", "map.png", "map.yaml", "overview.png", "run.json"),
    *(f"submaps/00{id_}.{end}" for id_ in range(3) for end in ("png", "yaml")),
    *("topology.json", "trajectory.g2o", "trajectory.tum"),
}


def files_in(directory: Path) -> dict[str, bytes]:
    found = (path for path in directory.rglob("*") if path.is_file())
    return {str(path.relative_to(directory)): path.read_bytes() for path in found}


def test_all_files_and_no_other_the_same_bytes_every_time(
    stored: Path, tmp_path: Path, result: MapResult
) -> None:
    assert set(files_in(stored)) == FILES
    again = tmp_path / "again"
    again.mkdir()
    write_map(again, result)
    assert files_in(again) == files_in(stored)


def test_numbers_in_topology(stored: Path) -> None:
    text = (stored / "topology.json").read_text()
    document = json.loads(text)
    assert text.endswith("}\n")
    assert "NaN" not in text
    assert document["graph"]["closures"][1]["score"] is None
    assert document["graph"]["logs"][0]["start"] == 1_700_000_000.123456
    assert json.dumps(document) == json.dumps(document, sort_keys=True)
    corridor, room, _ = document["nodes"]
    assert corridor["area_m2"] == pytest.approx(24.0, rel=1e-3)
    assert room["centroid"] == pytest.approx([-3.0, 3.5], abs=0.1)
    link, closure = document["edges"]
    assert (link["x"], link["y"]) == (-3.0, 1.25)
    way = math.dist(corridor["centroid"], (-3.0, 1.25)) + math.dist((-3.0, 1.25), room["centroid"])
    assert link["distance_m"] == pytest.approx(way, abs=1e-5)
    assert closure["x"] is None


def test_a_finished_map_cut_into_regions(tmp_path: Path) -> None:
    grid = GridMap(np.zeros((20, 40), dtype=np.uint8), 0.1, (1.0, 2.0))
    owner = np.zeros((20, 40), dtype=np.int64)
    owner[:, 20:] = 1
    owner[0, :] = NOBODY
    submaps = {}
    for id_ in (0, 1):
        cells = np.where(owner == id_, 0, 2).astype(np.uint8)
        part = GridMap(cells, grid.resolution, grid.origin)
        submaps[id_] = Submap(id=id_, map_from_submap=Pose2(0.0, 0.0, 0.0), grid=part)
    edge = Edge(source=0, target=1, kind="doorway", x=3.0, y=3.0, width_m=1.9)
    topology = TopologicalMap(submaps=submaps, edges={(0, 1): edge})
    picture = np.zeros((5, 5, 3), np.uint8)
    write_segmentation(tmp_path, topology, Regions.of(grid, owner), LogInfo("plan.yaml"), picture)
    edge = read_map(tmp_path).topology.edges[0, 1]
    assert (edge.kind, edge.crossing, edge.width_m) == ("doorway", (3.0, 3.0), 1.9)
    assert (tmp_path / "overview.png").is_file()
    with pytest.raises(MapError, match="classifiers"):
        _ = read_map(tmp_path).classifiers


@pytest.mark.parametrize("kind", [str, Path])
def test_the_frame_the_directory_and_the_picture_may_be_given(
    tmp_path: Path, result: MapResult, kind: type
) -> None:
    picture = np.random.default_rng(0).integers(0, 256, (20, 30, 3), dtype=np.uint8)
    changed = replace(result, frame="building_7", overview=picture)
    write_map(kind(tmp_path), changed)
    assert read_map(kind(tmp_path)).record.graph.frame == "building_7"
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "overview.png")), picture)


def test_run_json_is_plain_json(tmp_path: Path, result: MapResult) -> None:
    run = {"b": np.float64("nan"), "a": {"n": np.int64(3), "inf": float("inf")}, "t": (1.5, 2)}
    write_map(tmp_path, replace(result, run=run))
    found = json.loads((tmp_path / "run.json").read_text())
    assert found == {"a": {"inf": None, "n": 3}, "b": None, "t": [1.5, 2]}
    assert list(found) == ["a", "b", "t"]


@given(seeds, st.integers(2, 30), st.integers(2, 30))
def test_labels_png_holds_any_division(seed: int, height: int, width: int) -> None:
    """Ids up to 65534 there and back, the picture upside down: its first row is the highest y."""
    rng = np.random.default_rng(seed)
    owner = rng.choice([NOBODY, 0, 7, 300, 65_534], size=(height, width))
    grid = GridMap(np.zeros((height, width), dtype=np.uint8), 0.1)
    regions = Regions(grid, owner, {})
    with tempfile.TemporaryDirectory() as folder:
        overview = np.zeros((2, 2, 3), dtype=np.uint8)
        write_segmentation(folder, TopologicalMap(), regions, LogInfo("plan"), overview)
        written = cv2.imread(f"{folder}/labels.png", cv2.IMREAD_UNCHANGED)
        assert written is not None
        assert written.dtype == np.uint16
        np.testing.assert_array_equal(written[::-1].astype(np.int64) - 1, owner)
        files = ["labels.png", "overview.png", "submaps", "topology.json"]
        assert sorted(os.listdir(folder)) == files
