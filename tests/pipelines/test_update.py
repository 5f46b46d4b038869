"""A map takes in another log; maps made one, in any order; a map in the frame of another."""

import json
import pickle
import shutil
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from specmap_cli import read_map
from specmap_cli.core.errors import InputError, MapError, NoResultError, UsageError
from specmap_cli.core.geometry import Pose2
from specmap_cli.core.progress import Silent
from specmap_cli.core.records import IntArray
from specmap_cli.core.settings import UpdateConfig
from specmap_cli.evaluation.trajectories import reference_errors
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.grids.keyframes import integrate_keyframes
from specmap_cli.maps.features_file import write_features
from specmap_cli.maps.store import Map
from specmap_cli.maps.text_files import read_tum
from specmap_cli.pipelines.laying_out import with_grid
from specmap_cli.pipelines.learning import submap_grids
from specmap_cli.pipelines.localizer import settings_for
from specmap_cli.pipelines.map_in_making import laid_out_of_stored
from specmap_cli.pipelines.merge import merge_maps
from specmap_cli.pipelines.overlaps import PairOfMaps
from specmap_cli.pipelines.reports import MergeReport, UpdateReport
from specmap_cli.pipelines.session import Session
from specmap_cli.pipelines.simulate import SimulationResult, simulate
from specmap_cli.pipelines.thinning import Thinned
from specmap_cli.pipelines.update import build_like, redivided, update_map
from specmap_cli.recognition.closure.alignment import Alignment
from specmap_cli.recognition.learning.sampling import Track
from specmap_cli.simulation.simulator import SimulationOptions
from specmap_cli.topology.identity import BorderChange
from specmap_cli.topology.regions import NOBODY
from specmap_cli.topology.topological_map import driven_m
from tests.flats import QUICK, Mapped, forget_digests, mapped
from tests.maps.conftest import edit
from tests.pipelines.conftest import day
from tests.turning import turned


@dataclass(frozen=True)
class Kept:
    """A map of the flat with its third room closed, and what an update with the open flat made.

    The scans that the old map learned from are all ones there, which no scan of the new log is.
    """

    first: SimulationResult
    second: SimulationResult
    old: Map
    new: Map
    report: UpdateReport

    @property
    def first_new(self) -> int:
        assert self.new.logs[1].keyframes is not None
        return self.new.logs[1].keyframes[0]

    @property
    def left(self) -> IntArray:
        """The old keyframes that the update left, by their old numbers."""
        rows = np.isin(self.old.labels.stamps_ns, self.new.labels.stamps_ns[: self.first_new])
        return np.flatnonzero(rows)


@pytest.fixture(scope="module")
def kept(
    sunday: Mapped,
    flat: GridMap,
    flat_options: SimulationOptions,
    tmp_path_factory: pytest.TempPathFactory,
) -> Kept:
    folder = tmp_path_factory.mktemp("update")
    again = {"laps": 1, "seed": 8, "spacing_m": 1.5, "rate_hz": 6.0}
    with day(0):
        second = simulate(flat, flat_options.model_copy(update=again), folder / "second.mcap")
    shutil.copytree(sunday.map, folder / "old")
    said = {"nodes__1__name": "Hallway", "nodes__1__properties": {"floor": 2}}
    edit(folder / "old" / "topology.json", **said, graph__next_id=7)  # some submaps are no more
    features = read_map(folder / "old").features
    assert features is not None
    ones = {kind: np.ones_like(features[kind]) for kind in ("raw", "along")}
    write_features(folder / "old" / "features.npz", {**features, **ones})
    forget_digests(folder / "old")
    report = update_map(folder / "old", second.log, folder / "new", QUICK)
    return Kept(sunday.log, second, read_map(folder / "old"), read_map(folder / "new"), report)


def test_old_submaps_keep_ids_names_keyframes_visits_borders_and_frames(kept: Kept) -> None:
    left, labels = kept.left, kept.new.labels
    assert len(left) == kept.first_new
    assert (labels.submaps[: len(left)] == kept.old.labels.submaps[left]).all()
    assert set(kept.old.ids) < set(kept.new.ids)
    submap = kept.new.topology.submaps[1]
    assert (submap.name, dict(submap.properties)) == ("Hallway", {"floor": 2})
    assert kept.new.topology.submaps[0].name == "submap 0"
    grid, owner = kept.old.regions.grid, kept.old.regions.owner
    for id_ in kept.old.ids:
        before, after = (map_.topology.submaps[id_].visits for map_ in (kept.old, kept.new))
        assert after[: len(before)] == before
        found = kept.new.regions.owners(grid.centres_of(np.argwhere(owner == id_)))
        assert (found == id_).mean() > 0.9
    moved = labels.poses[: len(left), :2] - kept.old.labels.poses[left, :2]
    assert np.hypot(*moved.T).max() < 0.05


def test_what_the_second_recording_shows_again_is_let_go_and_said(kept: Kept) -> None:
    told = kept.report.run["updates"][-1]
    count = len(kept.old.labels.submaps)
    assert told["keyframes_dropped"] == count - kept.first_new > 0.3 * count
    assert kept.report.as_dict()["keyframes_dropped"] == told["keyframes_dropped"]
    assert any("older keyframes dropped" in line for line in kept.report.lines())
    before, after = kept.old.logs[0], kept.new.logs[0]
    assert after.path_m == pytest.approx(kept.old.run["counts"]["path_m"], abs=0.1)
    way_m = driven_m(kept.new.logs, kept.new.labels)  # what history, compare and check tell
    assert kept.new.run["counts"]["path_m"] == pytest.approx(way_m, abs=0.001)
    when = [(log.start_ns, log.end_ns, log.scans) for log in (before, after)]
    assert when[0] == when[1]


def test_old_stays_and_closures_stay_and_loops_close_between_the_logs(kept: Kept) -> None:
    stays = {stay.number: stay for stay in kept.new.topology.stays}
    for stay in kept.old.topology.stays:
        now = stays[stay.number]
        assert (now.submap, now.start_ns, now.end_ns) == (stay.submap, stay.start_ns, stay.end_ns)
    count, first_new = len(kept.old.topology.closures), kept.first_new
    assert kept.new.topology.closures[:count] == kept.old.topology.closures
    joined = [
        each
        for each in kept.new.topology.closures
        if stays[each.old].keyframes[0] < first_new <= stays[each.new].keyframes[0]
    ]
    assert len(joined) >= 2
    assert all(closure.merged and closure.old_from_new is not None for closure in joined)


def test_scans_that_were_learned_from_are_learned_from_again(kept: Kept) -> None:
    found = kept.new.features
    assert found is not None
    for kind in ("raw", "along"):
        old = found[kind + "_keyframes"] < kept.first_new
        assert 0 < np.count_nonzero(old) < len(old)
        assert ((found[kind] == 1.0).all(axis=0) == old).all()


def test_damaged_features_are_refused_before_the_log_is_read(kept: Kept, tmp_path: Path) -> None:
    old, new = shutil.copytree(kept.old.path, tmp_path / "old"), tmp_path / "new"
    (old / "features.npz").write_bytes(b"PK")
    stages = Mock(spec=Silent())
    with pytest.raises(MapError, match=r"features\.npz: is no zip file of arrays: delete it"):
        update_map(old, kept.second.log, new, QUICK, progress=stages)
    stages.start.assert_not_called()
    assert not new.exists()


def test_with_a_setting_every_keyframe_stays(kept: Kept, tmp_path: Path) -> None:
    """And as the number of rounds is another, too, pieces are held out again."""
    recognition = QUICK.recognition.model_copy(update={"rounds": 5})
    changed = {"recognition": recognition, "update": UpdateConfig(keep_all=True)}
    settings = QUICK.model_copy(update=changed)
    whole = update_map(kept.old, kept.second.log, tmp_path / "map", settings)
    stored, count = read_map(whole.out), len(kept.old.labels.submaps)
    of_both = (json.loads(map_.classifiers)["calibration"] for map_ in (kept.new, stored))
    views, held_out = (told["views"] for told in of_both)
    assert 0 < views != held_out
    assert whole.as_dict()["keyframes_dropped"] == 0
    assert not any("dropped" in line for line in whole.lines())
    assert stored.labels.submaps[:count].tolist() == kept.old.labels.submaps.tolist()
    path_m = kept.report.run["counts"]["path_m"]
    assert whole.run["counts"]["path_m"] == pytest.approx(path_m, abs=0.1)
    apart = np.abs(stored.labels.poses[kept.left] - kept.new.labels.poses[: kept.first_new])
    assert apart.max() < 1e-6  # fewer keyframes, the same layout


def test_the_room_that_opened_gets_an_id_that_was_never_given(kept: Kept) -> None:
    assert kept.report.new == (7,)
    assert set(kept.report.visited) == set(kept.old.ids)
    assert kept.new.record.graph.next_id == 8
    assert kept.new.topology.submaps[7].grid.free_area_m2 > 5.0
    assert any(7 in (edge.source, edge.target) for edge in kept.new.record.edges)


def test_what_the_second_recording_looked_at_is_drawn_as_it_saw_it(kept: Kept) -> None:
    """As if the building stood 0.3 m farther on by then: the old walls are looked through."""
    laid = laid_out_of_stored(kept.new)
    second = np.arange(kept.first_new, len(laid))
    poses = laid.layout.poses.copy()
    poses[second, :2] += 0.3
    laid = replace(laid, layout=replace(laid.layout, poses=poses))
    one_room = replace(laid.labels, poses=poses, submaps=np.zeros(len(laid), dtype=np.int64))
    shares = []
    for looks in (8, 10**6):  # as many tell how a cell is now; the second says that none does
        with turned("grids.occupancy", _RENEWED_BY=looks), kept.new.scans() as store:
            session = Session(settings_for(kept.new, {}), store, Silent())
            config = session.config.grid
            alone = integrate_keyframes(store, second.tolist(), poses[second], config).snapshot()
            walls = alone.centres_of(np.argwhere(alone.occupied))
            room = submap_grids(Track.of(store, one_room, laid.starts), config)[0]
            whole, in_room = with_grid(session, laid).whole, Pose2(*poses[0]).inverse().apply(walls)
            drawn = whole.values_at(walls), room.values_at(in_room)
            shares.append([float(np.mean(cells == OCCUPIED)) for cells in drawn])
    assert np.greater(shares[0], np.add(shares[1], 0.03)).all(), shares


def test_a_submap_that_a_wall_cuts_in_two_becomes_two(kept: Kept) -> None:
    """As if the update had seen a wall across the largest submap."""
    old = laid_out_of_stored(kept.old)
    with kept.old.scans() as store:
        old = with_grid(Session(settings_for(kept.old, {}), store, Silent()), old)
    largest = max(old.regions.outlines, key=lambda id_: old.regions.outlines[id_].area_m2)
    floor = np.argwhere(old.regions.owner == largest)
    along = int(np.ptp(floor, axis=0).argmax())
    middle = int(np.median(floor[:, along]))
    cells = old.whole.cells.copy()
    cells[(slice(None),) * along + (slice(middle, middle + 2),)] = OCCUPIED
    walled = replace(old, drawn=replace(old.whole, cells=cells))
    for laid, new in ((old, set()), (walled, {7})):
        fewer = Thinned(laid, np.arange(len(old)), len(old))
        found = redivided(old, old, fewer, settings_for(kept.old, {})).laid
        assert set(found.labels.submaps.tolist()) - set(old.labels.submaps.tolist()) == new
        assert found.next_id == 7 + len(new)
    assert set(old.labels.submaps[found.labels.submaps == 7].tolist()) == {largest}


def test_both_logs_are_in_the_map_and_nobody_drove_from_one_to_the_next(kept: Kept) -> None:
    logs = kept.new.record.graph.logs
    count = kept.first_new
    assert [log.name for log in logs] == ["sunday.mcap", "second.mcap"]
    assert logs[0].keyframes == (0, count - 1)
    assert logs[1].keyframes == (count, len(kept.new.labels.submaps) - 1)
    total = kept.first.scans + kept.second.scans
    assert kept.report.run["counts"]["scans"] == total == sum(log.scans for log in logs)
    with kept.new.scans() as store:
        assert len(store) == len(kept.new.labels.submaps)
    assert kept.report.quality.verdict == "good"
    first_new_ns = int(kept.new.labels.stamps_ns[count])
    assert all(edge.kind == "traversed" for edge in kept.new.record.edges)
    starts = [visit.start_ns for node in kept.new.record.nodes for visit in node.visits]
    assert sum(abs(start - first_new_ns) < 1e4 for start in starts) >= 1
    path_m = kept.old.run["counts"]["path_m"] + 35.0
    assert kept.report.run["counts"]["path_m"] == pytest.approx(path_m, abs=8.0)


def test_the_joint_layout_is_as_good_as_either(kept: Kept, tmp_path: Path) -> None:
    lines = (kept.new.path / "trajectory.tum").read_text(encoding="utf-8").splitlines()
    count, piece = kept.first.scans, tmp_path / "piece.tum"
    assert len(lines) == count + kept.second.scans
    for log, own in ((kept.first, lines[:count]), (kept.second, lines[count:])):
        piece.write_text("\n".join(own) + "\n", encoding="utf-8")
        assert reference_errors(read_tum(piece), read_tum(log.truth)).ate_m < 0.06


def test_a_log_is_taken_once_and_one_of_another_building_is_refused_or_stands_apart(
    kept: Kept, other: Mapped, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=r"second\.mcap: is in the map already, as second\.mcap"):
        update_map(kept.new, kept.second.log, tmp_path / "out", QUICK)
    with pytest.raises(NoResultError, match=r"other\.mcap: fits nowhere .* --allow-apart"):
        update_map(kept.old, other.log.log, tmp_path / "out", QUICK)
    assert not (tmp_path / "out").exists()
    report = update_map(kept.old, other.log.log, tmp_path / "out", QUICK, allow_apart=True)
    apart = read_map(tmp_path / "out")
    assert report.visited == ()
    assert report.quality.verdict != "good"
    known = set(kept.old.ids)
    assert not any((e.source in known) != (e.target in known) for e in apart.record.edges)
    for id_ in report.new:
        assert apart.record.nodes[apart.ids.index(id_)].x > kept.old.map_grid.origin[0] + 20.0


def test_borders_that_moved_are_said_with_the_reason(kept: Kept) -> None:
    assert kept.report.as_dict()["borders_moved"] == []
    assert [change.submap for change in kept.report.borders] == sorted(kept.old.ids)
    moved = BorderChange(submap=1, iou=0.5, was_m2=20.0, given={7: 9.0, 0: 1.0}, taken={NOBODY: 2})
    report = replace(kept.report, borders=(moved,))
    assert report.lines()[2].endswith(
        "the border of submap 1 moved (IoU 0.50): 9.0 m2 that were only looked into are in 7, "
        "entered now; 1.0 m2 are in 0 now; 2.0 m2 of no submap are in it now"
    )
    assert (kept.report.cut_off, report.as_dict()["cut_off"]) == ((), [])
    walled = replace(report, new=(), cut_off=(7,))
    assert "9.0 m2 are in 7, cut off by a wall now; 1.0 m2 are in 0 now" in walled.lines()[2]
    assert walled.as_dict()["cut_off"] == [7]
    told = report.as_dict()["borders_moved"][0]
    assert told["given"] == [{"submap": 7, "m2": 9.0}, {"submap": 0, "m2": 1.0}]
    assert told["taken"] == [{"submap": None, "m2": 2}]


# bottom, top, left and right cell of an L of corridor and rooms off it, none like another
ROOMS = (
    (4, 38, 4, 196), (38, 180, 4, 38), (42, 110, 42, 96),
    (42, 90, 100, 140), (42, 130, 144, 196), (114, 180, 42, 120),
)  # fmt: skip
DOORS = {"third": np.s_[38:42, 160:178], "second": np.s_[38:42, 112:130]}
DOORS |= {"first": np.s_[38:42, 60:78], "upper": np.s_[140:158, 38:42]}


def building(closed: str) -> GridMap:
    cells = np.full((184, 200), OCCUPIED, dtype=np.uint8)
    for bottom, top, left, right in ROOMS:
        cells[bottom:top, left:right] = FREE
    cells[60:76, 60:80] = OCCUPIED  # a table
    cells[120:132, 100:112] = OCCUPIED
    for name, door in DOORS.items():
        cells[door] = OCCUPIED if name == closed else FREE
    return GridMap(cells, 0.05)


@dataclass(frozen=True)
class Parts:
    """Maps of the building with one of two rooms closed, of another building, and their logs."""

    third_closed: Map
    first_closed: Map
    other: Map
    logs: dict[str, SimulationResult]


@pytest.fixture(scope="module")
def parts(
    flat_options: SimulationOptions, other: Mapped, tmp_path_factory: pytest.TempPathFactory
) -> Parts:
    folder = tmp_path_factory.mktemp("merge")
    made = {}
    for seed, closed in enumerate(("third", "first")):
        (folder / closed).mkdir()
        options = flat_options.model_copy(update={"laps": 1, "seed": seed})
        made[closed] = mapped(building(closed), options, folder / closed)
    last = len(made["first"].stored.ids) - 1
    edit(made["first"].map / "topology.json", **{f"nodes__{last}__name": "Named"})
    logs = {name: one.log for name, one in (*made.items(), ("other", other))}
    return Parts(made["third"].stored, made["first"].stored, other.stored, logs)


@pytest.fixture(scope="module")
def both(parts: Parts, tmp_path_factory: pytest.TempPathFactory) -> MergeReport:
    out = tmp_path_factory.mktemp("both") / "map"
    return merge_maps([parts.third_closed, parts.first_closed], out, QUICK)


def test_maps_that_meet_become_one_with_names_and_ids(parts: Parts, both: MergeReport) -> None:
    merged = read_map(both.out)
    assert both.parts == (("first", "third"),) or both.parts == (("third", "first"),)
    scans = sum(parts.logs[name].scans for name in ("third", "first"))
    counts = both.run["counts"]
    assert counts["scans"] == scans
    assert counts["doors"] == len(merged.record.graph.doors)
    assert both.quality.verdict == "good"
    areas = [parts.third_closed.map_grid.free_area_m2, parts.first_closed.map_grid.free_area_m2]
    assert merged.map_grid.free_area_m2 > max(areas) + 5.0, "each map knew a room more"
    assert len(merged.ids) >= 4
    starts = [0, *(log.scans for log in merged.record.graph.logs)]
    lines = (both.out / "trajectory.tum").read_text(encoding="utf-8").splitlines()
    for log, start in zip(merged.record.graph.logs, np.cumsum(starts), strict=False):
        piece = both.out.parent / "piece.tum"
        piece.write_text("\n".join(lines[start : start + log.scans]) + "\n", encoding="utf-8")
        truth = read_tum(parts.logs[log.name.removesuffix(".mcap")].truth)
        assert reference_errors(read_tum(piece), truth).ate_m < 0.06
    named = both.ids["first"][max(parts.first_closed.ids)]
    assert merged.topology.submaps[named].name == "Named"
    for name, stored in (("third", parts.third_closed), ("first", parts.first_closed)):
        assert set(both.ids[name]) == set(stored.ids)
        assert set(both.ids[name].values()) <= set(merged.ids)


def test_order_and_place_do_not_matter(parts: Parts, both: MergeReport, tmp_path: Path) -> None:
    def elsewhere(
        align: Callable[[PairOfMaps], Alignment], pairs: Sequence[PairOfMaps]
    ) -> Iterable[Alignment]:
        """As on a worker: all that goes there and comes back is pickled."""
        sent_align, sent_pairs = pickle.loads(pickle.dumps((align, pairs)))
        assert len(sent_pairs) == 1
        return [pickle.loads(pickle.dumps(sent_align(pair))) for pair in sent_pairs]

    maps = [parts.first_closed, parts.third_closed]
    again = merge_maps(maps, tmp_path / "map", QUICK, spread=elsewhere)
    assert again.ids == both.ids
    for file in ("topology.json", "labels.csv", "trajectory.tum", "classifiers.json", "map.png"):
        assert (again.out / file).read_bytes() == (both.out / file).read_bytes()


def test_maps_that_do_not_meet_stay_apart_and_are_named(parts: Parts, tmp_path: Path) -> None:
    report = merge_maps([parts.other, parts.third_closed], tmp_path / "map", QUICK)
    assert sorted(report.parts) == [("other",), ("third",)]
    assert any("2 parts that do not meet: " in line for line in report.lines())
    assert report.quality.verdict == "doubtful"
    assert not set(report.ids["other"].values()) & set(report.ids["third"].values())
    merged = read_map(tmp_path / "map")
    one = set(report.ids["other"].values())
    assert not any((edge.source in one) != (edge.target in one) for edge in merged.record.edges)


def test_what_cannot_be_merged(parts: Parts, both: MergeReport, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="1 map to merge: give two or more"):
        merge_maps([parts.other], tmp_path / "map", QUICK)
    with pytest.raises(InputError, match=r"holds (first|third)\.mcap, and so does"):
        merge_maps([parts.third_closed, parts.first_closed, both.out], tmp_path / "map", QUICK)
    assert not (tmp_path / "map").exists()


def test_a_fresh_map_takes_ids_and_names(parts: Parts, both: MergeReport, tmp_path: Path) -> None:
    like = read_map(both.out)
    log = parts.logs["first"]
    fresh = read_map(build_like(log.log, like, tmp_path / "map", QUICK).out)
    assert set(fresh.ids) <= set(like.ids)
    assert all(like.rooms[id_].name == room.name for id_, room in fresh.rooms.items())
    for id_ in fresh.ids:
        cells = np.argwhere(fresh.regions.owner == id_)
        found = like.regions.owners(fresh.regions.grid.centres_of(cells))
        assert (found == id_).mean() > 0.9, "same place, same id, same border"
    assert fresh.record.graph.logs[0].scans == log.scans
    assert len(fresh.record.graph.logs) == 1
    with pytest.raises(NoResultError, match=r"other\.mcap: fits nowhere .* without --like"):
        build_like(parts.logs["other"].log, like, tmp_path / "no", QUICK)
    assert not (tmp_path / "no").exists()
