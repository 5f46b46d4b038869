"""Open-RMF, LIF and Nav2's masks, read by their rules; speed limits and penalties everywhere."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import networkx as nx
import numpy as np
import pytest
import yaml
from scipy.ndimage import label

from specmap_cli.exports.table import export_map
from specmap_cli.maps.store import Map
from specmap_cli.maps.writing import MapResult
from tests.exports import costmap_filters, layout, open_rmf
from tests.exports.conftest import lengths_agree, with_submaps
from tests.exports.route_server import load


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
        shown = {one["stationName"] for one in stations.values()}
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
