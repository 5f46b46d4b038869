"""Map directories are written, the same bytes every time, and read; damage is told in a line.

Maps of schema 1 are read; `topology_1.json` is `tests.house` as that version wrote it.
"""

import json
import math
import os
import re
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.errors import MapError
from specmap_cli.core.records import NO_SUBMAP
from specmap_cli.core.settings import Config, LimitsConfig
from specmap_cli.core.text import plain
from specmap_cli.exports.table import export_map
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.maps.schema import TopologyRecord, upgraded
from specmap_cli.maps.store import read_map
from specmap_cli.maps.writing import MapResult, write_map, write_segmentation
from specmap_cli.topology.regions import NOBODY, Regions
from specmap_cli.topology.topological_map import LogInfo, TopologicalMap
from tests.maps.conftest import edit
from tests.strategies import seeds
from tests.turning import turn

FILES = {
    *("classifiers.json", "labels.csv", "labels.png", "map.png", "map.yaml"),
    *(f"submaps/00{id_}.{end}" for id_ in range(3) for end in ("png", "yaml")),
    *("overview.png", "run.json", "topology.json", "trajectory.g2o", "trajectory.tum"),
}


def files_in(directory: Path) -> dict[str, bytes]:
    found = (path for path in directory.rglob("*") if path.is_file())
    return {str(path.relative_to(directory)): path.read_bytes() for path in found}


def test_the_same_files_every_time(stored: Path, tmp_path: Path, result: MapResult) -> None:
    assert set(files_in(stored)) == FILES
    again = tmp_path / "again"
    again.mkdir()
    write_map(again, result)
    assert files_in(again) == files_in(stored)


def test_the_division_is_read_or_made_where_it_is_missing(stored: Path, result: MapResult) -> None:
    np.testing.assert_array_equal(read_map(stored).regions.owner, result.regions.owner)
    (stored / "labels.png").unlink()
    assert set(np.unique(read_map(stored).regions.owner).tolist()) >= {0, 1, 2}
    cv2.imwrite(str(stored / "labels.png"), np.zeros((2, 2), dtype=np.uint16))
    with pytest.raises(MapError, match=r"labels\.png.*make the map again"):
        _ = read_map(stored).regions


@pytest.mark.parametrize("with_labels", [True, False])
def test_thresholds_that_leave_nothing_free_are_refused(stored: Path, with_labels: bool) -> None:
    path = stored / "map.yaml"
    path.write_text(re.sub(r"free_thresh: .*", "free_thresh: 1e-9", path.read_text()))
    edit(stored / "topology.json", graph__files={})  # as in maps of earlier versions
    if not with_labels:
        (stored / "labels.png").unlink()
    with pytest.raises(MapError, match=r"map\.yaml: its thresholds leave no free cell"):
        _ = read_map(stored).regions


def test_run_json_is_plain_json(tmp_path: Path, result: MapResult) -> None:
    run = {"b": np.float64("nan"), "a": {"n": np.int64(3), "inf": float("inf")}, "t": (1.5, 2)}
    write_map(tmp_path, replace(result, run=run))
    found = json.loads((tmp_path / "run.json").read_text())
    del found["labels_sha256"]
    assert found == {"a": {"inf": None, "n": 3}, "b": None, "t": [1.5, 2]}
    assert list(found) == ["a", "b", "t"]


@given(seeds, st.integers(2, 30), st.integers(2, 30))
def test_labels_png_holds_any_division(seed: int, height: int, width: int) -> None:
    """Ids up to 65534 there and back, the picture upside down: its first row is the highest y."""
    owner = np.random.default_rng(seed).choice([NOBODY, 0, 7, 300, 65_534], size=(height, width))
    grid = GridMap(np.zeros((height, width), dtype=np.uint8), 0.1)
    regions = Regions(grid, owner, {})
    with tempfile.TemporaryDirectory() as folder:
        overview = np.zeros((2, 2, 3), dtype=np.uint8)
        write_segmentation(folder, TopologicalMap(), regions, LogInfo("plan"), overview, grid)
        written = cv2.imread(f"{folder}/labels.png", cv2.IMREAD_UNCHANGED)
        assert written is not None
        assert written.dtype == np.uint16
        np.testing.assert_array_equal(written[::-1].astype(np.int64) - 1, owner)
        files = ["labels.png", "map.png", "map.yaml", "overview.png", "submaps", "topology.json"]
        assert sorted(os.listdir(folder)) == files


def door(other: int, **more: Any) -> dict[str, Any]:
    place = {"x": 0.0, "y": 0.0, "theta": 0.0, "width_m": 0.9}
    none = {"crossings": [], "driven": False, "forbidden": False}
    return {"id": 0, "between": [0, other], **none, **place, **more}


def test_grids_are_a_mapping_and_read_when_asked_for(stored: Path) -> None:
    (stored / "submaps" / "001.png").unlink()
    read = read_map(stored)
    assert (list(read.grids), len(read.grids)) == ([0, 1, 2], 3)
    assert 1 in read.grids
    assert read.grids[0].free_area_m2 == pytest.approx(24.0)
    assert read.grids[0] is read.grids[0]
    with pytest.raises(MapError, match=r"001\.png"):
        read.grids[1]
    for stranger in (3, -1):
        assert stranger not in read.grids
        assert read.grids.get(stranger) is None
    with pytest.raises(KeyError):
        read.grids[99]


def test_ids_are_ascending_whatever_the_order_of_the_nodes(stored: Path) -> None:
    document = json.loads((stored / "topology.json").read_text())
    edit(stored / "topology.json", nodes=document["nodes"][::-1])
    read = read_map(stored)
    assert read.ids == [0, 1, 2]
    assert list(read.grids) == [0, 1, 2]
    assert read.grids[1].cells.shape == read_map(stored).topology.submaps[1].grid.cells.shape


def test_a_file_is_read_once_and_not_before_it_is_asked_for(stored: Path) -> None:
    read = read_map(stored)
    (stored / "map.png").rename(stored / "hidden.png")
    with pytest.raises(MapError, match=r"map\.png"):
        _ = read.map_grid
    (stored / "hidden.png").rename(stored / "map.png")
    grid, labels, config = read.map_grid, read.labels, read.config
    for name in ("map.png", "map.yaml", "labels.csv", "run.json"):
        (stored / name).unlink()
    assert (read.map_grid, read.labels, read.config) == (grid, labels, config)


def test_there_and_back(stored: Path, result: MapResult) -> None:
    read = read_map(stored)
    assert read.ids == [0, 1, 2]
    for id_, submap in result.topology.submaps.items():
        back = read.topology.submaps[id_]
        assert (back.grid.cells == submap.grid.cells).all()
        assert back.grid.origin == pytest.approx(submap.grid.origin)
        assert back.keyframes == submap.keyframes
        assert back.polygon is not None
        assert np.abs(back.polygon).max() < 6.1
    assert read.classifiers == "{}\n"
    assert read.config == Config()
    assert (read.labels.submaps == result.labels.submaps).all()
    assert (read.labels.stamps_ns == result.labels.stamps_ns).all()
    assert read.labels.poses == pytest.approx(result.labels.poses, abs=1e-6)
    assert read.regions.outline(1).area_m2 == pytest.approx(result.regions.outline(1).area_m2)


def test_keyframes_in_no_submap_are_in_none(tmp_path: Path, result: MapResult) -> None:
    submaps = result.labels.submaps.copy()
    submaps[5:12] = NO_SUBMAP
    write_map(tmp_path, replace(result, labels=replace(result.labels, submaps=submaps)))
    read = read_map(tmp_path)
    np.testing.assert_array_equal(read.labels.submaps, submaps)
    assert [len(submap.keyframes) for submap in read.topology.submaps.values()] == [5, 8, 10]


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"graph__schema_version": 3}, r"graph\.schema_version is 3: .* reads 1 and 2"),
        ({"graph__next_id": 2}, r"graph\.next_id: 2 is the id of a node or smaller"),
        ({"graph__stays__1__submap": 7}, r"stays\.1: submap 7 is not among the nodes"),
        ({"graph__stays__1__number": 2}, r"graph\.stays: a number occurs twice"),
        *(
            ({"graph__stays__0__keyframes": runs}, r"stays\.0: .* out of order")
            for runs in ([[0, 4], [4, 9]], [[8, 9], [0, 4]], [[4, 0]])
        ),
        ({"graph__stays__0__origin": 5}, r"stays\.0: its origin is none of its keyframes"),
        ({"graph__closures__1__new": 9}, r"closures\.1: its stays are not among"),
        ({"graph__closures__1__old_submap": 9}, r"closures\.1: submap 9 is not among"),
        ({"graph": 5}, r"graph\.schema_version is None"),
        ({"nodes__0__area_m2": "large"}, r"nodes\.0\.area_m2"),
        ({"nodes__1__id": 0}, "occurs twice"),
        ({"edges__0__target": 9}, "submap 9 is not among the nodes"),
        *(
            ({"nodes__0__image": name}, r"nodes\.0\.image")
            for name in ("../../etc/passwd", "/etc/passwd", "submaps\\000.png", "")
        ),
        ({"nodes__0__x": 1e308}, r"nodes\.0\.x: .* no larger than 1e\+09"),
        ({"nodes__0__centroid": [0.0, -1e300]}, r"nodes\.0\.centroid\.1"),
        ({"nodes__0__visits__0__start": 1e300}, r"nodes\.0\.visits\.0\.start"),
        ({"edges__0__distance_m": 1e300}, r"edges\.0\.distance_m"),
        ({"nodes__0__id": 10**30}, r"nodes\.0\.id"),
        ({"graph__doors": [door(9)]}, r"graph\.doors\.0: submap 9 is not among"),
        ({"graph__doors": [door(1), door(2)]}, r"graph\.doors: an id occurs twice"),
        ({"graph__doors": [door(1, width_m=-1)]}, r"graph\.doors\.0\.width_m"),
        ({"edges__0__doors": [4]}, r"edges\.0: door 4 is not among graph\.doors"),
        ({"edges__0__path": [[0.0, 1e300]]}, r"edges\.0\.path\.0\.1"),
        ({"nodes__0__anchor": [0.0]}, r"nodes\.0\.anchor\.1"),
        ({"nodes__0__theta": math.inf}, "theta"),
        *(
            (changes, r"do not fit to the 30 keyframes of labels\.csv")
            for changes in (
                {"graph__stays__2__keyframes": [[20, 2**31 - 1]]},
                {"graph__stays__2__keyframes": [[20, 30]]},
                {"graph__stays__2__keyframes": [[15, 29]]},  # of which another has some
                {"graph__breaks__1__keyframe": 30},
            )
        ),
    ],
)
def test_damaged_topology_is_a_line(stored: Path, changes: dict[str, Any], complaint: str) -> None:
    edit(stored / "topology.json", **changes)
    with pytest.raises(MapError, match=complaint) as caught:
        _ = read_map(stored).topology
    assert "\n" not in str(caught.value)
    assert "topology.json" in str(caught.value)


@pytest.mark.parametrize("text", ["", "{", "[]", "null", "[" * 100_000, '{"graph": NaN}'])
def test_a_topology_that_is_none(stored: Path, text: str) -> None:
    (stored / "topology.json").write_text(text)
    with pytest.raises(MapError, match=r"topology\.json"):
        read_map(stored)


@pytest.mark.parametrize(
    ("name", "field"),
    [
        *(("topology.json", "record"), ("classifiers.json", "classifiers")),
        *(("labels.csv", "labels"), ("run.json", "config"), ("map.yaml", "map_grid")),
    ],
)
def test_what_holds_no_text_is_refused_at_once(stored: Path, name: str, field: str) -> None:
    """Binary and missing files, and a pipe and an endless device, for which nobody waits."""
    path = stored / name
    for make in (
        lambda: path.write_bytes(b"\xff\xfe\x00\x01"),
        lambda: None,
        lambda: os.mkfifo(path),
        lambda: path.symlink_to("/dev/zero"),
    ):
        path.unlink(missing_ok=True)
        make()
        with pytest.raises(MapError, match=name):
            getattr(read_map(stored), field)


@pytest.mark.parametrize("resolution", ["1e-9", "1e300", "11"])
def test_grids_of_absurd_cells(stored: Path, resolution: str) -> None:
    path = stored / "submaps" / "000.yaml"
    path.write_text(path.read_text().replace("resolution: 0.1", f"resolution: {resolution}"))
    with pytest.raises(MapError, match=r"000\.yaml: resolution is "):
        _ = read_map(stored).grids[0]


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        *((text, "not a JSON object: build") for text in ("[]", "3", '"run"', "null")),
        *((f'{{"config": {value}}}', "config: .*build") for value in ("null", "[1]")),
        ("{}", "config: .*build the map again"),
        ('{\n "config": {,}\n}\n', "damaged JSON at line 2: Expecting"),
        (f'{{"config": {"9" * 5000}}}', "a number of too many digits"),
    ],
)
def test_a_damaged_run_is_one_line(stored: Path, text: str, complaint: str) -> None:
    (stored / "run.json").write_text(text)
    with pytest.raises(MapError, match=rf"run\.json: {complaint}") as caught:
        _ = read_map(stored).config
    assert "\n" not in str(caught.value)


def test_labels_of_another_map(stored: Path) -> None:
    path = stored / "labels.csv"
    path.write_text(path.read_text().replace(",2\n", ",7\n"))
    with pytest.raises(MapError, match=r"labels\.csv: submap 7 is not in topology\.json"):
        _ = read_map(stored).labels


@pytest.mark.parametrize(
    ("name", "read"), [("run.json", "run"), ("map.yaml", "regions"), ("labels.csv", "keyframes")]
)
def test_a_map_of_a_recording_says_what_it_lacks(stored: Path, name: str, read: str) -> None:
    (stored / name).unlink()
    with pytest.raises(MapError, match=f"has no {name}: put that one back"):
        getattr(read_map(stored), read)


@pytest.mark.parametrize(
    ("name", "field"),
    [("topology.json", ""), ("run.json", "run"), ("labels.csv", "labels"), ("map.png", "map_grid")],
)
def test_files_beyond_the_limits_name_the_setting(stored: Path, name: str, field: str) -> None:
    size_mb = (stored / name).stat().st_size / 1e6
    picture = name.endswith(".png")
    advice = "" if picture else r".*raise limits\.text_max_mb"

    def read(limit_mb: float) -> None:
        if picture:
            turn("grids", picture_max_mb=limit_mb)
        limits = LimitsConfig() if picture else LimitsConfig(text_max_mb=limit_mb)
        getattr(read_map(stored, limits), field or "record")

    read(max(size_mb, 1.0))
    if name != "topology.json":  # it is read first: it must fit
        (stored / name).write_bytes((stored / name).read_bytes() + b"\n" * 1_000_000)
    with pytest.raises(MapError, match=rf"{name}: .*larger than{advice}"):
        read(1e-6 if name == "topology.json" else 1.0)


def test_settings_of_another_version_are_left_out_and_named(stored: Path) -> None:
    foreign = {"config__recognition__min_inliers": 100, "config__magic": {"wand": True}}
    edit(stored / "run.json", config__grid__resolution_m=0.08, **foreign)
    read = read_map(stored)
    assert read.config.grid.resolution_m == 0.08
    assert sorted(read.foreign_settings) == ["magic", "recognition.min_inliers"]
    edit(stored / "run.json", config__grid__resolution_m="wide")
    with pytest.raises(MapError, match=r"run\.json: config: grid\.resolution_m"):
        _ = read_map(stored).config


OLD = Path(__file__).with_name("topology_1.json")
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.sampled_from(["id", "log", "a"]), inner),
    max_leaves=8,
)


@pytest.fixture
def old(stored: Path) -> Path:
    (stored / "topology.json").write_bytes(OLD.read_bytes())
    return stored


def test_all_that_it_says_is_read(old: Path, result: MapResult) -> None:
    read, without = read_map(old).record, {"kind", "properties"}
    record = TopologyRecord.of(result.topology, result.regions, result.logs, quality=result.quality)
    new = TopologyRecord.model_validate_json(record.text())
    for ours, theirs in zip(read.nodes, new.nodes, strict=True):
        assert ours.model_dump(exclude=without) == theirs.model_dump(exclude=without)
        assert (ours.kind, ours.properties) == (None, {})
    assert read.edges == new.edges
    assert (read.graph.quality, read.graph.frame) == (new.graph.quality, new.graph.frame)
    (ours_log,), (theirs_log,) = read.graph.logs, new.graph.logs
    assert ours_log == replace(theirs_log, keyframes=None)
    for was, is_ in zip(read.graph.closures, new.graph.closures, strict=True):
        left_out = replace(is_, new_submap=None, old_submap=None)
        assert plain(was.as_dict()) == plain(left_out.as_dict())
    assert (read.graph.next_id, read.graph.stays, read.graph.breaks) == (3, (), ())


def test_it_is_a_map_like_any_other(old: Path, tmp_path: Path) -> None:
    stored = read_map(old)
    assert np.isnan(stored.topology.closures[1].score)
    assert len(stored.topology.submaps) == 3
    for name in ("csv", "foxglove", "geojson", "graphml"):
        export_map(stored, name, tmp_path / name)
    for name in ("nav2", "tmap2"):  # a robot would drive along ways, which it has not
        with pytest.raises(MapError, match="nobody looked for ways when it was made: build"):
            export_map(stored, name, tmp_path / name)
    with pytest.raises(MapError, match=r"has no keyframes\.mcap"):
        stored.scans()


def test_a_line_says_what_it_lacks_and_the_first_maps_held_no_verdict(stored: Path) -> None:
    assert read_map(stored).note == "", "a map of this version needs no word"
    (stored / "topology.json").write_bytes(OLD.read_bytes())
    note = read_map(stored).note
    lacks = f"{stored}: a map of an earlier version (schema 1): it keeps no keyframes"
    assert note.startswith(lacks)
    assert "\n" not in note
    document = json.loads(OLD.read_text())
    del document["graph"]["quality"]
    (stored / "topology.json").write_text(json.dumps(document))
    assert read_map(stored).record.graph.quality is None


@pytest.mark.parametrize(
    ("key", "value"),
    [
        *(("graph__log", None), ("graph__log", [1]), ("graph__log__scans", "many")),
        *(("graph__closures", {}), ("graph__closures", [1])),
        *(("nodes", None), ("nodes", {"id": 1}), ("nodes__0", 7), ("nodes__0__id", "x")),
    ],
)
def test_damage_is_told_as_in_a_map_of_this_version(old: Path, key: str, value: Any) -> None:
    edit(old / "topology.json", **{key: value})
    with pytest.raises(MapError, match=r"topology\.json: .*build the map again") as caught:
        read_map(old)
    assert "\n" not in str(caught.value)


@given(JSON, JSON, JSON)
def test_no_document_is_too_strange(nodes: Any, log: Any, closures: Any) -> None:
    graph = {"schema_version": 1, "log": log, "closures": closures}
    document = {"graph": graph, "nodes": nodes}
    assert upgraded(document)["graph"]["schema_version"] == 2
    assert document["graph"] is graph
