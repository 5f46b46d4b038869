"""Another log against a finished map: in which submap was each scan taken? (Section IV-B)"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from specmap_cli.core.arguments import Paths, instance_of, path_of, paths_of
from specmap_cli.core.arrays import neighbours
from specmap_cli.core.config import SETTINGS, load_config, with_overrides
from specmap_cli.core.errors import SETTING, LogError, MapError, UsageError
from specmap_cli.core.process import one_blas_thread
from specmap_cli.core.progress import Progress, Silent
from specmap_cli.core.records import PosedScan
from specmap_cli.core.settings import Config, LogConfig
from specmap_cli.core.text import legible
from specmap_cli.logs import open_log
from specmap_cli.logs.stream import SweepStream
from specmap_cli.maps.filenames import CLASSIFIERS
from specmap_cli.maps.store import StoredMap, opened_map
from specmap_cli.pipelines.localization_report import LocalizationReport, LocalizedScan
from specmap_cli.recognition.features.sets import check_feature_sets
from specmap_cli.recognition.learning.classifiers import ClassifierSet
from specmap_cli.recognition.localization.leads import Lead
from specmap_cli.recognition.localization.localizer import Localizer
from specmap_cli.registration.frontend import FrontEnd

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
    _check_walls(config, metric)
    localizer = localizer_of(stored, config, metric=metric)
    if config.localization.unknown and localizer.classifiers.misfit is None:
        progress.note(f"{stored.path}: {_NO_MISFIT}")
    with open_log(given, config.log) as log:
        stream, front_end = SweepStream(log, config.log), FrontEnd(config.registration)
        progress.note(stream.selection.note)
        progress.start("localising", stream.expected)
        scans = tuple(_localized(stream, front_end, localizer, metric and not offline, progress))
        if not scans:
            raise LogError(f"{log.name}: no usable scan in it; see `specmap info`")
        if offline:
            scans = _smoothed(scans, stream, config, localizer, metric, progress)
        notes = [localizer.note] if localizer.note else []
        if localizer.classifiers.calibration is None:
            notes.append(f"{stored.path}: {_NO_CALIBRATION}")
        warnings = (*stream.warnings, *front_end.warnings, *notes)
        for warning in warnings:
            progress.warn(warning)
        name = legible(Path(log.name).name)
        return LocalizationReport(log=name, scans=scans, warnings=warnings, names=stored.names)


def _check_walls(config: Config, metric: bool) -> None:
    """Raise UsageError when poses are wanted, but no walls to find them by."""
    if metric and not config.localization.fit_submaps:
        raise UsageError(
            "localization.fit_submaps: 0 leaves out the walls, by which poses are found: "
            "raise it, or leave out --metric",
            code=SETTING,
        )


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
) -> tuple[LocalizedScan, ...]:
    """The scans with the labels that the whole log gives, matched in these when `metric`."""
    labels = zip(localizer.smoothed(), scans, strict=True)
    relabelled = [replace(scan, label=label) for label, scan in labels]
    if not metric:
        return tuple(relabelled)
    progress.start("matching", stream.expected)
    return tuple(_matched(stream, config, localizer, relabelled, progress))


def _matched(
    stream: SweepStream,
    config: Config,
    localizer: Localizer,
    scans: Iterable[LocalizedScan],
    progress: Progress,
) -> Iterator[LocalizedScan]:
    """The scans matched within the submaps of their smoothed labels, which the end of the log gave.

    The log is read and registered once more, with the same result: no scan was kept.
    """
    front_end = FrontEnd(config.registration)
    for sweep, scan, lead in zip(stream, scans, localizer.leads(), strict=True):
        yield _in_submap(scan, front_end.register(sweep), localizer, lead)
        progress.advance()


def _in_submap(
    scan: LocalizedScan, posed: PosedScan, localizer: Localizer, lead: Lead | None
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
    built_with = stored.config.model_copy(update={"log": LogConfig()})
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
