"""Localising a log in a map of the flat: the whole way, and what the report says of it."""

import csv
import json
import math
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from specmap_cli import localize_log
from specmap_cli.core.errors import MapError, UsageError
from specmap_cli.core.geometry import Pose2
from specmap_cli.core.progress import Silent
from specmap_cli.drawing.palette import colours_of, vivid
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.logs import open_log
from specmap_cli.logs.stream import SweepStream
from specmap_cli.maps.filenames import CLASSIFIERS
from specmap_cli.maps.store import Map, read_map
from specmap_cli.pipelines import localize, localizer
from specmap_cli.pipelines.localize import HEADER, METRIC_HEADER, LocalizationReport
from specmap_cli.pipelines.localizer import LocalizedScan
from specmap_cli.pipelines.simulate import simulate
from specmap_cli.recognition.localization.localizer import Fix, Label
from specmap_cli.simulation.simulator import SimulationOptions
from tests.drawing.looking import colours_in
from tests.flats import forget_digests


@pytest.fixture(scope="module")
def own_log(
    flat: GridMap, flat_options: SimulationOptions, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """The first minute of the map's own log."""
    options = flat_options.model_copy(update={"max_duration_s": 60.0})
    return simulate(flat, options, tmp_path_factory.mktemp("own") / "flat.mcap").log


@pytest.fixture(scope="module")
def metric(own_log: Path, flat_map: Map) -> LocalizationReport:
    return localize_log(own_log, flat_map.path, metric=True)


def labelled(submaps: Sequence[int | None], poses: Sequence[Pose2 | None]) -> LocalizationReport:
    """A report of made-up labels along a straight way of 0.1 m a scan."""
    sure = {"margin": 1.0, "filtered_probability": 0.9, "probability": 0.8}
    scans = []
    for k, (id_, pose) in enumerate(zip(submaps, poses, strict=True)):
        label = Label(stamp_ns=k * 10**8, submap=id_, runner_up=None, filtered_submap=id_, **sure)
        fix = None if pose is None else Fix(pose, 1e-4 * np.eye(3), 0.9, 0.99)
        scans.append(LocalizedScan(label=label, track_from_base=Pose2(0.1 * k, 0.0, 0.0), fix=fix))
    return LocalizationReport(log="made.mcap", scans=tuple(scans), warnings=("a warning",))


def test_its_own_log_is_found_in_place(flat_map: Map, metric: LocalizationReport) -> None:
    """Labels of keyframes are the map's, and poses within submaps meet those of the map."""
    rows = {stamp: k for k, stamp in enumerate(flat_map.labels.stamps_ns.tolist())}
    right, off = [], []
    for scan in metric.scans:
        k = rows.get(scan.label.stamp_ns)
        if k is None or scan.label.filtered_submap is None or scan.submap_from_base is None:
            continue
        right.append(scan.label.filtered_submap == int(flat_map.labels.submaps[k]))
        frame = flat_map.topology.submaps[scan.label.filtered_submap].map_from_submap
        place = frame @ scan.submap_from_base
        off.append(math.dist(place[:2], flat_map.labels.poses[k, :2].tolist()))
    assert np.mean([scan.label.filtered_submap is not None for scan in metric.scans]) > 0.99
    assert len(right) > 150
    assert np.mean(right) > 0.9
    assert np.median(off) < 0.05


def test_offline_poses_are_in_the_frames_of_the_submaps_that_smoothing_gives(
    own_log: Path, flat_map: Map, metric: LocalizationReport
) -> None:
    offline = localize_log(own_log, flat_map, offline=True, metric=True)
    pairs = list(zip(offline.scans, metric.scans, strict=True))
    for a, b in pairs:  # a single scan votes as it did
        assert (a.label.submap, a.label.margin) == (b.label.submap, b.label.margin)
    changed = [a.label.filtered_submap != b.label.filtered_submap for a, b in pairs]
    assert sum(changed) < len(changed) / 2
    # the map was built of this log: its first keyframe is the first scan, turned along the walls
    map_from_track = Pose2(*flat_map.labels.poses[0]) @ offline.scans[0].track_from_base.inverse()
    given = 0
    for a in offline.scans:
        if a.submap_from_base is None:
            continue
        given += 1
        frame = flat_map.topology.submaps[a.label.filtered_submap].map_from_submap  # type: ignore[index]
        place = frame @ a.submap_from_base
        assert math.dist(place[:2], (map_from_track @ a.track_from_base)[:2]) < 0.6
    assert given >= sum(scan.submap_from_base is not None for scan in metric.scans)


def test_scans_that_a_hanging_driver_repeats_have_no_pose(own_log: Path, flat_map: Map) -> None:
    guide = localizer.Localizer(flat_map)
    with open_log([own_log], guide.config.log) as log:
        sweeps = list(SweepStream(log, guide.config.log))
    held = sweeps[59].planar.ranges
    for k in range(60, 100):
        sweeps[k] = replace(sweeps[k], planar=replace(sweeps[k].planar, ranges=held))
    fixes = [scan.fix is not None for scan in guide.told(list(guide.located(sweeps)))]
    assert all(fixes[40:60])
    assert not any(fixes[65:100])
    assert np.mean(fixes[120:]) > 0.95
    repeated = int(guide.warnings[0].partition(" ")[0])
    assert 35 <= repeated <= 40
    assert "the driver of the laser hung" in guide.warnings[0]


def test_classifiers_of_other_submaps_are_refused(own_log: Path, flat_map: Map) -> None:
    record = flat_map.record
    fewer = record.model_copy(update={"nodes": record.nodes[:-1]})
    with pytest.raises(MapError, match=r"classifiers\.json: classifiers of the submaps"):
        localize_log(own_log, Map(flat_map.path, fewer))


def test_damaged_classifiers_keep_what_to_do_about_them(flat_map: Map, tmp_path: Path) -> None:
    own = Path(shutil.copytree(flat_map.path, tmp_path / "own"))
    forget_digests(own)
    (own / CLASSIFIERS).write_text("{}")
    with pytest.raises(MapError, match=r"classifiers\.json: .*; build the map again") as caught:
        localizer.classifiers_of(read_map(own))
    assert caught.value.where == str(own / CLASSIFIERS)
    assert caught.value.hint == "build the map again"


def test_an_older_map_is_used_offline_without_poses_and_what_it_lacks_is_told(
    own_log: Path,
    flat_map: Map,
    metric: LocalizationReport,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It keeps neither its scans, nor how well they fit, nor how sure its classifiers are."""
    older = Path(shutil.copytree(flat_map.path, tmp_path / "older"))
    data = json.loads((older / CLASSIFIERS).read_text())
    assert all(data.pop(part)["views"] > 20 for part in ("misfit", "calibration"))
    (older / CLASSIFIERS).write_text(json.dumps(data))
    (older / "keyframes.mcap").unlink()
    progress, notes = Silent(), list[str]()
    monkeypatch.setattr(progress, "note", notes.append)
    forget_digests(older)
    old = replace(read_map(older), note="it lacks keyframes")
    report = localize_log(own_log, old, offline=True, progress=progress)
    assert notes[0] == "it lacks keyframes"
    assert [note for note in notes if "fit its walls" in note] == [
        f"{older}: an older map, which does not say how well its own scans fit its walls; known "
        "places are told from unknown by what is usual elsewhere: build it again"
    ]
    assert [warning for warning in report.as_dict()["warnings"] if "how sure" in warning] == [
        f"{older}: an older map, which does not say how sure its classifiers are: probabilities "
        "are those that are usual elsewhere; build it again"
    ]
    assert list(report.warnings) == progress.warnings
    assert not [warning for warning in metric.warnings if "how sure" in warning]
    assert np.mean([scan.label.filtered_submap is not None for scan in report.scans]) > 0.97
    assert all(scan.submap_from_base is None for scan in report.scans), "nobody asked for poses"


class TestReport:
    def test_it_counts_labels_and_how_often_raw_and_filtered_agree(self) -> None:
        report = labelled([0, 0, 2, None], [None] * 4)
        other = replace(report.scans[0].label, filtered_submap=2)
        scans = (replace(report.scans[0], label=other), *report.scans[1:])
        assert replace(report, scans=scans).as_dict() == {
            "log": "made.mcap",
            "scans": 4,
            "raw": {"0": 2, "2": 1, "unknown": 1},
            "filtered": {"0": 1, "2": 2, "unknown": 1},
            "agreement": 0.75,
            "known": 0.75,
            "names": {},
            "warnings": ["a warning"],
        }

    def test_its_lines_are_a_table_with_names_that_a_person_gave_and_unknown_last(self) -> None:
        report = replace(labelled([3, None, 4], [None] * 3), names={3: 'Ann\'s "lab", west'})
        first, head, *lines = report.lines()
        assert first == "made.mcap: 3 scans, raw and filtered label agree on 100.0%"
        assert head.split()[:3] == ["submap", "raw", "filtered"]
        assert [line.split(maxsplit=3) for line in lines] == [
            ["3", "1", "1", 'Ann\'s "lab", west'],
            ["4", "1", "1"],
            ["unknown", "1", "1"],
        ]
        rows = list(csv.DictReader(localize.table_of(report, True).splitlines()))
        assert [row["name"] for row in rows] == ['Ann\'s "lab", west', "", "submap 4"]
        assert report.as_dict()["names"] == {"3": 'Ann\'s "lab", west'}

    @pytest.mark.parametrize("with_poses", [False, True])
    def test_its_csv_has_a_line_a_scan(self, with_poses: bool) -> None:
        text = localize.table_of(labelled([4, None], [Pose2(1.0, 2.0, 0.5), None]), with_poses)
        assert text.splitlines()[0] == HEADER + (METRIC_HEADER if with_poses else "")
        first, second = csv.DictReader(text.splitlines())
        assert (first["stamp"], first["submap"]) == ("0.000000000", "4")
        assert (second["submap"], second["filtered_submap"]) == ("", "")
        assert second["stamp"] == "0.100000000"
        if with_poses:
            assert (first["x"], first["y"], first["theta"]) == ("1.000000", "2.000000", "0.500000")
            assert (first["map_x"], first["map_theta"]) == ("1.000000", "0.500000")
            assert (second["x"], second["score"], second["map_x"]) == ("", "", "")
        assert None not in first
        assert None not in second

    def test_where_nothing_is_known_it_says_so_and_its_picture_shows_the_way_as_it_was_tracked(
        self, flat_map: Map, tmp_path: Path
    ) -> None:
        report = labelled([None] * 40, [None] * 40)
        told = "made.mcap: 40 scans, none of them known: the map does not show this place"
        assert report.lines()[0] == told
        assert (report.known, report.as_dict()["known"]) == (0.0, 0.0)
        without_poses = labelled([0] * 20 + [1] * 20, [None] * 40)
        for each, metric in ((report, True), (without_poses, False)):
            localize.write_report(each, flat_map, metric=metric, plot=tmp_path / "track.png")
            picture = cv2.imread(str(tmp_path / "track.png"))
            assert picture is not None
            assert colours_in(picture) > 3
            (tmp_path / "track.png").unlink()
        known = [Pose2(0.0, 0.1 * k, 1.0) for k in range(20)]
        places = localize._tracked(labelled([0] * 20 + [None] * 20, [*known, *[None] * 20]).scans)
        assert np.isfinite(places).all()
        motion = Pose2(1.9, 0.0, 0.0).inverse() @ Pose2(3.9, 0.0, 0.0)
        assert places[-1] == pytest.approx((Pose2(0.0, 1.9, 1.0) @ motion)[:2])

    @pytest.mark.parametrize("with_poses", [False, True])
    def test_its_picture_has_the_colours_of_the_map(self, flat_map: Map, with_poses: bool) -> None:
        fills = colours_of(flat_map.topology, flat_map.regions)
        at = [Pose2(0.05 * k, 0.0, 0.0) for k in range(40)]
        for id_ in sorted(fills)[-2:]:
            image = localize.picture_of(labelled([id_] * 40, at), flat_map, with_poses)
            seen = {fill: (image == vivid(fill)).all(axis=-1).sum() for fill in fills.values()}
            assert max(seen, key=seen.__getitem__) == fills[id_]

    def test_table_and_picture_come_together(self, flat_map: Map, tmp_path: Path) -> None:
        """When the second one cannot be written there is no first one, and nothing half-written."""
        report = labelled([0] * 20, [None] * 20)
        (tmp_path / "pictures").mkdir()
        csv = tmp_path / "labels.csv"
        for plot in (tmp_path / "gone" / "plot.png", tmp_path / "pictures"):
            with pytest.raises(UsageError, match="choose another place"):
                localize.write_report(report, flat_map, metric=False, csv=csv, plot=plot)
            assert [path.name for path in tmp_path.iterdir()] == ["pictures"]
