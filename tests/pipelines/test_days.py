"""Maps of several days: one building or two, rooms that stay the same, and what changed."""

import json
import re
import shutil
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from specmap_cli.checking.rules import figures_of
from specmap_cli.cli import main
from specmap_cli.core.errors import MapError, NoResultError, UsageError
from specmap_cli.core.geometry import Pose2
from specmap_cli.grids.gridmap import FREE, GridMap
from specmap_cli.history import record
from specmap_cli.history.record import BuildingRecord
from specmap_cli.maps.directory import result_directory
from specmap_cli.maps.store import read_map
from specmap_cli.pipelines import compare
from specmap_cli.pipelines.build import build_map
from specmap_cli.pipelines.compare import COMPARISON, PICTURE, SUMMARY, Comparison, compare_maps
from specmap_cli.pipelines.history import history_of
from specmap_cli.pipelines.simulate import simulate
from specmap_cli.recognition.closure.common_ground import PieceFit, bent_motion
from specmap_cli.simulation.simulator import SimulationOptions
from specmap_cli.topology.regions import NOBODY
from tests.comparisons import comparison
from tests.flats import QUICK, Mapped, rows
from tests.maps.test_store import files_in


@pytest.fixture(scope="module")
def building(week: Path) -> BuildingRecord:
    (found,) = history_of([week]).record.buildings
    return found


def test_days_are_a_series_in_which_a_recording_counts_once(building: BuildingRecord) -> None:
    assert [Path(one.map).name for one in building.maps] == ["monday", "tuesday", "wednesday"]
    assert [one.compared_with for one in building.maps] == [None, 0, 1]
    assert [day.day for day in building.days] == ["2025-11-24", "2025-11-25", "2025-11-26"]
    assert [day.recordings for day in building.days] == [1, 1, 1]
    for number, room in {room.number: room for room in building.rooms}.items():
        by_day = [stay for day in building.days for stay in day.rooms if stay.room == number]
        assert room.visits == sum(stay.visits for stay in by_day)
        assert room.minutes == pytest.approx(sum(stay.minutes for stay in by_day), abs=1e-5)
        assert room.days == len(by_day)
    assert {room.map for room in building.rooms} == {0}
    assert sum(room.days == 3 for room in building.rooms) >= 3
    for day in building.days:
        assert 0.9 * day.minutes <= sum(stay.minutes for stay in day.rooms) <= day.minutes + 1e-6


def test_what_changed_has_its_days_and_rooms(building: BuildingRecord) -> None:
    kinds = sorted(change.kind for change in building.changes)
    assert kinds == ["appeared", "door-closed", "door-opened"]
    days = {(change.since, change.day) for change in building.changes}
    assert days == {("2025-11-25", "2025-11-26")}
    assert all(change.rooms for change in building.changes)
    (closed,) = (one for one in building.changes if one.kind == "door-closed")
    assert closed.size == pytest.approx(0.9, abs=0.15)


def test_the_last_name_that_a_person_gave_is_used(week: Path, tmp_path: Path) -> None:
    """That of the submap that has most of the room, whatever a smaller one in it is called."""
    edited = shutil.copytree(week / "wednesday", tmp_path / "wednesday")
    labels = read_map(edited).labels
    x, y = np.percentile(labels.poses[labels.submaps == 0, :2], 80.0, axis=0).tolist()
    line = f"edit {edited} --rename 0 Kitchen --split 0 {x},-50,{x},{y + 50}".split()
    assert main([*line, "-q"]) == 0
    assert main([*line[:3], str(max(read_map(edited).ids)), "Larder", "-q"]) == 0
    (building,) = history_of([week / "monday", edited]).record.buildings
    assert [room.name for room in building.rooms].count("Kitchen") == 1


def test_another_building_is_one_of_its_own(week: Path, other: Mapped) -> None:
    record = history_of([week / "monday", other.map]).record
    assert [building.name for building in record.buildings] == ["other", "monday"]
    assert [map_.number for building in record.buildings for map_ in building.maps] == [0, 1]


def test_new_space_is_a_new_room(sunday: Mapped, week: Path) -> None:
    (building,) = history_of([sunday.map, week / "monday"]).record.buildings
    added = [change for change in building.changes if change.kind == "room-added"]
    assert len(added) == 1
    (number,) = added[0].rooms
    (room,) = (one for one in building.rooms if one.number == number)
    assert room.map == 1
    assert added[0].size == pytest.approx(room.area_m2)
    assert room.visits >= 1


def test_a_room_that_was_only_looked_into_is_one_of_its_own_once_entered(
    flat: GridMap, week: Path, tmp_path: Path
) -> None:
    """The tour ends before the third room, which the corridor has in this map."""
    options = SimulationOptions(range_max_m=12, rate_hz=3, speed_mps=0.9, seed=3, max_duration_s=50)
    build_map(simulate(flat, options, tmp_path / "short.mcap").log, tmp_path / "short", QUICK)
    looked, entered = (read_map(path) for path in (tmp_path / "short", week / "monday"))
    inside = entered.labels.poses[entered.labels.submaps == 3]
    owners = looked.regions.owners(inside)
    assert len(looked.rooms) == 3
    assert np.bincount(owners[owners != NOBODY], minlength=3).argmax() == 1
    (building,) = history_of([looked.path, entered.path]).record.buildings
    assert [(room.number, room.map) for room in building.rooms] == [(0, 0), (1, 0), (2, 0), (3, 1)]
    assert [(change.kind, change.rooms) for change in building.changes] == [("room-added", [3])]
    assert [room.visits for room in building.rooms][-1] == 1


def test_a_map_that_cannot_be_read_is_left_out_and_told(
    week: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(week / "monday", tmp_path / "good")
    shutil.copytree(week / "tuesday", tmp_path / "bad")
    shutil.copytree(week / "tuesday", tmp_path / ".new.partial-0123abcd" / "map")  # no map yet
    (tmp_path / "bad" / "labels.csv").write_text("nonsense\n", encoding="utf-8")
    assert main(["history", str(tmp_path), "--json", "-q"]) == 3
    printed = json.loads(capsys.readouterr().out)
    assert [Path(one["map"]).name for one in printed["left_out"]] == ["bad"]
    (building,) = printed["buildings"]
    assert [one["map"] for one in building["maps"]] == [str(tmp_path / "good")]


def test_without_a_map_or_its_visits_there_is_no_history(house: Path) -> None:
    (house / "labels.csv").unlink()
    with pytest.raises(MapError, match=r"has no labels\.csv: put that one back"):
        history_of([house])
    (house / "topology.json").unlink()
    with pytest.raises(MapError, match=re.escape(str(house))):
        history_of([house])
    with pytest.raises(MapError, match="no maps were named"):
        history_of([])


def test_the_command_writes_all_of_a_history(
    week: Path, building: BuildingRecord, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "week"
    assert main(["history", str(week), "-o", str(out), "--json", "-q"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert json.loads((out / "history.json").read_text(encoding="utf-8")) == printed
    names = ["changes.csv", "days.csv", "history.html", "history.json", "visits.csv"]
    assert sorted(path.name for path in out.iterdir()) == names
    visits = sum(room["visits"] for room in printed["buildings"][0]["rooms"])
    assert sum(int(row["visits"]) for row in rows(out / "visits.csv")) == visits
    assert [row["since"] for row in rows(out / "changes.csv")] == ["2025-11-25"] * 3
    page = (out / "history.html").read_text(encoding="utf-8")
    for room in building.rooms:
        assert f">{room.name}</th>" in page
    assert page.count('class="room"') == len(building.rooms)
    assert "door closed between" in page
    for day in building.days:
        assert f"<small>{day.day[:4]}</small> {day.day[5:]}</th>" in page
    assert "<script" not in page
    assert main(["history", str(week), "-o", str(out), "-q"]) == 2  # only with --overwrite


def test_the_page_links_to_the_maps_and_to_reports_of_a_batch(week: Path, tmp_path: Path) -> None:
    job = tmp_path / "maps" / "monday"
    shutil.copytree(week / "monday", job / "map")
    shutil.copytree(week / "wednesday", tmp_path / "maps" / "wednesday")
    for folder in (job, tmp_path / "maps"):
        (folder / "report.html").write_text("<p>", encoding="utf-8")
    (job / "job.json").write_text("{}", encoding="utf-8")
    assert main(["history", str(tmp_path / "maps"), "-o", str(tmp_path / "out"), "-q"]) == 0
    page = (tmp_path / "out" / "history.html").read_text(encoding="utf-8")
    links = re.findall(r'<a href="([^"#]+)"', page)
    found = [(tmp_path / "out" / link).resolve() for link in links]
    assert found == [job / "report.html", tmp_path / "maps" / "wednesday"]


def test_a_hostile_name_is_neither_markup_nor_formula(week: Path, tmp_path: Path) -> None:
    name = "=\"'><script>alert(1)</script>"
    shutil.copytree(week / "monday", tmp_path / "map")
    assert main(["edit", str(tmp_path / "map"), "--rename", "0", name, "-q"]) == 0
    assert main(["history", str(tmp_path / "map"), "-o", str(tmp_path / "out"), "-q"]) == 0
    page = (tmp_path / "out" / "history.html").read_text(encoding="utf-8")
    assert "<script" not in page
    assert "&lt;script&gt;" in page
    assert f"'{name}" in {row["name"] for row in rows(tmp_path / "out" / "visits.csv")}
    assert "<dt>map</dt><dd>1</dd>" in page
    assert "<dt>changes</dt><dd>0</dd>" in page
    assert "<title>1 building – specmap history</title>" in page


@pytest.fixture
def before(week: Path) -> Path:
    return week / "monday"


@pytest.fixture
def changed(week: Path) -> Path:
    return week / "wednesday"


@pytest.fixture(scope="module")
def told(week: Path) -> Comparison:
    return compare_maps(week / "monday", week / "wednesday")


def test_what_changed_is_told_with_its_place_and_names_in_the_old_map(told: Comparison) -> None:
    found, grid = told.differences, told.old.map_grid
    assert [round(way.width_m, 1) for way in found.closed] == [pytest.approx(0.9, abs=0.15)]
    assert len(found.opened) == 1
    (cabinet,) = found.appeared
    assert not found.vanished
    assert cabinet.length_m == pytest.approx(0.8, abs=0.2)
    assert 0.05 < cabinet.length_m * cabinet.width_m < 0.5
    assert cabinet.old_submap is not None
    assert len(told.record.submaps.same) >= 3
    for place in (cabinet.place, found.closed[0].place):
        assert (grid.values_at(place[None]) == FREE).all()
    names = {**told.record.old.names, found.closed[0].between[0]: "Kitchen"}
    old = told.record.old.model_copy(update={"names": names})
    lines = compare.lines_of(told.record.model_copy(update={"old": old}))
    assert any(line.startswith("way closed: ") and "(Kitchen)" in line for line in lines)
    assert not any("(submap" in line for line in lines)


def test_a_submap_lies_where_it_fits_by_itself_if_enough_of_its_walls_fix_it_there() -> None:
    """A wall alone does not say where a room lies along it."""
    rigid, alone = Pose2(3.0, -1.0, 0.7), Pose2(3.1, -1.0, 0.71)
    fit = PieceFit(
        submap=0,
        walls_m=60.0,
        known_m=50.0,
        confirmed_m=40.0,
        contradicted_m=0.0,
        old_from_new=alone,
        off_m=0.1,
        centre=np.zeros(2),
        spread_m=0.05,
        spread_rad=0.01,
        partner=0,
    )
    along_a_wall = replace(fit, spread_m=0.18)
    little = replace(fit, confirmed_m=4.0, known_m=4.0)
    moved = replace(fit, contradicted_m=10.0)
    found = bent_motion(rigid, [along_a_wall, little, moved, fit])
    (local,) = found.local
    assert (local.motion, local.off_m, local.off_rad) == (alone, 0.05, 0.01)
    assert found.rigid == rigid


def test_submaps_that_one_map_alone_divides_are_told_as_that() -> None:
    for old, new, told in (
        ([0], [1, 2], "submaps divided otherwise: 0 (Hall), now 1, 2"),
        ([0], [], "submaps divided otherwise, in the old map alone: 0 (Hall)"),
        ([], [1], "submaps divided otherwise, in the new map alone: 1"),
    ):
        found = comparison(
            names=("Hall", "submap 1", "submap 2"),
            submaps={"redrawn_old": old, "redrawn_new": new},
        )
        assert told in compare.lines_of(found)


def test_the_area_of_a_map_is_that_of_the_free_cells_of_its_submaps(told: Comparison) -> None:
    grid, owner = told.old.map_grid, told.old.regions.owner
    area_m2 = np.count_nonzero((owner != NOBODY) & grid.free) * grid.resolution**2
    assert area_m2 < grid.free_area_m2 - 0.1, "something was only looked into"
    assert told.record.old.area_m2 == pytest.approx(area_m2)
    assert figures_of(told.old)["area_m2"] == pytest.approx(area_m2)
    words = f"area: {area_m2:.0f} m2, then {told.record.new.area_m2:.0f} m2"
    assert compare.lines_of(told.record)[-1].endswith(words)


def test_two_recordings_of_one_building_are_alike(before: Path, second_tour: Mapped) -> None:
    """Of two lasers: one sees three quarters of the circle, the other all of it."""
    found = compare_maps(before, second_tour.map)
    assert "the building: no change found" in compare.lines_of(found.record)


def test_a_map_is_identical_to_itself_and_not_replaced_by_its_comparison(before: Path) -> None:
    found = compare_maps(before, before)
    assert found.identical
    assert compare.lines_of(found.record) == [f"{before}: identical to {before}"]
    assert main(["compare", str(before), str(before), "-o", str(before), "-q"]) == 2


def test_a_map_of_another_building_is_refused_with_the_reason(
    before: Path, house: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (house / "classifiers.json").unlink()
    with pytest.raises(NoResultError, match="not aligned with"):
        compare_maps(before, house)
    assert main(["compare", str(before), str(house), "-q"]) == 4
    assert f"{house}: not aligned with {before}: " in capsys.readouterr().err


def test_the_command_writes_all_of_a_comparison_the_same_bytes_every_time(
    told: Comparison, week: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """And replaces nothing but an earlier result."""
    before, changed, out = week / "monday", week / "wednesday", tmp_path / "changes"
    assert main(["compare", str(before), str(changed), "-o", str(out), "--json", "-q"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert json.loads((out / COMPARISON).read_text(encoding="utf-8")) == printed
    assert "way closed: " in (out / SUMMARY).read_text(encoding="utf-8")
    assert (out / PICTURE).read_bytes().startswith(b"\x89PNG")
    written = files_in(out)
    assert written.keys() == {COMPARISON, PICTURE, SUMMARY}

    def write(out: Path, *, overwrite: bool) -> None:
        with result_directory(out, compare.FILES, overwrite) as directory:
            compare.write_comparison(told, directory)

    with pytest.raises(UsageError, match="already holds a result"):
        write(out, overwrite=False)
    write(out, overwrite=True)
    assert files_in(out) == written
    with pytest.raises(UsageError, match=f"no {COMPARISON} in it"):
        write(before, overwrite=True)


def test_without_classifiers_grids_decide(before: Path, changed: Path, tmp_path: Path) -> None:
    bare = Path(shutil.copytree(changed, tmp_path / "bare"))
    (bare / "classifiers.json").unlink()
    assert np.isfinite(compare_maps(before, bare).alignment.rival)


NS = 1_000_000_000
MIDNIGHT = int(datetime(2026, 3, 2, tzinfo=UTC).timestamp()) * NS


def test_a_visit_lasts_until_the_next_begins() -> None:
    rooms = np.array([0, 0, 1, 1, 0])
    tour = record.tour_of(MIDNIGHT + np.array([20, 30, 40, 50, 70]) * NS, rooms, np.arange(5.0))
    lasted = [(one.room, (one.end_ns - one.start_ns) / NS) for one in tour.visits]
    assert lasted == [(0, 20), (1, 30), (0, 0)]
    assert tour.driven_m.tolist() == [0, 1, 2, 3, 4]


@pytest.mark.parametrize(
    ("labels", "settled"),
    [
        *(("", ""), ("a", "a"), ("ab", "ab")),
        ("abc", "abc"),  # a way through, no excursion
        ("abacaca", "aaaaaaa"),
        ("abab", "aaab"),  # the last stay is followed by none
        ("abbbbbba", "abbbbbba"),  # 1 m long
        ("abbbbba", "aaaaaaa"),  # 0.8 m
    ],
)
def test_what_is_an_excursion(labels: str, settled: str) -> None:
    numbers = np.array([ord(letter) for letter in labels], dtype=np.int64)
    poses = np.column_stack([0.2 * np.arange(len(labels)), *np.zeros((2, len(labels)))])
    found = record.settle_labels(numbers, poses, np.arange(len(labels)), 0.9)
    assert "".join(map(chr, numbers)) == labels, "the argument is left alone"
    assert "".join(map(chr, found)) == settled


def test_a_visit_of_which_two_keyframes_at_the_door_are_left_is_none_past_it() -> None:
    x = np.array([0.0, 0.5, 1.0, 1.5, 1.0, 0.5, 0.0])
    poses = np.column_stack([x, *np.zeros((2, 7))])
    labels, rows = np.array([0, 1, 1, 0]), np.array([0, 1, 5, 6])
    assert record.settle_labels(labels, poses, rows, 0.9).tolist() == [0, 1, 1, 0]
    assert record.settle_labels(labels, 0.4 * poses, rows, 0.9).tolist() == [0, 0, 0, 0]


def test_a_day_ends_at_midnight_of_the_zone() -> None:
    assert record.day_of(MIDNIGHT, record.zone_of("UTC")) == "2026-03-02"
    assert record.day_of(MIDNIGHT - 1, record.zone_of("UTC")) == "2026-03-01"
    assert record.day_of(MIDNIGHT - 1, record.zone_of("Europe/Berlin")) == "2026-03-02"
    assert record.day_of(-5 * NS, record.zone_of("UTC")) == "1969-12-31"


@pytest.mark.parametrize("name", ["Mars/Base", "", "../../etc/passwd", "/etc/localtime"])
def test_an_unknown_zone_is_refused(name: str) -> None:
    with pytest.raises(UsageError, match="time zone"):
        record.zone_of(name)


def test_what_goes_on_past_midnight_counts_on_the_day_it_began() -> None:
    stamps_ns = MIDNIGHT + np.array([-60, -30, 30, 60]) * NS
    late = record.tour_of(stamps_ns, np.array([3, 3, 4, 4]), np.array([0.0, 5.0, 9.0, 12.0]))
    first, second = record.days_of([late], record.zone_of("UTC"))
    assert (first.day, first.recordings, first.driven_m) == ("2026-03-01", 1, 9.0)
    assert first.minutes == 1.5
    assert first.rooms == [record.StayRecord(room=3, visits=1, minutes=1.5)]
    assert (second.recordings, second.driven_m, second.minutes) == (0, 3.0, 0.5)
    assert second.rooms == [record.StayRecord(room=4, visits=1, minutes=0.5)]
    (only,) = record.days_of([late], record.zone_of("Europe/Berlin"))
    assert (only.recordings, only.driven_m, only.minutes) == (1, 12.0, 2.0)
    assert record.totals(
        [record.Visit(1, 0, 60 * NS), record.Visit(2, 0, NS), record.Visit(1, 0, 30 * NS)]
    )[1] == (2, 1.5)
