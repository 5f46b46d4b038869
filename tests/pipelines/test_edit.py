"""A person's word about a map: applied, kept, undone, and still there after an update."""

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock, call

import numpy as np
import pytest
from scipy.spatial import cKDTree

from specmap_cli import read_map
from specmap_cli.core.errors import MapError, UsageError
from specmap_cli.core.findings import summary
from specmap_cli.core.geometry import nearest_motion
from specmap_cli.core.progress import Silent
from specmap_cli.core.records import Trajectory
from specmap_cli.core.settings import Config, SegmentationConfig
from specmap_cli.exports.table import export_map
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.maps.store import Map
from specmap_cli.maps.writing import MapResult, write_map
from specmap_cli.pipelines import laying_out
from specmap_cli.pipelines.edit import edit_map
from specmap_cli.pipelines.edits import RequestedEdits
from specmap_cli.pipelines.map_in_making import quality_of_stored
from specmap_cli.pipelines.merge import merge_maps
from specmap_cli.pipelines.reports import EditReport
from specmap_cli.pipelines.segment import segment_map
from specmap_cli.pipelines.update import build_like, update_map
from specmap_cli.segmentation.division import Segmentation, segment
from specmap_cli.topology.navigation import crossing_of, with_ways
from specmap_cli.topology.regions import divide
from specmap_cli.topology.topological_map import TopologicalMap
from tests.conftest import SAMPLE_LOGS
from tests.flats import QUICK, Mapped, forget_digests
from tests.maps.conftest import edit as edit_json
from tests.maps.test_store import files_in
from tests.topology.rooms import two_rooms


@dataclass(frozen=True)
class Built:
    map: Path
    again: Mapped
    corridor: int
    rooms: tuple[int, ...]


@pytest.fixture(scope="module")
def built(first_tour: Mapped, second_tour: Mapped) -> Built:
    corridor = corridor_of(first_tour.stored)
    rooms = tuple(id_ for id_ in first_tour.stored.ids if id_ != corridor)
    return Built(first_tour.map, second_tour, corridor, rooms)


def corridor_of(stored: Map) -> int:
    """The submap that most links lead to."""
    ends = [end for edge in stored.record.edges for end in (edge.source, edge.target)]
    return max(set(ends), key=ends.count)


@pytest.fixture
def own(built: Built, tmp_path: Path) -> Path:
    return Path(shutil.copytree(built.map, tmp_path / "own"))


def split(stored: Map, submap: int) -> dict[str, Any]:
    """At a line across a submap, through the middle keyframe of the way in it."""
    poses = stored.labels.poses[stored.labels.submaps == submap]
    place, theta = poses[len(poses) // 2, :2], float(poses[len(poses) // 2, 2])
    aside = 0.3 * np.array([-np.sin(theta), np.cos(theta)])
    return {"split": submap, "line": [(place + aside).tolist(), (place - aside).tolist()]}


def bytes_of(directory: Path, name: str) -> bytes:
    return (directory / name).read_bytes()


def edit(
    map_: Map | Path, *changes: dict[str, Any], out: Path | None = None, **said: Any
) -> EditReport:
    return edit_map(map_, RequestedEdits(changes=changes, **said), out)


class TestNames:
    """Names, kinds and properties: at once, and nothing else changes."""

    def test_they_are_in_the_map_and_can_be_taken_back(self, built: Built, own: Path) -> None:
        room = built.rooms[0]
        (own / "notes.txt").write_text("mine", encoding="utf-8")
        (own / "keyframes.mcap").unlink()  # nothing needs them
        edit_map(own)
        picture = bytes_of(own, "overview.png")
        floor = {"floor": 2, "to": None}
        report = edit(own, names={room: "Küche"}, kinds={room: "hall"}, properties={room: floor})
        assert not report.remade
        node = read_map(own).record.nodes[room]
        assert (node.name, node.kind, node.properties) == ("Küche", "hall", {"floor": 2})
        before, after = files_in(built.map), files_in(own)
        changed = {name for name in after if after[name] != before.get(name)}
        assert changed == {"topology.json", "overview.png", "edits.toml", "notes.txt"}
        assert after["notes.txt"] == b"mine"
        assert f"  submap {room}: Küche, hall, floor=2" in report.lines()
        edit(own, names={room: ""})
        assert read_map(own).record.nodes[room].name == f"submap {room}"
        edit(own, forget=(room,))
        assert bytes_of(own, "topology.json") == bytes_of(built.map, "topology.json")
        assert bytes_of(own, "overview.png") == picture
        with pytest.raises(UsageError, match="there is no submap 99 to name, describe or forget"):
            edit(own, forget=(99,))

    def test_a_file_edited_by_hand_is_applied(self, built: Built, own: Path) -> None:
        text = f"# by Ann\n[submaps.{built.rooms[1]}]\nname='Lab' # ours\n"
        (own / "edits.toml").write_text(text, encoding="utf-8")
        edit_map(own)
        assert read_map(own).names == {built.rooms[1]: "Lab"}
        assert (own / "edits.toml").read_text(encoding="utf-8") == text
        (own / "edits.toml").write_text("", encoding="utf-8")
        edit_map(own)
        assert read_map(own).names == {}

    def test_a_full_disk(self, own: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        full = OSError(28, "No space left on device", str(own / "map.png"))
        monkeypatch.setattr(shutil, "copyfile", Mock(side_effect=full))
        told = r"out: cannot be written: No space left on device; free some space, or choose"
        with pytest.raises(UsageError, match=told):
            edit_map(own, RequestedEdits(names={1: "Lab"}), tmp_path / "out")

    def test_one_name_for_two_rooms_is_told_once(self, own: Path) -> None:
        for names, told in (
            ({0: "Lab", 1: "Lab"}, [call("2 submaps are called 'Lab': 0, 1")]),
            ({0: "Lab", 2: "Hall"}, []),
            ({0: "submap 1", 1: ""}, [call("2 submaps are called 'submap 1': 0, 1")]),
        ):
            progress = Mock(Silent)
            edit_map(own, RequestedEdits(names=names), progress=progress)
            assert progress.warn.mock_calls == told

    def test_a_name_written_into_topology_json_is_a_person_s(self, own: Path) -> None:
        """And edits that the map shows must not be lost unsaid."""
        said = {"nodes__0__name": "Hall", "nodes__0__properties": {"floor": 2}}
        edit_json(own / "topology.json", **said)
        report = edit(own, names={1: "Lab"})
        assert read_map(own).names == {0: "Hall", 1: "Lab"}
        assert report.edits.submaps[0].properties == {"floor": 2}
        (own / "edits.toml").unlink()
        with pytest.raises(MapError, match=r"edits\.toml: is missing, but the map shows edits"):
            edit(own, names={1: "Lab"})

    def test_a_finished_grid_has_names_and_forbidden_doors(self, tmp_path: Path) -> None:
        segment_map(SAMPLE_LOGS / "office.yaml", tmp_path / "seg", QUICK)
        stored = read_map(tmp_path / "seg")
        edge = stored.record.edges[0]
        picture = bytes_of(tmp_path / "seg", "overview.png")
        pair = [edge.source, edge.target]
        assert edit(stored, {"forbid": pair}, names={0: "Lab"}).forbidden == (tuple(pair),)
        assert read_map(tmp_path / "seg").names == {0: "Lab"}
        assert bytes_of(tmp_path / "seg", "overview.png") != picture
        with pytest.raises(MapError, match=r"has no keyframes\.mcap: merges and splits need"):
            edit(tmp_path / "seg", {"merge": pair})
        forget_digests(tmp_path / "seg")
        (tmp_path / "seg" / "map.yaml").unlink()  # which earlier versions did not write
        assert edit(tmp_path / "seg", names={0: "Hall"}).names[0] == "Hall"


class TestBorders:
    """Merges and splits: grids, classifiers, regions and links are new, the layout is not."""

    def test_a_split_a_merge_then_neither(self, built: Built, own: Path, tmp_path: Path) -> None:
        room, corridor, before = built.rooms[0], built.corridor, read_map(built.map)
        new = before.topology.next_id
        edit_json(own / "run.json", versions__specmap="0.0.1")
        wish = split(before, corridor)
        names, slow = {room: "Lab", corridor: "Gang"}, {"speed_limit": 0.3}
        said: dict[str, Any] = {"names": names, "properties": {corridor: slow}}
        report = edit(own, wish, **said, out=tmp_path / "divided")
        divided = read_map(report.out)
        assert divided.topology.submaps[new].properties == slow, "half a room is no faster"
        assert divided.topology.submaps[new].name != "Gang"
        assert report.remade
        assert set(divided.ids) == {*before.ids, new}
        assert f"new = {new}" in (divided.path / "edits.toml").read_text(encoding="utf-8")
        (x, y), (x2, y2) = wish["line"]
        length = float(np.hypot(x2 - x, y2 - y))
        for id_, side in ((corridor, 1.0), (new, -1.0)):
            places = divided.map_grid.centres_of(np.argwhere(divided.regions.owner == id_))
            left = (x2 - x) * (places[:, 1] - y) - (y2 - y) * (places[:, 0] - x)
            assert (side * left / length > -0.15).mean() > 0.98
        assert (min(new, corridor), max(new, corridor)) in divided.topology.edges
        # or its features would be taken for those of the version before
        assert divided.run["versions"] == before.run["versions"]
        is_now = {"submaps": len(divided.ids), "edges": len(divided.topology.edges)}
        is_now["doors"] = len(divided.topology.doors)
        assert divided.run["counts"] == before.run["counts"] | is_now, "also the metres driven"

        report = edit(divided, {"merge": [corridor, room]}, out=tmp_path / "merged")
        merged = read_map(report.out)
        assert report.remade
        assert merged.ids == sorted({*divided.ids} - {room})
        assert merged.topology.next_id == divided.topology.next_id
        parts_m2 = divided.rooms[corridor].area_m2 + divided.rooms[room].area_m2
        assert merged.rooms[corridor].area_m2 == pytest.approx(parts_m2, abs=0.5)
        assert json.loads(merged.classifiers)["schema_version"] >= 1
        for name in ("keyframes.mcap", "trajectory.tum", "trajectory.g2o"):
            assert bytes_of(merged.path, name) == bytes_of(built.map, name)

        report = edit(merged, undo=(1, 2), out=tmp_path / "undone")
        undone = read_map(report.out)
        assert report.remade
        assert report.unapplied == (), "nothing is said of a submap that was never there"
        assert undone.labels.submaps.tolist() == before.labels.submaps.tolist()
        assert undone.regions.owner.tolist() == before.regions.owner.tolist()
        assert undone.topology.next_id == new + 1  # an id is given once

    def test_floor_of_others_stays_theirs_though_it_is_found_to_be_a_room_nobody_entered(
        self, built: Built, own: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """As it is after an update, when the division of all recordings finds one there."""
        before, (room, other) = read_map(own), built.rooms[:2]
        ways = cKDTree(before.labels.poses[:, :2])
        cells = np.argwhere(before.regions.owner == other)
        apart = cells[ways.query(before.map_grid.centres_of(cells))[0] > 0.5]
        assert len(apart) > 100

        def with_a_room_more(grid: GridMap, config: SegmentationConfig) -> Segmentation:
            found = segment(grid, config)
            labels = found.labels.copy()
            labels[tuple(apart.T)] = found.count
            return replace(found, labels=labels)

        monkeypatch.setattr(laying_out, "segment", with_a_room_more)
        edit(own, split(before, room))
        assert (read_map(own).regions.owner[tuple(apart.T)] == other).all()

    def test_a_merge_of_rooms_without_a_link_is_told(self, built: Built, tmp_path: Path) -> None:
        """In the order of the requests: with the corridor, each of the rooms is linked."""
        (one, other), corridor = sorted(built.rooms[:2]), built.corridor
        for pairs, told in (
            ([[one, other]], [f"submaps {one} and {other} were merged, though no link is between"]),
            ([[corridor, one], [corridor, other]], []),
        ):
            progress = Mock(Silent)
            changes = tuple({"merge": pair} for pair in pairs)
            out = tmp_path / str(len(pairs))
            edit_map(built.map, RequestedEdits(changes=changes), out, progress=progress)
            said = [str(each.args[0]) for each in progress.warn.mock_calls]
            assert said == [f"{line} them" for line in told]

    def test_a_split_along_the_doors_of_rooms_tells_which_it_cuts_off(
        self, built: Built, tmp_path: Path
    ) -> None:
        """The line is lengthened along the wall: a strip that no robot fits in is left there."""
        stored, progress = read_map(built.map), Mock(Silent)
        door = next(each for each in stored.topology.doors if built.corridor in each.between)
        beside = np.array([[door.x, door.y + away] for away in (-0.3, 0.3)])
        (y,) = beside[stored.regions.owners(beside) == built.corridor, 1].tolist()
        changes = ({"split": built.corridor, "line": [[door.x - 0.3, y], [door.x + 0.3, y]]},)
        cut = edit_map(
            built.map, RequestedEdits(changes=changes), tmp_path / "1", progress=progress
        )
        *of_quality, told = (each.args[0] for each in progress.warn.mock_calls)
        shown = re.fullmatch(r"no route leads to submaps? (.*) any more: no way there is .*", told)
        assert shown is not None
        left = {int(id_) for id_ in re.findall(r"\d+", shown[1])}
        assert left
        assert left < set(stored.ids)
        found = read_map(cut.out)
        before, after = quality_of_stored(stored), quality_of_stored(found)
        known = summary(before.warnings)
        assert of_quality == [line for line in summary(after.warnings) if line not in known]
        assert after.as_dict() == found.run["quality"]
        again = RequestedEdits(names={built.corridor: "Hall"})
        edit_map(cut.out, again, tmp_path / "2", progress=progress)
        assert progress.warn.call_count == len(of_quality) + 1, "it was told before"

    def test_the_map_stays_when_the_second_request_does_not_apply(self, built: Built) -> None:
        """Every request that is refused alone is in tests/cli/test_cli_finished.py."""
        rooms, notes = list(built.rooms[:2]), Mock(spec=Silent())
        requests = RequestedEdits(changes=({"merge": rooms}, {"forbid": rooms}))
        before = files_in(built.map)
        with pytest.raises(UsageError, match="there is no link between"):
            edit_map(built.map, requests, progress=notes)
        notes.note.assert_not_called()
        assert files_in(built.map) == before

    def test_a_keyframe_in_no_submap_keeps_borders(self, built: Built, own: Path) -> None:
        """It was a traceback: such a map may be read, but not be divided anew."""
        forget_digests(own)
        labels = own / "labels.csv"
        header, first, *rest = labels.read_text(encoding="utf-8").splitlines()
        lines = [header, first.rpartition(",")[0] + ",", *rest]
        labels.write_text("\n".join(lines) + "\n", encoding="utf-8")
        with pytest.raises(MapError, match=r"labels\.csv: keyframe 0 is in no submap"):
            edit(own, split(read_map(own), built.corridor))

    def test_what_no_longer_applies_is_told_and_kept(self, own: Path) -> None:
        text = "[submaps.99]\nname = 'Attic'\n[[changes]]\nmerge = [0, 99]\n"
        (own / "edits.toml").write_text(text, encoding="utf-8")
        notes = Mock(spec=Silent())
        report = edit_map(own, RequestedEdits(names={0: "Lab"}), progress=notes)
        none = "there is no submap 99"
        assert report.unapplied == (f"submaps.99: {none}", f"changes, number 1: {none}")
        told = [call(f"edits.toml: not applied: {line}") for line in report.unapplied]
        assert notes.note.mock_calls == told
        assert "'Attic'" in (own / "edits.toml").read_text(encoding="utf-8")
        assert "  not applied: submaps.99: there is no submap 99" in report.lines()


class TestForbiddenDoors:
    def test_link_and_doors_are_marked_everywhere(self, built: Built, tmp_path: Path) -> None:
        room, other = built.rooms[:2]
        pair = tuple(sorted((room, built.corridor)))
        requested = RequestedEdits(changes=({"forbid": [room, built.corridor]},))
        progress = Mock(Silent)
        shut = edit_map(built.map, requested, tmp_path / "shut", progress=progress)
        told = f"no route leads to submap {room} any more: every way there is forbidden"
        assert progress.warn.mock_calls == [call(told)]
        stored = read_map(shut.out)
        assert shut.forbidden == (pair,)
        assert not shut.remade
        edges = {(edge.source, edge.target): edge.forbidden for edge in stored.record.edges}
        assert [key for key, forbidden in edges.items() if forbidden] == [pair]
        for door in stored.record.graph.doors:
            assert door.forbidden == (door.between == pair)
        assert pair not in stored.topology.joined
        for name, word in (("geojson", '"forbidden": true'), ("graphml", "forbidden")):
            export_map(stored, name, tmp_path / name)
            assert word in (tmp_path / name).read_text(encoding="utf-8")
        merged = edit(stored, {"merge": [other, room]}, out=tmp_path / "merged")
        assert merged.forbidden == (tuple(sorted((other, built.corridor))),)

    def test_a_place_chooses_the_door(self, built: Built, own: Path) -> None:
        pair = [built.rooms[0], built.corridor]
        edge = read_map(own).topology.edges[min(pair), max(pair)]
        assert edge.crossing is not None
        x, y = edge.crossing
        with pytest.raises(UsageError, match=r"no door between the two is within 2 m of"):
            edit(own, {"forbid": pair, "at": [x + 5.0, y]})
        near = edit(own, {"forbid": pair, "at": [x + 0.2, y]})
        assert near.forbidden == ((min(pair), max(pair)),)

    def test_the_way_takes_another_door_meanwhile(self, result: MapResult, tmp_path: Path) -> None:
        """Two rooms side by side, with two doors."""
        whole = two_rooms((5.3, 4.4, 5.5, 5.3), (5.3, 1.5, 5.5, 2.2)).grid
        poses = result.labels.poses.copy()
        poses[:, 0], poses[:, 1] = np.where(np.arange(30) < 20, 3.0, 7.5), 3.3
        labels = replace(result.labels, poses=poses, submaps=np.repeat([0, 0, 1], 10))
        rooms = {
            0: replace(result.topology.submaps[0], keyframes=tuple(range(20))),
            1: replace(result.topology.submaps[2], id=1),
        }
        regions = divide(whole, labels)
        topology = with_ways(TopologicalMap(submaps=rooms), regions, Config().ways, poses)
        way = Trajectory(labels.stamps_ns, poses)
        laid = replace(result, topology=topology, regions=regions, labels=labels, trajectory=way)
        write_map(tmp_path, laid)
        text, (edge,) = bytes_of(tmp_path, "topology.json"), topology.edges.values()
        used, spare = sorted(topology.doors, key=lambda door: door.id not in edge.doors)
        edit(tmp_path, {"forbid": [0, 1], "at": [used.x, used.y]})
        after = read_map(tmp_path).topology.edges[0, 1]
        assert (after.doors, after.forbidden) == ((spare.id,), False)
        assert after.crossing == pytest.approx((spare.x, spare.y))
        assert after.path is not None
        assert crossing_of(after.path, used) is None
        edit(tmp_path, undo=(1,))
        assert bytes_of(tmp_path, "topology.json") == text

    def test_it_holds_when_the_split_before_is_undone(self, built: Built, own: Path) -> None:
        edit(own, split(read_map(own), built.corridor))
        stored = read_map(own)
        new = stored.topology.next_id - 1
        pairs = (pair for pair in stored.topology.edges if built.corridor not in pair)
        pair = next(pair for pair in pairs if new in pair)
        edit(own, {"forbid": list(pair)})
        report = edit(own, undo=(1,))
        (room,) = set(pair) - {new}
        assert report.unapplied == ()
        assert report.forbidden == ((min(room, built.corridor), max(room, built.corridor)),)


@pytest.fixture(scope="module")
def edited(built: Built, tmp_path_factory: pytest.TempPathFactory) -> EditReport:
    """A room named, described and shut off, the corridor divided, and a word about no submap."""
    room, before = built.rooms[0], read_map(built.map)
    wishes = split(before, built.corridor), {"forbid": [room, built.corridor]}
    said: Any = {"names": {room: "Küche"}, "kinds": {room: "hall"}}
    said["properties"] = {room: {"floor": 2}}
    made = edit(before, *wishes, **said, out=tmp_path_factory.mktemp("edited") / "own")
    text = (made.out / "edits.toml").read_text(encoding="utf-8")
    text = f"# by Ann\n{text}\n[submaps.99]\nname = 'Attic'\n"
    (made.out / "edits.toml").write_text(text, encoding="utf-8")
    return made


Rebuilt = Callable[[Path, Path, Path], Any]


@pytest.mark.parametrize(
    "rebuilt",
    [
        lambda old, log, out: update_map(old, log, out, QUICK),
        lambda old, log, out: build_like(log, old, out, QUICK),
    ],
    ids=["update", "build --like"],
)
def test_edits_survive(built: Built, edited: EditReport, tmp_path: Path, rebuilt: Rebuilt) -> None:
    room, other = built.rooms[:2]
    rebuilt(edited.out, built.again.log.log, tmp_path / "new")
    stored, old = read_map(tmp_path / "new"), read_map(edited.out)
    submap = stored.topology.submaps[room]
    assert (submap.name, submap.kind, dict(submap.properties)) == ("Küche", "hall", {"floor": 2})
    assert set(stored.ids) == set(old.ids)
    forbidden = {pair for pair, edge in stored.topology.edges.items() if edge.forbidden}
    assert forbidden >= set(edited.forbidden)
    kept = (tmp_path / "new" / "edits.toml").read_text(encoding="utf-8")
    assert kept.startswith("# by Ann\n")
    assert "'Attic'" in kept
    new = read_map(built.map).topology.next_id
    there = stored.regions.owners(old.map_grid.centres_of(np.argwhere(old.regions.owner == new)))
    assert (there == new).mean() > 0.9
    undone = edit(stored, undo=(1,), out=tmp_path / "undone")
    assert new not in undone.names
    assert other in undone.names


def test_a_merged_map_has_both_edits(built: Built, edited: EditReport, tmp_path: Path) -> None:
    second = built.again.stored
    (link,) = (edge for edge in second.record.edges if edge.target == max(second.ids))
    wish = {"forbid": [link.source, link.target], "at": [link.x, link.y]}
    names = {link.source: "Annex", link.target: "Annex 2"}
    edit(second, wish, names=names, out=tmp_path / "second")
    merge_maps([edited.out, tmp_path / "second"], tmp_path / "both", QUICK)
    both = read_map(tmp_path / "both")
    assert both.names[built.rooms[0]] == "Küche"
    assert "Annex" in both.names.values()
    assert sum(edge.forbidden for edge in both.record.edges) == 2
    assert read_map(built.map).topology.next_id in both.ids, "the corridor is divided"


def test_borders_of_a_later_map_move_in_both(built: Built, own: Path, tmp_path: Path) -> None:
    """Though the first map divides the same place in its own way; and they can be undone there."""
    second = read_map(shutil.copytree(built.again.map, tmp_path / "second"))
    corridor = corridor_of(second)
    room = next(id_ for id_ in second.ids if id_ != corridor)
    plain = merge_maps([own, second], tmp_path / "plain", QUICK)
    new = max(edit(second, split(second, corridor), {"merge": [corridor, room]}).names)
    edit(read_map(second.path), names={new: "Far end", corridor: "Hall"})
    edit(own, names={plain.ids["second"][corridor]: "Lobby"})
    with (second.path / "edits.toml").open("a", encoding="utf-8") as file:
        file.write(f"\n[[changes]]\nmerge = [{corridor}, 99]\n")
    report = merge_maps([own, second.path], tmp_path / "both", QUICK)
    both, edited = read_map(tmp_path / "both"), read_map(second.path)
    assert report.unapplied == (
        f"in the map of second.mcap: merge 99 into {corridor}: there is no submap 99",
        f"in the map of second.mcap: submaps.{corridor}: 'Hall' is 'Lobby' in an earlier map",
    )
    assert report.as_dict()["unapplied"] == list(report.unapplied)
    far, near = report.ids["second"][new], report.ids["second"][corridor]
    assert (both.names[far], both.names[near]) == ("Far end", "Lobby")
    assert far not in read_map(own).ids
    assert near == plain.ids["second"][corridor]
    assert plain.ids["second"][room] not in both.ids, "it is a part of the corridor now"
    places = both.map_grid.centres_of(np.argwhere(both.regions.owner == far))
    track = edited.labels.poses[:, :2]
    motion = nearest_motion(track, both.labels.poses[-len(track) :, :2])
    assert (edited.regions.owners(motion.inverse().apply(places)) == new).mean() > 0.8
    undone = edit(both, undo=(1, 2), out=tmp_path / "undone")
    assert sorted(undone.names) == read_map(tmp_path / "plain").ids
