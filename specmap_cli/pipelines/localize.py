"""Another log against a finished map: in which submap was each scan taken? (Section IV-B)"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from specmap_cli.core.config import Config, LogConfig, with_overrides
from specmap_cli.core.errors import LogError, MapError
from specmap_cli.core.files import write_text
from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.progress import Progress, Silent
from specmap_cli.core.records import NO_SUBMAP
from specmap_cli.core.text import counted, legible, stamp_text
from specmap_cli.drawing.predictions import render_labels
from specmap_cli.grids.map_server import write_png
from specmap_cli.logs import open_log
from specmap_cli.logs.stream import SweepStream
from specmap_cli.maps.store import CLASSIFIERS, StoredMap
from specmap_cli.recognition.learning.classifiers import ClassifierSet
from specmap_cli.recognition.localization.localizer import Label, Localizer
from specmap_cli.registration import FrontEnd

HEADER = "stamp,submap,margin,runner_up,filtered_submap,filtered_probability"
METRIC_HEADER = ",x,y,theta,score"
_LEAP_M, _STEADY_SCANS = 0.5, 10  # a place that leaps and leaves within so many scans is wrong


@dataclass(frozen=True, slots=True)
class LocalizedScan:
    """The label of one scan, its place as registered, and within the map where it was matched."""

    label: Label
    track_from_base: Pose2
    submap_from_base: Pose2 | None = None
    score: float = math.nan


@dataclass(frozen=True, slots=True)
class LocalizationReport:
    """What `localize` found."""

    log: str
    scans: list[LocalizedScan]
    warnings: list[str]

    def as_dict(self) -> dict[str, Any]:
        """Counts of scans by label, raw and filtered; null is unknown."""
        raw, filtered = self._counts()
        return {
            "log": self.log,
            "scans": len(self.scans),
            "raw": {_name(key): raw[key] for key in sorted(raw, key=_order)},
            "filtered": {_name(key): filtered[key] for key in sorted(filtered, key=_order)},
            "agreement": self._agreement(),
            "warnings": self.warnings,
        }

    def lines(self) -> list[str]:
        """A table of the submaps that were seen."""
        raw, filtered = self._counts()
        agreement = self._agreement()
        lines = [
            f"{self.log}: {counted(len(self.scans), 'scan')}, raw and filtered label agree on "
            f"{agreement:.1%}",
            f"{'submap':>8} {'raw':>8} {'filtered':>9}",
        ]
        for key in sorted({*raw, *filtered}, key=_order):
            lines.append(f"{_name(key):>8} {raw[key]:8,} {filtered[key]:9,}")
        return lines

    def _counts(self) -> tuple[Counter[int | None], Counter[int | None]]:
        raw = Counter(scan.label.submap for scan in self.scans)
        return raw, Counter(scan.label.filtered_submap for scan in self.scans)

    def _agreement(self) -> float:
        same = sum(scan.label.submap == scan.label.filtered_submap for scan in self.scans)
        return round(same / len(self.scans), 6)


def localize_log(
    logs: Sequence[Path],
    stored: StoredMap,
    config: Config,
    *,
    offline: bool = False,
    metric: bool = False,
    progress: Progress | None = None,
) -> LocalizationReport:
    """Label every scan of a recording with a submap of a stored map.

    `offline` smooths over the whole log instead of filtering; `metric` matches each scan within
    the grid of its filtered submap. Raises LogError for a recording without a usable scan,
    InputError when its laser cannot stand in for the map's, MapError for a damaged map.
    """
    progress = progress or Silent()
    localizer = localizer_of(stored, config)
    front_end = FrontEnd(config.registration)
    scans: list[LocalizedScan] = []
    with open_log(logs) as log:
        stream = SweepStream(log, config.log)
        progress.note(stream.selection.note)
        progress.start("localising", stream.expected)
        for sweep in stream:
            posed = front_end.register(sweep)
            label = localizer.update(posed)
            where, score = None, math.nan
            if metric and label.filtered_submap is not None:
                match = localizer.tracker.locate(posed, label.filtered_submap)
                where, score = match.pose, match.score
            scans.append(LocalizedScan(label, posed.map_from_base, where, score))
            progress.advance()
        if not scans:
            raise LogError(f"{log.name}: no usable scan in it; see `specmap info`")
        if offline:
            scans = [
                LocalizedScan(label, scan.track_from_base, scan.submap_from_base, scan.score)
                for label, scan in zip(localizer.smoothed(), scans, strict=True)
            ]
        notes = [localizer.note] if localizer.note else []
        warnings = [*stream.warnings, *notes]
        for warning in warnings:
            progress.warn(warning)
        return LocalizationReport(legible(Path(log.name).name), scans, warnings)


def settings_for(stored: StoredMap, overrides: dict[str, Any]) -> Config:
    """The settings a map was built with, under `overrides`; topics and frames are the log's own."""
    built_with = stored.config.model_copy(update={"log": LogConfig()})
    return with_overrides(built_with, overrides)


def localizer_of(stored: StoredMap, config: Config) -> Localizer:
    """The localizer of a stored map: its classifiers, the neighbours of its submaps, its grids."""
    classifiers = _classifiers_of(stored)
    adjacency: dict[int, set[int]] = {id_: set() for id_ in stored.ids}
    for edge in stored.record.edges:
        adjacency[edge.source].add(edge.target)
        adjacency[edge.target].add(edge.source)
    return Localizer(classifiers, adjacency, stored.grids, config.localization)


def _classifiers_of(stored: StoredMap) -> ClassifierSet:
    """The classifiers of a stored map, one a submap; MapError naming the file otherwise."""
    path = stored.path / CLASSIFIERS
    try:
        classifiers = ClassifierSet.from_json(stored.classifiers)
    except MapError as error:
        if str(path) in str(error):
            raise
        raise MapError(f"{path}: {str(error).removeprefix('classifiers: ')}") from None
    if classifiers.ids != stored.ids:
        raise MapError(
            f"{path}: classifiers of the submaps {classifiers.ids}, but the map has "
            f"{stored.ids}: build the map again"
        )
    return classifiers


def write_csv(path: Path, report: LocalizationReport, metric: bool) -> None:
    """One line a scan; an empty submap is unknown. UsageError when it cannot be written."""
    lines = [HEADER + (METRIC_HEADER if metric else "")]
    for scan in report.scans:
        label = scan.label
        line = (
            f"{stamp_text(label.stamp_ns)},{_id(label.submap)},{label.margin:.6f},"
            f"{_id(label.runner_up)},{_id(label.filtered_submap)},{label.filtered_probability:.6f}"
        )
        if metric:
            pose = scan.submap_from_base
            line += ",,,," if pose is None else f",{pose.x:.6f},{pose.y:.6f},{pose.theta:.6f}"
            line += "" if pose is None else f",{scan.score:.6f}"
        lines.append(line)
    write_text(path, "\n".join(lines) + "\n")


def write_plot(path: Path, report: LocalizationReport, stored: StoredMap, metric: bool) -> None:
    """The predicted submap along the trajectory, over the map where scans were matched in it."""
    submaps = np.array(
        [
            NO_SUBMAP if scan.label.filtered_submap is None else scan.label.filtered_submap
            for scan in report.scans
        ]
    )
    title = f"{report.log}: predicted submaps"
    if not metric:
        track = np.array([scan.track_from_base[:2] for scan in report.scans])
        write_png(path, render_labels(track, submaps, title))
        return
    places = _steady(np.array([_place(scan, stored) for scan in report.scans]), report.scans)
    ground = (stored.topology, stored.regions)
    picture = render_labels(places, submaps, title, map_with_regions=ground)
    write_png(path, picture)


def _steady(places: FloatArray, scans: Sequence[LocalizedScan]) -> FloatArray:
    """Places (n, 2) without those that leap farther than the robot drove, both there and away.

    The first scan of a submap may match the wrong end of it; NaN marks what is left out.
    """
    track = np.array([scan.track_from_base[:2] for scan in scans])
    kept = np.flatnonzero(np.isfinite(places).all(axis=1))
    driven = np.hypot(*np.diff(track[kept], axis=0).T)
    leaps = np.hypot(*np.diff(places[kept], axis=0).T) > driven + _LEAP_M
    runs = np.split(kept, np.flatnonzero(leaps) + 1)
    steady = places.copy()
    for run in runs:
        if len(run) < _STEADY_SCANS:
            steady[run] = math.nan
    return steady


def _place(scan: LocalizedScan, stored: StoredMap) -> FloatArray:
    """(2,) place of a matched scan in the map, NaN when it fits badly."""
    id_ = scan.label.filtered_submap
    if id_ is None or scan.submap_from_base is None or scan.score < 0.5:
        return np.array([math.nan, math.nan])
    pose = stored.topology.submaps[id_].map_from_submap @ scan.submap_from_base
    return np.array([pose.x, pose.y])


def _id(submap: int | None) -> str:
    return "" if submap is None else str(submap)


def _name(submap: int | None) -> str:
    return "unknown" if submap is None else str(submap)


def _order(submap: int | None) -> tuple[bool, int]:
    return submap is None, -1 if submap is None else submap
