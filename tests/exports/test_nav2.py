"""The graph for Nav2's route server, read by its rules: whole, equal to the map, and drivable."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import networkx as nx
import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

from specmap_cli.core.errors import MapError
from specmap_cli.core.findings import Finding, Quality
from specmap_cli.core.progress import Silent
from specmap_cli.exports.table import export_map
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.maps.store import Map
from specmap_cli.maps.writing import MapResult
from specmap_cli.topology.navigation import parts
from tests.exports.conftest import lengths_agree, written
from tests.exports.route_server import load


def exported(stored: Map, out: Path) -> nx.DiGraph:
    export_map(stored, "nav2", out)
    return load(out)


def test_the_server_reads_anchors_doors_and_bends(home: Map, tmp_path: Path) -> None:
    graph = exported(home, tmp_path / "home.geojson")
    kinds = nx.get_node_attributes(graph, "metadata")
    for metadata in (*kinds.values(), *nx.get_edge_attributes(graph, "metadata").values()):
        # a scorer that asks for a width of 1 as a float fails on a whole number
        for key in ("width_m", "clearance_m", "area_m2"):
            assert isinstance(metadata.get(key, 0.0), float)
    classes = [kinds[node]["class"] for node in sorted(graph)]
    assert classes == ["corridor", "room", "room", "bend", "door", "door"]
    assert {graph.nodes[node]["frame"] for node in graph} == {"map"}
    assert kinds[1]["name"] == "submap 1"
    assert kinds[1]["properties"] == {"floor": 2, "heated": True, "owner": "Ann", "rent": 9.5}
    assert list(zip(*kinds[1]["region"].values(), strict=True)) == home.record.nodes[1].polygon
    assert kinds[5]["class"], kinds[5]["door"] == ("door", 0)


def test_a_way_is_driven_both_ways_as_long_as_it_is(home: Map, rooms: Map, tmp_path: Path) -> None:
    for stored in (home, rooms):
        graph = exported(stored, tmp_path / f"{stored.path.name}.geojson")
        lengths_agree(graph, stored, {id_: id_ for id_ in stored.ids}, "cost")
        for start, end, cost in graph.edges(data="cost"):
            straight = math.dist(graph.nodes[start]["at"], graph.nodes[end]["at"])
            assert cost == pytest.approx(straight, abs=1e-5)  # as its DistanceScorer has it
            assert graph.has_edge(end, start)


def test_edges_are_free_and_doors_in_openings(rooms: Map, flat: GridMap, tmp_path: Path) -> None:
    """Straight from node to node, as the server drives, at the clearance of the map's ways."""
    graph, record = exported(rooms, tmp_path / "rooms.geojson"), rooms.record
    clearance = distance_transform_edt(np.pad(flat.free, 1))[1:-1, 1:-1] * flat.resolution
    assert record.graph.robot_radius_m is not None
    places = {node: np.array(at) for node, at in graph.nodes(data="at")}
    for start, end in graph.edges:
        a, b = places[start], places[end]
        steps = np.linspace(0.0, 1.0, 2 + int(math.dist(a, b) / 0.01))[:, None]
        cells = flat.cells_of(a + steps * (b - a))
        assert clearance[cells[:, 0], cells[:, 1]].min() >= record.graph.robot_radius_m
    doors = {door.id: door for door in record.graph.doors}
    metadata = nx.get_node_attributes(graph, "metadata")
    passed = {of["door"]: places[node] for node, of in metadata.items() if "door" in of}
    assert sorted(passed) == sorted(door for edge in record.edges for door in edge.doors)
    for id_, place in passed.items():
        assert math.dist(place, (doors[id_].x, doors[id_].y)) <= doors[id_].width_m / 2


def test_narrow_and_forbidden_links_are_left_out_and_told(
    lived_in: MapResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    old = lived_in.topology
    edges = {**old.edges, (0, 2): replace(old.edges[0, 2], forbidden=True)}
    stored = written(tmp_path / "map", replace(lived_in, topology=replace(old, edges=edges)))
    progress, notes = Silent(), list[str]()
    monkeypatch.setattr(progress, "note", notes.append)
    (told,) = export_map(stored, "nav2", tmp_path / "x.geojson", progress=progress)
    assert notes == [
        "left out: 1 link (0-2) forbidden",
        "left out: 1 link (1-2) without a way wide enough",
        "5 nodes and 6 directed edges",
    ]
    assert told == "2 parts that no way joins, no route leads from one to another: submaps 0, 1; 2"
    graph = load(tmp_path / "x.geojson")
    assert nx.has_path(graph, 0, 1)
    assert not nx.has_path(graph, 0, 2)
    assert parts(stored.ids, stored.record.edges) == [[0, 1], [2]]


def test_what_would_mislead_is_a_warning(lived_in: MapResult, tmp_path: Path) -> None:
    old = lived_in.topology
    edges = {**old.edges, (0, 1): replace(old.edges[0, 1], kind="loose")}
    nowhere = replace(old.submaps[2], anchor=None, anchor_clearance_m=None)
    topology = replace(old, edges=edges, submaps={**old.submaps, 2: nowhere})
    poor = Quality.of([Finding(code="walls", severity="poor", message="walls stand twice")])
    stored = written(tmp_path / "map", replace(lived_in, topology=topology, quality=poor))
    assert export_map(stored, "nav2", tmp_path / "x.geojson") == [
        "the map is judged poor: a robot that follows its ways may meet walls",
        "no place to stand in submap 2: left out",
        "1 link (0-1) joined by a guess only, where tracking was lost: check the map before a "
        "robot drives there",
    ]
    assert sorted(load(tmp_path / "x.geojson"))[:3] == [0, 1, old.next_id]


def test_a_map_without_ways_is_refused(stored: Map, lived_in: MapResult, tmp_path: Path) -> None:
    old = lived_in.topology
    one = replace(old, submaps={0: old.submaps[0]}, edges={}, doors=(), stays=(), closures=())
    narrow = {pair: replace(each, path=None) for pair, each in old.edges.items()}
    shut = {pair: replace(each, forbidden=True) for pair, each in old.edges.items()}
    cases = {"nobody looked for ways": stored}
    for words, topology in (
        ("it has one submap", one),
        ("too narrow for a robot of 0.2 m radius", replace(old, edges=narrow)),
        ("were forbidden", replace(old, edges=shut)),
    ):
        cases[words] = written(tmp_path / words, replace(lived_in, topology=topology))
    for words, case in cases.items():
        with pytest.raises(MapError, match=words):
            export_map(case, "nav2", tmp_path / "x.geojson")
    assert not (tmp_path / "x.geojson").exists()
