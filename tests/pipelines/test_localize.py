"""Localising a log in a map of the flat: the whole way, and what the report says of it."""

from __future__ import annotations

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

from specmap_cli import build_map, load_config, localize_log, read_map
from specmap_cli.core.errors import LogError, MapError, UsageError
from specmap_cli.core.geometry import Pose2
from specmap_cli.core.progress import Silent
from specmap_cli.core.settings import LogConfig
from specmap_cli.drawing.palette import colours_of, vivid
from specmap_cli.maps.filenames import CLASSIFIERS
from specmap_cli.maps.store import StoredMap
from specmap_cli.pipelines.localization_report import (
    HEADER,
    METRIC_HEADER,
    LocalizationReport,
    LocalizedScan,
    csv_text,
    picture_of,
    write_report,
)
from specmap_cli.pipelines.localize import settings_for
from specmap_cli.pipelines.simulate import SimulationResult
from specmap_cli.recognition.localization.localizer import Label
from specmap_cli.recognition.localization.metric import Fix


@pytest.fixture(scope="module")
def stored(flat_log: SimulationResult, tmp_path_factory: pytest.TempPathFactory) -> StoredMap:
    """The map of the flat."""
    out = tmp_path_factory.mktemp("map") / "map"
    config = load_config(overrides={"recognition": {"rounds": 40}})
    build_map(flat_log.log, out, config)
    return read_map(out)


@pytest.fixture(scope="module")
def metric(flat_log: SimulationResult, stored: StoredMap) -> LocalizationReport:
    """The map's own log localised in it, with poses."""
    return localize_log(flat_log.log, stored, metric=True)


def labelled(submaps: Sequence[int | None], poses: Sequence[Pose2 | None]) -> LocalizationReport:
    """A report of made-up labels along a straight way of 0.1 m a scan."""
    scans = tuple(
        LocalizedScan(
            label=Label(
                stamp_ns=k * 10**8,
                submap=submap,
                margin=1.0,
                runner_up=None,
                filtered_submap=submap,
                filtered_probability=0.9,
                probability=0.8,
            ),
            track_from_base=Pose2(0.1 * k, 0.0, 0.0),
            fix=None if pose is None else Fix(submap or 0, pose, 1e-4 * np.eye(3), 0.9),
        )
        for k, (submap, pose) in enumerate(zip(submaps, poses, strict=True))
    )
    return LocalizationReport(log="made.mcap", scans=scans, warnings=("a warning",))


def test_the_map_s_own_log_is_found_where_it_was_taken(
    stored: StoredMap, metric: LocalizationReport
) -> None:
    """Labels of keyframes are the map's, and poses within submaps meet those of the map."""
    rows = {stamp: k for k, stamp in enumerate(stored.labels.stamps_ns.tolist())}
    right, off = [], []
    for scan in metric.scans:
        k = rows.get(scan.label.stamp_ns)
        if k is None or scan.label.filtered_submap is None or scan.submap_from_base is None:
            continue
        right.append(scan.label.filtered_submap == int(stored.labels.submaps[k]))
        frame = stored.topology.submaps[scan.label.filtered_submap].map_from_submap
        place = frame @ scan.submap_from_base
        off.append(math.dist(place[:2], stored.labels.poses[k, :2].tolist()))
    assert len(right) > 200
    assert np.mean(right) > 0.9
    assert np.median(off) < 0.05


def test_offline_smoothing_keeps_the_raw_votes(
    flat_log: SimulationResult, stored: StoredMap, metric: LocalizationReport
) -> None:
    smoothed = localize_log(flat_log.log, stored.path, offline=True)
    assert len(smoothed.scans) == len(metric.scans)
    for a, b in zip(smoothed.scans, metric.scans, strict=True):
        assert (a.label.submap, a.label.margin) == (b.label.submap, b.label.margin)
        assert a.submap_from_base is None
    changed = [
        a.label.filtered_submap != b.label.filtered_submap
        for a, b in zip(smoothed.scans, metric.scans, strict=True)
    ]
    assert sum(changed) < len(changed) / 2


def test_offline_poses_are_in_the_frames_of_the_smoothed_submaps(
    flat_log: SimulationResult, stored: StoredMap, metric: LocalizationReport
) -> None:
    """A scan is matched in the submap that smoothing gives it, also before a place led."""
    both = localize_log(flat_log.log, stored, offline=True, metric=True)
    # the map was built of this log: its first keyframe is the first scan, turned along the walls
    map_from_track = Pose2(*stored.labels.poses[0]) @ both.scans[0].track_from_base.inverse()
    given = 0
    for a in both.scans:
        if a.submap_from_base is None:
            continue
        given += 1
        frame = stored.topology.submaps[a.label.filtered_submap].map_from_submap  # type: ignore[index]
        place = frame @ a.submap_from_base
        assert math.dist(place[:2], (map_from_track @ a.track_from_base)[:2]) < 0.6
    assert given >= sum(scan.submap_from_base is not None for scan in metric.scans)


def test_the_settings_are_the_map_s_but_topics_are_the_log_s(stored: StoredMap) -> None:
    config = settings_for(stored, {"localization": {"stay": 0.9}})
    assert config.recognition.rounds == 40
    assert config.localization.stay == 0.9
    assert config.log == LogConfig()


def test_poses_without_walls_are_refused(flat_log: SimulationResult, stored: StoredMap) -> None:
    """Poses are found by the walls: none would be given, without a word why."""
    config = settings_for(stored, {"localization": {"fit_submaps": 0}})
    with pytest.raises(UsageError, match=r"localization\.fit_submaps: 0 .*--metric"):
        localize_log(flat_log.log, stored, config, metric=True)


def test_a_log_without_a_usable_scan_is_refused(stored: StoredMap, tmp_path: Path) -> None:
    with pytest.raises(LogError, match="no such file"):
        localize_log(tmp_path / "gone.mcap", stored)


def test_classifiers_of_other_submaps_are_refused(
    flat_log: SimulationResult, stored: StoredMap
) -> None:
    record = stored.record
    fewer = record.model_copy(update={"nodes": record.nodes[:-1]})
    with pytest.raises(MapError, match=r"classifiers\.json: classifiers of the submaps"):
        localize_log(flat_log.log, StoredMap(stored.path, fewer))


def without(stored: StoredMap, part: str, folder: Path) -> Path:
    """A copy of a map as a version made it that did not keep this part of the classifiers yet."""
    older = folder / "older"
    shutil.copytree(stored.path, older)
    data = json.loads((older / CLASSIFIERS).read_text())
    assert data.pop(part)["views"] > 20
    (older / CLASSIFIERS).write_text(json.dumps(data))
    return older


def test_a_map_without_the_misfit_of_its_own_scans_is_used_and_noted(
    flat_log: SimulationResult, stored: StoredMap, tmp_path: Path
) -> None:
    """Maps made before it was kept: what is missing is said in one line."""
    older = without(stored, "misfit", tmp_path)
    progress = Notes()
    old = StoredMap(older, stored.record, note="it lacks keyframes")
    report = localize_log(flat_log.log, old, progress=progress)
    assert progress.notes[0] == "it lacks keyframes"
    assert [note for note in progress.notes if "fit its walls" in note] == [
        f"{older}: an older map, which does not say how well its own scans fit its walls; known "
        "places are told from unknown by what is usual elsewhere: build it again"
    ]
    assert np.mean([scan.label.filtered_submap is not None for scan in report.scans]) > 0.97


def test_a_map_that_does_not_say_how_sure_its_classifiers_are_is_used_and_told_of(
    flat_log: SimulationResult, stored: StoredMap, metric: LocalizationReport, tmp_path: Path
) -> None:
    older = without(stored, "calibration", tmp_path)
    report = localize_log(flat_log.log, StoredMap(older, stored.record))
    told = [warning for warning in report.as_dict()["warnings"] if "how sure" in warning]
    assert told == [
        f"{older}: an older map, which does not say how sure its classifiers are: probabilities "
        "are those that are usual elsewhere; build it again"
    ]
    assert not [warning for warning in metric.warnings if "how sure" in warning]
    assert np.mean([scan.label.filtered_submap is not None for scan in report.scans]) > 0.97


class Notes(Silent):
    """Keeps what is noted."""

    def __init__(self) -> None:
        super().__init__()
        self.notes: list[str] = []

    def note(self, message: str) -> None:
        self.notes.append(message)


def test_the_map_s_own_log_is_not_unknown_in_it(metric: LocalizationReport) -> None:
    assert np.mean([scan.label.filtered_submap is not None for scan in metric.scans]) > 0.99


def test_what_is_wrong_with_the_input_is_warned_of(
    flat_log: SimulationResult, stored: StoredMap
) -> None:
    progress = Silent()
    report = localize_log(flat_log.log, stored, progress=progress)
    assert list(report.warnings) == progress.warnings


class TestReport:
    def test_it_counts_labels_and_how_often_raw_and_filtered_agree(self) -> None:
        report = labelled([0, 0, 2, None], [None] * 4)
        other = replace(report.scans[0].label, filtered_submap=2)
        scans = (replace(report.scans[0], label=other), *report.scans[1:])
        found = replace(report, scans=scans).as_dict()
        assert found == {
            "log": "made.mcap",
            "scans": 4,
            "raw": {"0": 2, "2": 1, "unknown": 1},
            "filtered": {"0": 1, "2": 2, "unknown": 1},
            "agreement": 0.75,
            "names": {},
            "warnings": ["a warning"],
        }

    def test_its_lines_are_a_table_with_unknown_last(self) -> None:
        lines = labelled([3, None, 3], [None] * 3).lines()
        assert lines[0] == "made.mcap: 3 scans, raw and filtered label agree on 100.0%"
        assert [line.split() for line in lines[1:]] == [
            ["submap", "raw", "filtered"],
            ["3", "2", "2"],
            ["unknown", "1", "1"],
        ]

    def test_it_calls_submaps_by_the_names_that_a_person_gave(self) -> None:
        report = replace(labelled([3, None, 4], [None] * 3), names={3: 'Ann\'s "lab", west'})
        assert [line.split(maxsplit=3) for line in report.lines()[2:]] == [
            ["3", "1", "1", 'Ann\'s "lab", west'],
            ["4", "1", "1"],
            ["unknown", "1", "1"],
        ]
        rows = list(csv.DictReader(csv_text(report, True).splitlines()))
        assert [row["name"] for row in rows] == ['Ann\'s "lab", west', "", "submap 4"]
        assert report.as_dict()["names"] == {"3": 'Ann\'s "lab", west'}

    @pytest.mark.parametrize("with_poses", [False, True])
    def test_its_csv_has_a_line_a_scan(self, with_poses: bool) -> None:
        report = labelled([4, None], [Pose2(1.0, 2.0, 0.5), None])
        text = csv_text(report, with_poses)
        assert text.splitlines()[0] == HEADER + (METRIC_HEADER if with_poses else "")
        first, second = csv.DictReader(text.splitlines())
        assert (first["stamp"], first["submap"]) == ("0.000000000", "4")
        assert (second["submap"], second["filtered_submap"]) == ("", "")
        assert second["stamp"] == "0.100000000"
        if with_poses:
            assert (first["x"], first["y"], first["theta"]) == ("1.000000", "2.000000", "0.500000")
            assert (second["x"], second["score"]) == ("", "")
        assert None not in first
        assert None not in second

    def test_its_picture_leaves_out_places_that_leap_away_and_back(self, stored: StoredMap) -> None:
        """A few scans matched at the wrong end of a submap draw no line across the map."""
        here, far = Pose2(0.0, 0.0, 0.0), Pose2(60.0, 60.0, 0.0)
        poses = [here @ Pose2(0.1 * k, 0.0, 0.0) for k in range(40)]
        leaping = [*poses[:20], far, far, *poses[22:]]
        straight, other = (
            picture_of(labelled([0] * 40, track), stored, True) for track in (poses, leaping)
        )
        assert straight.shape == other.shape

    def test_its_picture_without_a_map_shows_the_track(
        self, stored: StoredMap, tmp_path: Path
    ) -> None:
        report = labelled([0] * 20 + [1] * 20, [None] * 40)
        write_report(report, stored, metric=False, plot=tmp_path / "track.png")
        picture = cv2.imread(str(tmp_path / "track.png"))
        assert picture is not None
        assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 3

    @pytest.mark.parametrize("with_poses", [False, True])
    def test_its_picture_has_the_colours_of_the_map(
        self, stored: StoredMap, with_poses: bool
    ) -> None:
        fills = colours_of(stored.topology, stored.regions)
        at = [Pose2(0.05 * k, 0.0, 0.0) for k in range(40)]
        for id_ in sorted(fills)[-2:]:
            image = picture_of(labelled([id_] * 40, at), stored, with_poses)
            seen = {fill: (image == vivid(fill)).all(axis=-1).sum() for fill in fills.values()}
            assert max(seen, key=seen.__getitem__) == fills[id_]

    def test_the_table_and_the_picture_are_written_together(
        self, stored: StoredMap, tmp_path: Path
    ) -> None:
        """When the second one cannot be written there is no first one, and nothing half-written."""
        report = labelled([0] * 20, [None] * 20)
        (tmp_path / "pictures").mkdir()
        for plot in (tmp_path / "gone" / "plot.png", tmp_path / "pictures"):
            with pytest.raises(UsageError, match="choose another place"):
                write_report(report, stored, metric=False, csv=tmp_path / "labels.csv", plot=plot)
            assert [path.name for path in tmp_path.iterdir()] == ["pictures"]
