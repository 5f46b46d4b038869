"""Another recording of the building added to its map: the submaps that are known stay as they are.

The recording is registered and laid out by itself. Its submaps are recognised among those of the
map; when several of them agree on where it lies, both are laid out as one. Only new space is
divided afresh, and the classifiers learn the new visits.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from specmap_cli.core.arguments import Paths, instance_of, path_of, paths_of
from specmap_cli.core.errors import NOT_ALIGNED, InputError, NoResultError
from specmap_cli.core.process import one_blas_thread
from specmap_cli.core.progress import Progress, Silent
from specmap_cli.core.records import PlanarScan
from specmap_cli.core.settings import Config
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.logs import open_log
from specmap_cli.logs.stream import SweepStream
from specmap_cli.maps.directory import OutputDirectory
from specmap_cli.maps.store import StoredMap, opened_map
from specmap_cli.maps.writing import write_map
from specmap_cli.pipelines.assessment import tell
from specmap_cli.pipelines.edited import tell_unapplied
from specmap_cli.pipelines.finished_map import FinishedMap
from specmap_cli.pipelines.kept_map import KeptMap, Seen, seen_of_stored
from specmap_cli.pipelines.learning import Known, whole_grid
from specmap_cli.pipelines.localize import settings_for
from specmap_cli.pipelines.map_joining import Joined, beside, closures_between, join
from specmap_cli.pipelines.redivision import redivided
from specmap_cli.pipelines.remaking import added, divided_anew, judge_of
from specmap_cli.pipelines.run_record import run_record
from specmap_cli.pipelines.stopwatch import Stopwatch
from specmap_cli.pipelines.stored_lessons import comparable, lessons_left, lessons_of_stored
from specmap_cli.pipelines.survey import survey
from specmap_cli.pipelines.thinning import Thinned, thinned
from specmap_cli.pipelines.update_report import UpdateReport
from specmap_cli.recognition.closure.alignment import Alignment, align
from specmap_cli.recognition.features.sets import KeyframeFeatures, check_feature_sets
from specmap_cli.recognition.learning.lessons import Lessons
from specmap_cli.topology.identity import border_changes

_SAME_M = 2e-3  # what a map keeps of a range, a millimetre, and as much again
_SAME_SHARE = 0.5  # of the readings; those of a scan in motion stand at other bearings


@one_blas_thread()
def update_map(
    map_: StoredMap | Path | str,
    logs: Paths,
    out: Path | str,
    config: Config | None = None,
    *,
    allow_apart: bool = False,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> UpdateReport:
    """Add a recording to a map, and write the result to the directory `out`.

    Without `config` the settings are those the map was built with. A recording that fits nowhere is
    refused, or with `allow_apart` appended as a part of its own. Raises NoResultError for one that
    is refused or has no scan that could be registered, InputError for one that is in the map,
    LogError, MapError and UsageError as `build_map` and `read_map` do.
    """
    given, target, progress = paths_of(logs, "logs"), path_of(out, "out"), progress or Silent()
    limits = None if config is None else config.limits
    stored = opened_map(map_, "map_", limits)
    config = settings_for(stored, {}) if config is None else instance_of(config, Config, "config")
    check_feature_sets(config)
    with (
        open_log(given, config.log) as log,
        OutputDirectory(target, overwrite, progress) as partial,
        stored.keyframes() as store,
    ):
        stream = SweepStream(log, config.log)
        updated = _updated(stored, stream, store, config, progress, allow_apart=allow_apart)
        finished, fewer = updated.finished, updated.fewer
        overview = finished.overview(fewer.kept.logs)
        run = {
            **run_record(log.given, stream.selection, config, finished),
            "updates": [*_earlier(stored), _told(stored.path, updated)],
        }
        tell(finished.quality, progress)
        write_map(partial, finished.result(fewer.kept.logs, run, overview), store)
    before, visits = np.split(finished.labels.submaps, [fewer.old])
    known = set(before.tolist())
    return UpdateReport(
        out=target,
        run=run,
        quality=finished.quality,
        alignment=updated.alignment,
        visited=tuple(sorted(set(visits.tolist()) & known)),
        new=tuple(sorted(set(visits.tolist()) - known)),
        borders=border_changes(stored.regions, finished.regions),
        dropped=fewer.dropped,
        unapplied=finished.unapplied,
    )


@dataclass(frozen=True, slots=True)
class _Updated:
    """A map with a recording more, where that lies in it, and which keyframes are left."""

    finished: FinishedMap
    fewer: Thinned
    alignment: Alignment


def _updated(
    stored: StoredMap,
    stream: SweepStream,
    store: KeyframeStore,
    config: Config,
    progress: Progress,
    *,
    allow_apart: bool,
) -> _Updated:
    """The map with the recording; its keyframes are added to `store`, which holds the map's."""
    clock, name = Stopwatch(), stream.log.name
    old, lessons = seen_of_stored(stored), lessons_of_stored(stored, config)
    with KeyframeStore() as own:
        surveyed = survey(stream, config, own, progress, clock)
        new = surveyed.seen
        _refuse_known(old, new, store, own)
        store.extend(own)
    progress.start("aligning", None)
    with clock.stage("alignment"):
        alignment = align(old.known, new.known, config)
    if alignment.old_from_new is None and not allow_apart:
        raise _fits_nowhere(name, stored.path, alignment.reason)
    progress.start("layout", None)
    with clock.stage("layout"):
        joined = _joined(store, old, new, alignment, config)
    _refuse_loose(joined, old, name, allow=allow_apart)
    with clock.stage("thinning"):
        fewer = thinned(store, joined.kept, old, new, config)
    with clock.stage("grids"):
        whole, beyond = whole_grid(store, fewer.kept.layout, config)
    with clock.stage("segmentation"):
        kept = redivided(old, joined.kept, fewer, whole, config)
    counts = added(stored.counts, surveyed.tracking.counts)
    features = surveyed.features.among(store, fewer.old)
    known = _known(stored, old, kept, fewer, features, lessons, config)
    judge = judge_of(joined)
    finished = divided_anew(
        store, kept, judge, config, progress, clock, counts, known, (whole, beyond)
    )
    tell_unapplied(finished.unapplied, progress)
    return _Updated(finished, fewer, alignment)


def _known(
    stored: StoredMap,
    old: Seen,
    kept: KeptMap,
    fewer: Thinned,
    own: KeyframeFeatures,
    lessons: Lessons,
    config: Config,
) -> Known:
    """What is known of the map: features of the recording's `own` scans, and the map's lessons."""
    left = fewer.left[: fewer.old]
    lessons = lessons_left(lessons, stored.labels, kept.labels, left, config.grid.resolution_m)
    features = own.knowing(lessons.raw.keyframes, lessons.raw.features)
    return Known(features, lessons, kept.starts, comparable(old.known.classifiers, stored, config))


def _refuse_known(old: Seen, new: Seen, store: KeyframeStore, own: KeyframeStore) -> None:
    """Refuse a recording that the map was made of: its walls would count twice."""
    (log,) = new.kept.logs
    scan = own.scan(0)
    for known in old.kept.logs:
        if known.keyframes is None or known.scans != log.scans:
            continue
        first = store.scan(known.keyframes[0])  # logs are known to the microsecond, scans exactly
        if first.stamp_ns == scan.stamp_ns and _alike(first, scan):
            raise InputError(f"{log.name}: is in the map already, as {known.name}: nothing to add")


def _alike(one: PlanarScan, other: PlanarScan) -> bool:
    """Whether two scans are one, of which a map keeps the readings at even bearings."""
    if one.ranges.shape != other.ranges.shape:
        return False
    same = np.isclose(one.ranges, other.ranges, atol=_SAME_M, equal_nan=True)
    return float(same.mean()) > _SAME_SHARE


def _fits_nowhere(name: str, path: Path, reason: str) -> NoResultError:
    return NoResultError(
        f"{name}: fits nowhere in {path}: {reason}: build a map of its own, or append it as a part "
        "of its own with --allow-apart",
        code=NOT_ALIGNED,
    )


def _joined(
    store: KeyframeStore, old: Seen, new: Seen, alignment: Alignment, config: Config
) -> Joined:
    """The recording laid into the map where they are aligned, beside it otherwise."""
    where = alignment.old_from_new or beside(old.known.whole, new.known.whole)
    found = closures_between(old.kept, new.kept, alignment.joints)
    return join(store, old.kept, old.regions, new, where, found, config)


def _refuse_loose(joined: Joined, old: Seen, name: str, *, allow: bool) -> None:
    """Refuse a recording that no wall ties to the map in the end."""
    if len(old.kept.labels.stamps_ns) in joined.kept.layout.loose and not allow:
        raise NoResultError(
            f"{name}: lies in the map, but no wall that both saw holds it there: build a map of "
            "its own, or append it as a part of its own with --allow-apart",
            code=NOT_ALIGNED,
        )


def _earlier(stored: StoredMap) -> list[Any]:
    """What run.json keeps of the updates before."""
    updates = stored.run.get("updates")
    return updates if isinstance(updates, list) else []


def _told(path: Path, updated: _Updated) -> dict[str, Any]:
    """What run.json keeps of an update."""
    motion, fewer = updated.alignment.old_from_new, updated.fewer
    return {
        "map": path.resolve().name,
        "old_from_new": None if motion is None else np.round(motion, 6).tolist(),
        "reason": updated.alignment.reason,
        "keyframes_dropped": fewer.dropped,
        "keyframes_kept_for_walls": fewer.witnesses,
    }
