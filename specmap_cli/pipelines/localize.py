"""Another log against a finished map: in which submap was each scan taken? (Section IV-B)"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.arguments import Paths, instance_of, path_of, paths_of
from specmap_cli.core.arrays import neighbours
from specmap_cli.core.config import SETTINGS, load_config, with_overrides
from specmap_cli.core.errors import SETTING, LogError, MapError, UsageError
from specmap_cli.core.files import write_together
from specmap_cli.core.geometry import FloatArray, Pose2, step_lengths
from specmap_cli.core.process import one_blas_thread
from specmap_cli.core.progress import Progress, Silent
from specmap_cli.core.records import NO_SUBMAP, PosedScan
from specmap_cli.core.settings import Config, LogConfig
from specmap_cli.core.tables import csv_text
from specmap_cli.core.text import counted, legible, stamp_text
from specmap_cli.grids.map_server import png_bytes
from specmap_cli.logs import open_log
from specmap_cli.logs.stream import SweepStream
from specmap_cli.maps.filenames import CLASSIFIERS
from specmap_cli.maps.store import StoredMap, opened_map
from specmap_cli.recognition.features.sets import check_feature_sets
from specmap_cli.recognition.learning.classifiers import ClassifierSet
from specmap_cli.recognition.localization.localizer import Label, Localizer
from specmap_cli.recognition.localization.metric import Fix
from specmap_cli.recognition.localization.places import LeadingPlace
from specmap_cli.registration.frontend import FrontEnd
from specmap_cli.topology.topological_map import default_name

_NO_CALIBRATION = (
    "an older map, which does not say how sure its classifiers are: probabilities are those that "
    "are usual elsewhere; build it again"
)
_NO_MISFIT = (
    "an older map, which does not say how well its own scans fit its walls; known places are told "
    "from unknown by what is usual elsewhere: build it again"
)


@one_blas_thread()
def localize_log(
    logs: Paths,
    map_: StoredMap | Path | str,
    config: Config | None = None,
    *,
    offline: bool = False,
    metric: bool = False,
    progress: Progress | None = None,
) -> LocalizationReport:
    """Label every scan of a recording with a submap of a stored map.

    `map_` is a map directory, or one that was read. Without `config` the settings are those the map
    was built with. `offline` smooths over the whole log instead of filtering; `metric` gives poses
    in the filtered submaps, of scans whose place is clear. Raises LogError for a recording without
    a usable scan, InputError when its laser cannot stand in for the map's, MapError for a damaged
    map, UsageError when `metric` is wanted of settings that leave the walls out.
    """
    progress = progress or Silent()
    given = paths_of(logs, "logs")
    if config is not None:
        instance_of(config, Config, "config")
    stored = _opened(map_, config, progress)
    config = settings_for(stored, {}) if config is None else config
    check_feature_sets(config)
    if metric and not config.localization.fit_submaps:
        raise UsageError(
            "0 leaves out the walls, by which poses are found",
            "raise it, or leave out --metric",
            where="localization.fit_submaps",
            code=SETTING,
        )
    localizer = localizer_of(stored, config, metric=metric)
    if config.localization.unknown and localizer.classifiers.misfit is None:
        progress.note(f"{stored.path}: {_NO_MISFIT}")
    with open_log(given, config.log) as log:
        stream, front_end = SweepStream(log, config.log), FrontEnd(config.registration)
        progress.note(stream.selection.note)
        progress.start("localising", stream.expected)
        scans = tuple(_localized(stream, front_end, localizer, metric and not offline, progress))
        if not scans:
            raise LogError("no usable scan in it", "see `specmap info`", mark=";", where=log.name)
        if offline:
            scans = tuple(_smoothed(scans, stream, config, localizer, metric, progress))
        notes = [localizer.note] if localizer.note else []
        if localizer.classifiers.calibration is None:
            notes.append(f"{stored.path}: {_NO_CALIBRATION}")
        warnings = (*stream.warnings, *front_end.warnings, *notes)
        for warning in warnings:
            progress.warn(warning)
        name = legible(Path(log.name).name)
        return LocalizationReport(log=name, scans=scans, warnings=warnings, names=stored.names)


def _opened(map_: StoredMap | Path | str, config: Config | None, progress: Progress) -> StoredMap:
    """The map; what it lacks is noted, and settings that only the version that built it knows."""
    limits = None if config is None else config.limits
    stored = opened_map(map_, "map_", limits)
    if stored.note:
        progress.note(stored.note)
    if stored.foreign_settings:
        foreign = ", ".join(stored.foreign_settings)
        progress.note(f"{stored.path}: built by another version; its settings left out: {foreign}")
    return stored


def _localized(
    stream: SweepStream,
    front_end: FrontEnd,
    localizer: Localizer,
    metric: bool,
    progress: Progress,
) -> Iterator[LocalizedScan]:
    """Each scan registered, labelled, and matched within its submap when `metric`."""
    tracked = (front_end.register(sweep) for sweep in stream)
    for posed, label in localizer.labelled(tracked):
        scan = LocalizedScan(label=label, track_from_base=posed.map_from_base)
        yield _in_submap(scan, posed, localizer, localizer.places.lead) if metric else scan
        progress.advance()


def _smoothed(
    scans: Sequence[LocalizedScan],
    stream: SweepStream,
    config: Config,
    localizer: Localizer,
    metric: bool,
    progress: Progress,
) -> Iterator[LocalizedScan]:
    """The scans with the labels that the whole log gives, matched in these when `metric`.

    For that the log is read and registered once more, with the same result: no scan was kept.
    """
    labels = zip(localizer.smoothed(), scans, strict=True)
    relabelled = [replace(scan, label=label) for label, scan in labels]
    if not metric:
        yield from relabelled
        return
    progress.start("matching", stream.expected)
    front_end = FrontEnd(config.registration)
    for sweep, scan, lead in zip(stream, relabelled, localizer.leads(), strict=True):
        yield _in_submap(scan, front_end.register(sweep), localizer, lead)
        progress.advance()


def _in_submap(
    scan: LocalizedScan, posed: PosedScan, localizer: Localizer, lead: LeadingPlace | None
) -> LocalizedScan:
    """A scan with its pose in the submap that it is labelled with, where a place leads."""
    place = None if lead is None else lead.place
    fix = localizer.tracker.locate(posed, place, scan.label.filtered_submap)
    return replace(scan, fix=fix)


def settings_for(
    stored: StoredMap,
    overrides: dict[str, Any],
    file: Path | str | None = None,
    preset: str | None = None,
) -> Config:
    """The settings for a log: `overrides` over those of `file` (TOML) over those of the map.

    A `preset`, or one that the file names, takes the place of the map's settings. Topics and frames
    are never the map's: they are the log's own. Raises UsageError as `load_config` does.
    """
    from_file = {} if file is None else SETTINGS.tables(path_of(file, "file"))
    if preset is not None or "preset" in from_file:
        return load_config(file, preset, overrides)
    built_with = Config(**{**dict(stored.config), "log": LogConfig()})
    config = with_overrides(built_with, from_file, f"{file}: ")
    return with_overrides(config, overrides)


def localizer_of(stored: StoredMap, config: Config, *, metric: bool = False) -> Localizer:
    """The localizer of a stored map: its classifiers, the neighbours of its submaps, its grids."""
    classifiers = classifiers_of(stored)
    adjacency = neighbours(stored.ids, stored.topology.joined)
    frames = {i: submap.map_from_submap for i, submap in stored.topology.submaps.items()}
    labels, settings = stored.labels, config.localization
    tracks = {i: labels.poses[labels.submaps == i] for i in stored.ids}
    return Localizer(classifiers, adjacency, stored.grids, settings, frames, tracks, metric=metric)


def classifiers_of(stored: StoredMap) -> ClassifierSet:
    """The classifiers of a stored map, one a submap; MapError naming the file otherwise."""
    path, text = stored.path / CLASSIFIERS, stored.classifiers
    try:
        classifiers = ClassifierSet.from_json(text)
    except MapError as error:
        raise MapError(
            error.found, error.hint, mark=error.mark, where=path, code=error.code
        ) from None
    if classifiers.ids != stored.ids:
        raise MapError(
            f"classifiers of the submaps {classifiers.ids}, but the map has {stored.ids}",
            "build the map again",
            where=path,
        )
    return classifiers


HEADER = "stamp,submap,margin,runner_up,filtered_submap,name,filtered_probability,probability"
METRIC_HEADER = ",x,y,theta,score,var_x,cov_xy,cov_xtheta,var_y,cov_ytheta,var_theta"
_LEAP_M, _STEADY_SCANS = 0.5, 10  # a place that leaps and leaves within so many scans is wrong


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalizedScan:
    """The label of one scan, its place as registered, and within the map where it was matched."""

    label: Label
    track_from_base: Pose2
    fix: Fix | None = None

    @property
    def submap_from_base(self) -> Pose2 | None:
        """The pose in the submap of the filtered label, None where it is not known."""
        return None if self.fix is None else self.fix.pose

    @property
    def covariance(self) -> FloatArray | None:
        """(3, 3) of x, y and angle of that pose: square metres and radians."""
        return None if self.fix is None else self.fix.covariance


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalizationReport:
    """What `localize` found; `names` are those that a person gave to submaps of the map."""

    log: str
    scans: tuple[LocalizedScan, ...]
    warnings: tuple[str, ...]
    names: Mapping[int, str] = field(default_factory=dict)

    def name_of(self, submap: int | None) -> str:
        """What a submap is called; nothing for unknown."""
        return "" if submap is None else legible(self.names.get(submap, default_name(submap)))

    def as_dict(self) -> dict[str, Any]:
        """Counts of scans by label, raw and filtered; null is unknown."""
        raw, filtered = self._counts()
        return {
            "log": self.log,
            "scans": len(self.scans),
            "raw": {_name(key): raw[key] for key in sorted(raw, key=_order)},
            "filtered": {_name(key): filtered[key] for key in sorted(filtered, key=_order)},
            "agreement": self._agreement(),
            "names": {str(id_): name for id_, name in sorted(self.names.items())},
            "warnings": list(self.warnings),
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
            name = f"  {self.name_of(key)}" if key in self.names else ""
            lines.append(f"{_name(key):>8} {raw[key]:8,} {filtered[key]:9,}{name}")
        return lines

    def _counts(self) -> tuple[Counter[int | None], Counter[int | None]]:
        raw = Counter(scan.label.submap for scan in self.scans)
        return raw, Counter(scan.label.filtered_submap for scan in self.scans)

    def _agreement(self) -> float:
        same = sum(scan.label.submap == scan.label.filtered_submap for scan in self.scans)
        return round(same / len(self.scans), 6)


def write_report(
    report: LocalizationReport,
    stored: StoredMap,
    *,
    metric: bool,
    csv: Path | None = None,
    plot: Path | None = None,
) -> None:
    """Write the table and the picture that are asked for: both of them, or none.

    Raises UsageError when one cannot be written, MapError when the map is too damaged to be drawn.
    """
    contents: dict[Path, bytes] = {}
    if csv is not None:
        contents[csv] = table_of(report, metric).encode("utf-8")
    if plot is not None:
        contents[plot] = png_bytes(picture_of(report, stored, metric))
    write_together(contents)


def table_of(report: LocalizationReport, metric: bool) -> str:
    """CSV: one line a scan; an empty submap is unknown."""
    head = HEADER + METRIC_HEADER if metric else HEADER
    return csv_text(head.split(","), (_cells(report, scan, metric) for scan in report.scans))


def _cells(report: LocalizationReport, scan: LocalizedScan, metric: bool) -> list[Any]:
    """The cells of one scan; None where nothing is known.

    When `metric` its pose, the score of that and the upper triangle of its covariance come last.
    """
    label, fix = scan.label, scan.fix
    where: list[str] = []
    if metric and fix is None:
        where = [""] * METRIC_HEADER.count(",")
    elif metric and fix is not None:
        where = [f"{value:.6f}" for value in (*fix.pose, fix.score)]
        where += [f"{value:.4e}" for value in fix.covariance[np.triu_indices(3)].tolist()]
    return [
        stamp_text(label.stamp_ns),
        label.submap,
        f"{label.margin:.6f}",
        label.runner_up,
        label.filtered_submap,
        report.name_of(label.filtered_submap),
        f"{label.filtered_probability:.6f}",
        f"{label.probability:.6f}",
        *where,
    ]


def picture_of(report: LocalizationReport, stored: StoredMap, metric: bool) -> NDArray[np.uint8]:
    """The predicted submap along the trajectory, over the map where scans were matched in it.

    The colours are those of the map's overview.
    """
    from specmap_cli.drawing.palette import colours_of  # slow to load, and seldom wanted
    from specmap_cli.drawing.predictions import render_labels

    submaps = np.array(
        [
            NO_SUBMAP if scan.label.filtered_submap is None else scan.label.filtered_submap
            for scan in report.scans
        ]
    )
    title = f"{report.log}: predicted submaps"
    if not metric:
        track = np.array([scan.track_from_base[:2] for scan in report.scans])
        fills = colours_of(stored.topology, stored.regions)
        return render_labels(track, submaps, title, fills=fills)
    places = np.full((len(report.scans), 2), math.nan)
    for place, scan in zip(places, report.scans, strict=True):
        if scan.fix is not None:
            map_from_submap = stored.topology.submaps[scan.fix.submap].map_from_submap
            place[:] = (map_from_submap @ scan.fix.pose)[:2]
    places = _steady(places, report.scans)
    ground = (stored.topology, stored.regions)
    return render_labels(places, submaps, title, map_with_regions=ground)


def _steady(places: FloatArray, scans: Sequence[LocalizedScan]) -> FloatArray:
    """Places (n, 2) without those that leap farther than the robot drove, both there and away.

    The first scan of a submap may match the wrong end of it; NaN marks what is left out.
    """
    track = np.array([scan.track_from_base[:2] for scan in scans])
    kept = np.flatnonzero(np.isfinite(places).all(axis=1))
    leaps = step_lengths(places[kept]) > step_lengths(track[kept]) + _LEAP_M
    runs = np.split(kept, np.flatnonzero(leaps) + 1)
    steady = places.copy()
    for run in runs:
        if len(run) < _STEADY_SCANS:
            steady[run] = math.nan
    return steady


def _name(submap: int | None) -> str:
    return "unknown" if submap is None else str(submap)


def _order(submap: int | None) -> tuple[bool, int]:
    return submap is None, -1 if submap is None else submap
