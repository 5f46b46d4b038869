"""Nav2's route graph and masks, Open-RMF and LIF, read by their rules and equal to the map."""

import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import networkx as nx
import numpy as np
import pytest
import yaml
from scipy.ndimage import distance_transform_edt, label

from specmap_cli.core.errors import MapError
from specmap_cli.core.findings import Finding, Quality
from specmap_cli.core.progress import Silent
from specmap_cli.exports.table import export_map
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.maps.store import Map
from specmap_cli.maps.writing import MapResult
from specmap_cli.topology.navigation import parts
from tests.exports import costmap_filters, layout, open_rmf
from tests.exports.conftest import lengths_agree, with_submaps, written
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
    assert tuple(zip(*kinds[1]["region"].values(), strict=True)) == home.record.nodes[1].polygon
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


def noted(out: Path, result: MapResult, *properties: dict[str, Any]) -> Map:
    """The house, something noted of its first submaps."""
    return with_submaps(out, result, *({"properties": each} for each in properties))


def test_an_adapter_reads_what_the_generator_makes(home: Map, rooms: Map, tmp_path: Path) -> None:
    for stored in (home, rooms):
        out = tmp_path / f"{stored.path.name}.zip"
        (warning,) = export_map(stored, "rmf", out)
        assert warning.startswith(f"{len(stored.doors)} doors: Open-RMF waits at a door until ")
        building, nav_graph = open_rmf.parts(out)
        graph = open_rmf.graph_of(nav_graph)
        made = open_rmf.graph_of(open_rmf.generated(building))
        by_place = nx.get_node_attributes(graph, "at")
        of_made = nx.get_node_attributes(made, "at")
        lanes = {(by_place[a], by_place[b], str(told)) for a, b, told in graph.edges(data=True)}
        assert lanes == {(of_made[a], of_made[b], str(t)) for a, b, t in made.edges(data=True)}
        names = {name: node for node, name in graph.nodes(data="name") if name}
        assert sorted(names) == sorted(node.name for node in stored.record.nodes)
        by_id = {room.id: names[room.name] for room in stored.rooms.values()}
        lengths_agree(graph, stored, by_id, "length_m")
        through = {name for _, _, name in graph.edges(data="door_name") if name}
        ways = [edge for edge in stored.record.edges if edge.corners]
        assert through == {f"Door{door}" for edge in ways for door in edge.doors}
        waits = {node for node, may in graph.nodes(data="is_holding_point") if may}
        assert waits == set(names.values())


def test_names_that_come_twice_are_told_apart(lived_in: MapResult, tmp_path: Path) -> None:
    stored = with_submaps(tmp_path / "map", lived_in, *[{"name": "Lab"}] * 3)
    export_map(stored, "rmf", tmp_path / "x.zip")
    graph = open_rmf.graph_of(open_rmf.parts(tmp_path / "x.zip")[1])
    names = {name for _, name in graph.nodes(data="name") if name}
    assert names == {"Lab (0)", "Lab (1)", "Lab (2)"}


def test_a_layout_has_rooms_and_ways_as_long(home: Map, rooms: Map, tmp_path: Path) -> None:
    for stored in (home, rooms):
        out = tmp_path / f"{stored.path.name}.json"
        export_map(stored, "lif", out)
        graph = layout.load(out)
        stations = graph.graph["stations"]
        names = {room.id: f"Submap{room.id}" for room in stored.rooms.values() if room.anchor}
        assert stations.keys() == set(names.values())
        shown = {one.station_name for one in stations.values()}
        assert shown == {room.name for room in stored.rooms.values()}
        lengths_agree(graph, stored, names, "length_m")
        assert {speed for _, _, speed in graph.edges(data="max_speed")} == {None}


def test_each_planner_finds_speed_limits_and_penalties(lived_in: MapResult, tmp_path: Path) -> None:
    whole = {"speed_limit": 1, "penalty": 3}  # scorers want floats
    stored = noted(tmp_path / "map", lived_in, whole)
    plain = noted(tmp_path / "plain", lived_in, {})
    files = {name: tmp_path / name for name in ("nav2", "tmap2", "lif")}
    for name, path in files.items():
        export_map(stored, name, path)
    export_map(stored, "rmf", tmp_path / "rmf.zip")
    graph = load(files["nav2"])
    door = next(node for node, of in graph.nodes(data="metadata") if of.get("door") == 0)
    beyond = graph.edges[door, 1]["metadata"]
    assert (graph.nodes[door]["metadata"]["class"], beyond["class"]) == ("door", "traversed")
    path = nx.shortest_path(graph, 0, door)
    inside = [graph.edges[pair]["metadata"] for pair in pairwise(path)]
    assert len(inside) == 2, "a bend lies between"
    for metadata in inside:
        assert (metadata["speed_limit"], type(metadata["speed_limit"])) == (1.0, float)
    assert sum(metadata["penalty"] for metadata in inside) == pytest.approx(3.0)
    assert not {"speed_limit", "penalty"} & beyond.keys()
    speeds = {(a, b): speed for a, b, speed in layout.load(files["lif"]).edges(data="max_speed")}
    to_bend = next(speed for (a, b), speed in speeds.items() if a == "Submap0" and "Bend" in b)
    assert (to_bend, speeds["Door0", "Submap1"]) == (1.0, None)
    lanes = open_rmf.graph_of(open_rmf.parts(tmp_path / "rmf.zip")[1])
    assert {speed for _, _, speed in lanes.edges(data="speed_limit")} == {1.0, None}
    export_map(plain, "tmap2", tmp_path / "plain.tmap2")
    weights = [weights_of(path) for path in (files["tmap2"], tmp_path / "plain.tmap2")]
    more = {pair: weights[0][pair] - weights[1][pair] for pair in weights[0]}
    assert more["Submap0", "Door0"] == pytest.approx(3.0)
    assert more["Door0", "Submap1"] == pytest.approx(0.0)


def weights_of(path: Path) -> dict[tuple[str, str], float]:
    nodes = [entry["node"] for entry in yaml.safe_load(path.read_text())["nodes"]]
    return {
        (node["name"], edge["node"]): edge["properties"]["weight"]
        for node in nodes
        for edge in node["edges"]
    }


def test_a_limit_that_is_none_is_left_out_and_told(lived_in: MapResult, tmp_path: Path) -> None:
    stored = noted(tmp_path / "map", lived_in, {"speed_limit": "slow", "penalty": True})
    for name in ("nav2", "nav2-masks"):
        assert export_map(stored, name, tmp_path / f"{name}.zip") == [
            "submap 0: speed_limit is 'slow', no number above 0: not exported",
            "submap 0: penalty is True, no number above 0: not exported",
        ]
    assert not costmap_filters.load(tmp_path / "nav2-masks.zip").limits.any()


def test_a_limit_that_a_mask_cannot_hold_is_told(lived_in: MapResult, tmp_path: Path) -> None:
    stored = noted(tmp_path / "map", lived_in, {"speed_limit": 2.0}, {"speed_limit": 0.01})
    (warning,) = export_map(stored, "nav2-masks", tmp_path / "masks.zip")
    assert warning.startswith("submap 1: speed_limit 0.01 is written as 0.02, ")


def test_a_mask_is_never_faster_than_was_said(lived_in: MapResult, tmp_path: Path) -> None:
    said = (1.5, 0.3, 0.4)
    stored = noted(tmp_path / "map", lived_in, *({"speed_limit": limit} for limit in said))
    export_map(stored, "nav2-masks", tmp_path / "masks.zip")
    limits, owner = costmap_filters.load(tmp_path / "masks.zip").limits, stored.regions.owner
    for id_, limit in enumerate(said):
        (found,) = np.unique(limits[owner == id_])
        assert limit - 0.015 < found <= limit + 1e-9
    assert not limits[owner < 0].any()


def test_a_forbidden_link_and_a_forbidden_door_are_shut(rooms: Map, tmp_path: Path) -> None:
    """The link without its doors, so that it is the border that is shut; the door by itself."""
    record, regions = rooms.record, rooms.regions
    link, door = record.edges[0], record.graph.doors[-1]
    assert door.id not in link.doors
    doors = (*record.graph.doors[:-1], replace(door, forbidden=True))
    graph = record.graph.model_copy(update={"doors": doors})
    edges = (replace(link, forbidden=True), *record.edges[1:])
    changed = record.model_copy(update={"graph": graph, "edges": edges})
    export_map(replace(rooms, record=changed), "nav2-masks", tmp_path / "masks.zip")
    shut = costmap_filters.load(tmp_path / "masks.zip").shut
    for place in (*door.sides, (door.x, door.y)):
        assert shut[tuple(regions.grid.cells_of(np.array([place]))[0])]
    for pair in ((link.source, link.target), door.between):
        anchors = np.array([rooms.rooms[id_].anchor for id_ in pair])
        cells = tuple(regions.grid.cells_of(anchors).T)
        for free, ways in ((np.isin(regions.owner, pair), 1), (~shut, 2)):
            parts, _ = label(free & np.isin(regions.owner, pair), np.ones((3, 3)))
            assert len(set(parts[cells])) == ways


def test_masks_lie_on_the_grid_and_limit_nothing(home: Map, rooms: Map, tmp_path: Path) -> None:
    for stored in (home, rooms):
        export_map(stored, "nav2-masks", tmp_path / "masks.zip", overwrite=True)
        found = costmap_filters.load(tmp_path / "masks.zip")
        assert found.shut.shape == stored.regions.grid.cells.shape
        assert (found.resolution, found.origin) == (stored.grid.resolution, stored.grid.origin)
        assert not found.shut.any()
        assert not found.limits.any()
