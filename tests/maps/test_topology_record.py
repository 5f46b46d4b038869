"""Topological maps as the records of topology.json, and back; its models and its JSON Schema."""

import json
import math
import ntpath
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError

from specmap_cli.core import json_values
from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2
from specmap_cli.core.schemas import read_schema
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.maps.schema import TopologyRecord
from specmap_cli.maps.writing import MapResult
from specmap_cli.topology.regions import Outline, Regions, kind_of
from specmap_cli.topology.topological_map import (
    Door,
    Edge,
    LogInfo,
    Seen,
    Submap,
    TopologicalMap,
    Traversal,
    Visit,
)
from tests.house import closure
from tests.maps.conftest import place_in
from tests.strategies import poses

SCHEMA = jsonschema.Draft202012Validator(read_schema("topology"))
GRID = GridMap(np.zeros((2, 2), dtype=np.uint8), 0.1)
# of floats only as much as seconds as a double can say exactly to the microsecond
TIMES = st.integers(0, 2 * 10**15).map(lambda microseconds: microseconds * 1000)
NANS: dict[str, Any] = dict.fromkeys(("xi", "claims_old_by_new", "score"), math.nan)
CLOSURE = closure(2, 5, verified=False, claims_new_by_old=0.25, **NANS)


def regions_of(**centroids: tuple[float, float]) -> Regions:
    """Regions `s0`, `s1`, ... that are triangles around their centroids."""
    outlines = {
        int(name[1:]): Outline(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, -1e-9]]), np.array(c), 2.5)
        for name, c in centroids.items()
    }
    return Regions(GRID, np.zeros((2, 2), dtype=np.int64), outlines)


def submap(id_: int, frame: Pose2 = IDENTITY, keyframes: tuple[int, ...] = ()) -> Submap:
    return Submap(id=id_, map_from_submap=frame, grid=GRID, keyframes=keyframes)


def record_of(topology: TopologicalMap, regions: Regions | None = None) -> TopologyRecord:
    return read(TopologyRecord.of(topology, regions or regions_of(), [LogInfo("a.mcap")]))


def read(record: TopologyRecord) -> TopologyRecord:
    """A record as it is read from the file that it is written to."""
    return TopologyRecord.model_validate_json(record.text())


def undrawn(edge: Edge) -> Edge:
    """An edge without what is only written down with the whole map."""
    return replace(edge, x=None, y=None, distance_m=0.0)


def back(record: TopologyRecord) -> TopologicalMap:
    """The map of a record, keyframes ten a submap."""
    return record.topology(lambda _: GRID, lambda id_: range(10 * id_, 10 * id_ + 10))


@given(poses, poses, st.lists(st.tuples(TIMES, poses), max_size=3), TIMES, TIMES)
def test_there_and_back(
    frame: Pose2, transform: Pose2, crossings: list[tuple[int, Pose2]], start: int, end: int
) -> None:
    """But for what six decimals of metres and whole microseconds take."""
    ways = tuple(Traversal(stamp, 3, 7, *pose) for stamp, pose in crossings)
    edge = Edge(source=3, target=7, kind="traversed", traversals=ways, source_from_target=transform)
    visited = replace(submap(3, frame, tuple(range(30, 40))), visits=(Visit(start, end),))
    written = TopologicalMap(submaps={3: visited, 7: submap(7)}, edges={(3, 7): edge})
    read = back(record_of(written))
    assert read.submaps[3].keyframes == visited.keyframes
    assert read.submaps[3].visits == visited.visits
    assert read.submaps[3].map_from_submap == pytest.approx(frame, abs=1e-6)
    found = read.edges[3, 7]
    assert found.source_from_target == pytest.approx(transform, abs=1e-6)
    assert [t.stamp_ns for t in found.traversals] == [stamp for stamp, _ in crossings]
    for traversal, (_, pose) in zip(found.traversals, crossings, strict=True):
        assert (traversal.x, traversal.y, traversal.theta) == pytest.approx(pose, abs=1e-6)


def test_all_that_was_read_cannot_be_changed_and_is_written_the_same(result: MapResult) -> None:
    record = TopologyRecord.of(result.topology, result.regions, result.logs)
    found = back(read(record))
    assert isinstance(found.closures, tuple)
    assert all(isinstance(edge.traversals, tuple) for edge in found.edges.values())
    for part in found.submaps.values():
        assert isinstance(part.keyframes, tuple)
        assert isinstance(part.visits, tuple)
    for stay, was in zip(found.stays, result.topology.stays, strict=True):
        start, end = (stamp // 1000 * 1000 for stamp in (was.start_ns, was.end_ns))
        assert stay == replace(was, start_ns=start, end_ns=end), "in whole microseconds"
    assert found.breaks == result.topology.breaks
    assert TopologyRecord.of(found, result.regions, result.logs).text() == record.text()


def test_doors_anchors_and_ways_there_and_back() -> None:
    crossing = Traversal(5_000_000_000, 3, 7, 1.0, 2.0, 0.5)
    seen = Door(id=0, x=1.0, y=2.0, width_m=0.9, theta=0.25, between=(3, 7))
    doors = (
        replace(seen, crossings=(crossing,), driven=True),
        replace(seen, id=1, x=1.5, y=-2.0, width_m=0.8, theta=-3.0),
    )
    path = np.array([[0.0, 0.5], [1.0, 2.0], [3.0, 2.5]])
    driven = Edge(source=3, target=7, kind="traversed", traversals=(crossing,), x=1.0, y=2.0)
    way = replace(driven, width_m=0.9, doors=(0,), path=path, length_m=3.7, clearance_m=0.25)
    narrow = Edge(source=3, target=9, kind="seen", doors=(), clearance_m=0.1)
    standing = replace(submap(3), anchor=(0.0, 0.5), anchor_clearance_m=0.3)
    written = TopologicalMap(
        submaps={3: standing, 7: submap(7), 9: submap(9)},
        edges={(3, 7): way, (3, 9): narrow},
        doors=doors,
        robot_radius_m=0.2,
    )
    read = back(record_of(written))
    assert (read.doors, read.robot_radius_m) == (doors, 0.2)
    assert (read.submaps[3].anchor, read.submaps[3].anchor_clearance_m) == ((0.0, 0.5), 0.3)
    assert read.submaps[7].anchor is None
    np.testing.assert_array_equal(read.edges[3, 7].path, path)
    assert undrawn(replace(read.edges[3, 7], path=None)) == undrawn(replace(way, path=None))
    assert undrawn(read.edges[3, 9]) == narrow


def test_what_was_only_seen_is_written_and_a_map_that_does_not_tell_it_has_none() -> None:
    pieces = (Seen(area_m2=12.5, x=1.0, y=-2.5), Seen(area_m2=1.5, x=0.0, y=0.25))
    record = record_of(TopologicalMap(), replace(regions_of(), seen=pieces))
    assert record.graph.seen == pieces
    assert record.seen_m2 == 14.0
    document = json.loads(record.text())
    assert document["graph"].pop("seen")[1] == {"area_m2": 1.5, "x": 0.0, "y": 0.25}
    assert TopologyRecord.model_validate(document).graph.seen == ()


def test_what_is_not_a_number_is_null_and_back() -> None:
    verified = replace(CLOSURE, verified=True, old_from_new=Pose2(1.0, -2.0, 0.5))
    record = record_of(TopologicalMap(closures=(CLOSURE, verified)))
    written = json.loads(record.text())["graph"]["closures"][0]
    assert (written["xi"], written["score"], written["claims_old_by_new"]) == (None, None, None)
    assert (written["claims_new_by_old"], written["transform"]) == (0.25, None)
    found, kept = back(record).closures
    assert math.isnan(found.xi)
    assert math.isnan(found.score)
    assert (found.reason, found.old_from_new, found.merged) == ("grids match", None, False)
    assert kept.old_from_new == (1.0, -2.0, 0.5)


def test_the_way_runs_from_centroid_to_centroid_through_the_crossing() -> None:
    regions = regions_of(s0=(0.0, 0.0), s1=(4.0, 0.0))
    through = (Traversal(0, 0, 1, 0.0, 3.0, 0.0),)
    for edge, metres in (
        (Edge(source=0, target=1, kind="traversed", traversals=through), 3.0 + 5.0),
        (Edge(source=0, target=1, kind="loose"), 4.0),
        (Edge(source=0, target=1, kind="doorway", x=4.0, y=3.0, width_m=0.9), 5.0 + 3.0),
    ):
        topology = TopologicalMap(submaps={0: submap(0), 1: submap(1)}, edges={(0, 1): edge})
        (written,) = record_of(topology, regions).edges
        assert written.distance_m == pytest.approx(metres)
        found = back(record_of(topology, regions)).edges[0, 1]
        assert found.crossing == edge.crossing
        assert undrawn(found) == undrawn(edge)
    far = submap(1, Pose2(0.0, -6.0, 1.0))  # it owns nothing: the way leads to its origin
    edge = Edge(source=0, target=1, kind="loose")
    topology = TopologicalMap(submaps={0: submap(0), 1: far}, edges={(0, 1): edge})
    record = record_of(topology, regions_of(s0=(0.0, 2.0)))
    assert record.edges[0].distance_m == pytest.approx(8.0)
    assert record.nodes[1].centroid is None
    assert (record.nodes[0].polygon[2], record.nodes[0].area_m2) == ((0.0, 0.0), 2.5)


def test_the_kind_is_that_of_the_border_as_it_is_written() -> None:
    """Of a strip that is all but long enough for a corridor; its border is rounded."""

    def strip(length: float) -> FloatArray:
        return np.array([(0.0, 0.0), (length, 0.0), (length, 1.0), (0.0, 1.0)])

    room, corridor = 3.0, 5.0
    while corridor - room > 1e-12:
        middle = (room + corridor) / 2.0
        room, corridor = (middle, corridor) if kind_of(strip(middle)) == "room" else (room, middle)
    for length in (room, corridor):
        outline = Outline(strip(length), np.zeros(2), length)
        regions = Regions(GRID, np.zeros((2, 2), dtype=np.int64), {0: outline})
        node = record_of(TopologicalMap(submaps={0: submap(0)}), regions).nodes[0]
        assert node.kind == kind_of(np.array(node.polygon))


def test_a_submap_has_a_name_and_a_picture_and_keyframes_only_if_there_are_scans() -> None:
    named = replace(submap(1, keyframes=(4,)), name="kitchen")
    record = record_of(TopologicalMap(submaps={0: submap(0), 1: named}))
    assert [node.name for node in record.nodes] == ["submap 0", "kitchen"]
    assert [node.image for node in record.nodes] == ["submaps/000.png", "submaps/001.png"]
    read = back(record)
    assert read.submaps[0].keyframes == (), "a table of keyframes is not even asked for"
    assert read.submaps[1].keyframes == tuple(range(10, 20))


@pytest.fixture
def document(stored: Path) -> Any:
    return json.loads((stored / "topology.json").read_text())


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("directed", True),
        ("multigraph", None),
        ("graph__schema_version", 1),
        ("graph__frame", 7),
        ("graph__logs__0__scans", -1),
        ("graph__logs", []),
        ("graph__logs__0__keyframes", [1]),
        ("graph__next_id", -1),
        ("graph__stays__0__keyframes", []),
        ("graph__stays__0__keyframes", [[0, 1, 2]]),
        ("graph__breaks__0__keyframe", None),
        ("graph__closures__0__new_submap", "first"),
        ("nodes__0__kind", "kitchen"),
        ("nodes__0__properties", {"floor": [1]}),
        ("graph__closures__0__xi", "high"),
        ("graph__closures__0__transform", [1.0, 2.0]),
        ("nodes__0__id", -1),
        ("nodes__0__id", 0.5),
        ("nodes__0__area_m2", -0.1),
        ("graph__seen", [{"area_m2": -1.0, "x": 0.0, "y": 0.0}]),
        ("nodes__0__visits", {}),
        ("nodes__0__polygon", [[1.0, 2.0, 3.0]]),
        ("nodes__0__colour", "red"),
        ("edges__0__kind", "tunnel"),
        ("edges__0__traversals__0__from", None),
        ("edges__0__distance_m", -2.0),
        *(("edges", None), ("nodes", [{"id": 0}])),
    ],
)
def test_models_and_schema_refuse_the_same(document: Any, key: str, value: Any) -> None:
    *parents, last = key.split("__")
    TopologyRecord.model_validate(document)
    SCHEMA.validate(document)
    place_in(document, parents)[last] = value
    with pytest.raises(ValidationError):
        TopologyRecord.model_validate(document)
    with pytest.raises(jsonschema.ValidationError):
        SCHEMA.validate(document)


def test_no_key_may_be_missing(document: Any) -> None:
    may_lack = {"path_m", "seen", "files"}  # maps of schema 2 are older than these
    records = ("logs__0", "stays__0", "closures__0")
    for record in (
        *("graph", *(f"graph__{each}" for each in records)),
        *("nodes__0", "edges__0", "edges__0__traversals__0"),
    ):
        place = place_in(document, record.split("__"))
        for key in set(place) - may_lack:
            value = place.pop(key)
            with pytest.raises(ValidationError, match=key):
                TopologyRecord.model_validate(document)
            place[key] = value


def test_every_field_is_described_and_the_schema_has_a_name() -> None:
    document = read_schema("topology")
    assert document["$id"] == "urn:specmap:topology:2"
    for name, record in [("topology", document), *document["$defs"].items()]:
        assert record["description"], name
        for key, field in record["properties"].items():
            assert field.get("description"), f"{name}.{key}"


def accepted(name: str) -> bool:
    try:
        TypeAdapter(json_values.InnerPath).validate_python(name)
    except ValidationError:
        return False
    return True


@given(st.lists(st.sampled_from([*"ab./\\:", "..", "../", "\n"]), max_size=8).map("".join))
def test_images_lie_inside_the_map_directory(name: str) -> None:
    """Whatever name is accepted, no way of reading it leads out of the directory."""
    if accepted(name):
        inside = os.path.normpath(os.path.join("/maps/home", name))
        assert inside == "/maps/home" or inside.startswith("/maps/home/")
        assert ntpath.splitdrive(name)[0] == ""
        assert "\n" not in name
    assert all(map(accepted, ("submaps/000.png", "a.b/c", "..a", "räume/küche.png")))
