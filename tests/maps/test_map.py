"""What a program asks a map: its rooms, doors, routes, graph and way. It can change nothing."""

import math
import pickle
import sys
from base64 import b64encode
from collections.abc import Sequence
from dataclasses import FrozenInstanceError
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from specmap_cli import Map, SpecmapError, read_map, segment_map
from specmap_cli.core.geometry import Pose2
from specmap_cli.pipelines.edit import edit_map
from specmap_cli.pipelines.edits import RequestedEdits
from tests.conftest import FLAT_ROOMS


@pytest.fixture(scope="module")
def rooms(plan: Path, tmp_path_factory: pytest.TempPathFactory) -> Map:
    """The flat divided: three rooms of known walls above a corridor, two of them with one name."""
    map_ = read_map(segment_map(plan, tmp_path_factory.mktemp("divided") / "map").out)
    ids = [room_of(map_, box).id for box in FLAT_ROOMS]
    names = dict(zip(ids, ["Office", "Lab", "Office", "Corridor"], strict=True))
    edit_map(map_, RequestedEdits(names=names, properties={ids[1]: {"floor": 2}}))
    return read_map(map_.path)


def room_of(map_: Map, box: Sequence[int]) -> Any:
    bottom, top, left, right = (0.05 * side for side in box)
    return map_.room_at((left + right) / 2, (bottom + top) / 2)


def test_a_room_is_found_by_id_by_name_and_by_place(rooms: Map, flat_map: Map) -> None:
    lab = rooms.rooms["Lab"]
    assert lab is rooms.rooms[lab.id]
    assert lab is room_of(rooms, FLAT_ROOMS[1])
    assert rooms.room_at(lab.anchor[0], lab.anchor[1]) is lab if lab.anchor else False
    assert list(rooms.rooms) == rooms.ids == sorted(rooms.ids)
    assert rooms.room_at(-50.0, 2.0) is None
    assert rooms.room_at(1e9, 1e9) is None
    with pytest.raises(KeyError, match=r"no room 'Lobby'; there are .*'Lab'"):
        rooms.rooms["Lobby"]
    with pytest.raises(KeyError, match="several rooms are called 'Office': take the id, one of "):
        rooms.rooms["Office"]
    with pytest.raises(KeyError, match="no room 99"):
        rooms.rooms[99]
    with pytest.raises(ValueError, match="expected a room, or x and y"):
        rooms.room_at(math.nan, 1.0)
    with pytest.raises(ValueError, match="expected a room, or x and y in metres, found None"):
        rooms.route("Lab", None)  # type: ignore[arg-type]
    first = flat_map.ids[0]
    assert flat_map.rooms[f"submap {first}"].id == first
    with pytest.raises(KeyError, match=f"no room 'lab'; there are {first} 'submap {first}'"):
        flat_map.route("lab", first)


def test_a_room_tells_its_size_its_border_and_its_grid_in_the_map(rooms: Map) -> None:
    lab, (bottom, top, left, right) = rooms.rooms["Lab"], FLAT_ROOMS[1]
    owned_m2 = np.count_nonzero(rooms.regions.owner == lab.id) * rooms.grid.resolution**2
    assert lab.area_m2 == pytest.approx(owned_m2)
    assert lab.area_m2 == pytest.approx((top - bottom) * (right - left) * 0.05**2, rel=0.05)
    assert lab.outline.min(axis=0) == pytest.approx((left * 0.05, bottom * 0.05), abs=0.11)
    assert lab.properties == {"floor": 2}
    assert lab.kind == "room"
    (door,) = lab.doors
    assert lab.id in door.between
    assert door in rooms.doors
    for row, column in np.argwhere(lab.grid.free)[::97].tolist():
        x, y, one = lab.transform @ (column + 0.5, row + 0.5, 1.0)
        assert one == 1.0
        assert rooms.grid.values_at(np.array([[x, y]]))[0] == 0


def test_nothing_of_a_map_can_be_changed(rooms: Map, flat_map: Map) -> None:
    lab = rooms.rooms["Lab"]
    for record, name in ((rooms, "path"), (rooms, "rooms"), (lab, "name")):
        with pytest.raises((FrozenInstanceError, AttributeError)):
            setattr(record, name, "other")
    told: list[Any] = [lab.properties, rooms.record.graph.files, rooms.record.nodes[0].polygon]
    for values in told:
        with pytest.raises(TypeError):
            values[0] = 3
    assert pickle.loads(pickle.dumps(lab.properties)) == {"floor": 2}
    keyframes, way = flat_map.keyframes, flat_map.trajectory
    route, path = rooms.route("Lab", "Corridor"), rooms.record.edges[0].path
    arrays: list[Any] = [lab.outline, lab.grid.cells, rooms.grid.cells, rooms.regions.owner]
    for array in (*arrays, route.points, keyframes.poses, keyframes.submaps, way.poses, path):
        assert array is not None
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def test_routes_lead_from_and_to_rooms_and_places_if_allowed(rooms: Map, tmp_path: Path) -> None:
    lab, corridor = rooms.rooms["Lab"], rooms.rooms["Corridor"]
    there = rooms.route("Lab", "Corridor")
    assert there.rooms == (lab.id, corridor.id)
    assert there.doors == lab.doors
    assert tuple(there.points[0]) == pytest.approx(lab.anchor, abs=1e-6)
    back = rooms.route(Pose2(*corridor.place, 1.0), lab)
    assert back.length_m == pytest.approx(there.length_m, rel=0.02)
    of_array: Any = np.int64(lab.id)
    assert rooms.route(of_array, corridor.place).length_m == pytest.approx(there.length_m)
    assert "within 1 m of 50, 50" in rooms.route("Lab", (50.0, 50.0)).why
    with pytest.raises(KeyError, match="Lobby"):
        rooms.route("Lab", "Lobby")
    edit_map(rooms, RequestedEdits(changes=({"forbid": [lab.id, corridor.id]},)), tmp_path / "shut")
    refused = read_map(tmp_path / "shut").route("Lab", "Corridor")
    assert not refused
    assert f"door {lab.doors[0].id}" in refused.why


def test_features_go_to_geopandas_where_it_is(rooms: Map, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "geopandas", None)
    with pytest.raises(SpecmapError, match="needs geopandas, which is not installed") as told:
        rooms.to_geopandas()
    assert told.value.code == "package-missing"
    frames = SimpleNamespace(GeoDataFrame=SimpleNamespace(from_features=lambda given: given))
    monkeypatch.setitem(sys.modules, "geopandas", frames)
    kinds = [feature["properties"]["kind"] for feature in rooms.to_geopandas()]
    assert kinds.count("submap") == kinds.count("anchor") == len(rooms.rooms)
    assert kinds.count("door") == len(rooms.doors)


def test_the_way_is_arrays_and_can_be_walked(flat_map: Map, rooms: Map) -> None:
    keyframes, way = flat_map.keyframes, flat_map.trajectory
    stamp_ns, pose, room = next(iter(keyframes))
    assert (stamp_ns, room) == (keyframes.stamps_ns[0], keyframes.submaps[0])
    assert pose == Pose2(*keyframes.poses[0])
    assert len(list(way)) == len(way.poses) == sum(log.scans for log in flat_map.logs)
    found = flat_map.room_at(pose.x, pose.y)
    assert found is not None
    assert found.id == room
    assert [*rooms.keyframes, *rooms.trajectory] == [], "a divided plan has none"
    assert flat_map.quality is not None
    assert flat_map.quality.verdict == "good"


def test_a_notebook_shows_the_picture_and_a_table(rooms: Map, tmp_path: Path) -> None:
    picture = rooms._repr_png_()
    assert picture is not None
    assert picture.startswith(b"\x89PNG")
    edit_map(rooms, RequestedEdits(names={0: "<script>"}), tmp_path / "named")
    table = read_map(tmp_path / "named")._repr_html_()
    assert "&lt;script&gt;" in table
    assert "<script>" not in table
    assert b64encode(picture)[:99].decode() in table, "browsers prefer it to the picture alone"
    assert table.count("<tr>") == len(rooms.rooms) + 1
    assert repr(rooms).endswith("/map': 4 rooms>")
    (tmp_path / "named" / "overview.png").unlink()
    assert "<img" not in read_map(tmp_path / "named")._repr_html_()
