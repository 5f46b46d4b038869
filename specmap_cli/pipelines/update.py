"""A recording laid into a map that is there: added to it by `update`, like it by `build --like`.

The recording is registered and laid out by itself. Its submaps are recognised among those of the
map; several of them must agree on where it lies. Then `update` lays out both as one, and `build
--like` only moves the recording, of which it makes a fresh map. Submaps that are known keep ids and
borders. Only new space is divided afresh.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from specmap_cli.core.errors import (
    NOT_ALIGNED,
    InputError,
    NoResultError,
    Paths,
    path_of,
    paths_of,
)
from specmap_cli.core.geometry import Pose2, compose
from specmap_cli.core.process import one_blas_thread
from specmap_cli.core.progress import Progress, Silent
from specmap_cli.core.settings import Config
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.joining import placed
from specmap_cli.logs import open_log
from specmap_cli.logs.stream import SweepStream
from specmap_cli.maps.directory import OutputDirectory
from specmap_cli.maps.store import Map, opened_map
from specmap_cli.pipelines.build import survey
from specmap_cli.pipelines.finishing import finish, write_made
from specmap_cli.pipelines.joining import (
    closures_between,
    inherit,
    join,
    moved_finding,
    place_apart,
)
from specmap_cli.pipelines.laying_out import with_grid
from specmap_cli.pipelines.learning import (
    Prior,
    comparable,
    training_data_of_stored,
    valid_training_data,
)
from specmap_cli.pipelines.localizer import classifiers_of, settings_for
from specmap_cli.pipelines.map_in_making import LaidOut, laid_out_of_stored
from specmap_cli.pipelines.overlaps import (
    aligned,
    laid_out_to_align,
    lengthened,
    stored_to_align,
    stretch_of,
    told_m,
    with_other_lengths,
)
from specmap_cli.pipelines.reports import BuildReport, UpdateReport
from specmap_cli.pipelines.session import Session
from specmap_cli.pipelines.thinning import Thinned, thinned
from specmap_cli.recognition.closure.alignment import Alignment
from specmap_cli.recognition.closure.common_ground import MapToAlign
from specmap_cli.recognition.features.sets import check_feature_sets
from specmap_cli.segmentation.division import regions_of
from specmap_cli.topology.graph import inherited, walled_off
from specmap_cli.topology.identity import border_changes, carried

_SAME_M = 2e-3  # what a map keeps of a range, a millimetre, and as much again
_SAME_SHARE = 0.5  # of the readings; those of a scan in motion stand at other bearings


@one_blas_thread()
def update_map(
    map_: Map | Path | str,
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
    stored = opened_map(map_, "map_", config)
    config = config or settings_for(stored, {})
    check_feature_sets(config)
    with (
        open_log(given, config.log) as log,
        OutputDirectory(target, overwrite, progress, made_of=[stored]) as partial,
        stored.scans() as store,
    ):
        session, old = Session(config, store, progress), laid_out_of_stored(stored)
        stream = SweepStream(log, config.log)
        fewer, prior, alignment = _updated(session, stored, old, stream, allow_apart=allow_apart)
        finished = finish(session, fewer.laid, prior)
        motion, earlier = alignment.old_from_new, stored.run.get("updates")
        last = {
            "map": stored.path.resolve().name,
            "old_from_new": None if motion is None else np.round(motion, 6).tolist(),
            "reason": alignment.reason,
            "keyframes_dropped": fewer.dropped,
            "keyframes_kept_for_walls": fewer.kept_for_walls,
        }
        updates = [*(earlier if isinstance(earlier, list) else []), last]
        run = write_made(session, partial, finished, log.given, stream.selection, updates=updates)
    before, visits = np.split(finished.laid.labels.submaps, [fewer.old])
    ids, old_ids = set(before.tolist()), set(stored.ids)
    return UpdateReport(
        out=target,
        run=run,
        quality=finished.quality,
        alignment=alignment,
        visited=tuple(sorted(set(visits.tolist()) & old_ids)),
        new=tuple(sorted(set(visits.tolist()) - ids)),
        cut_off=tuple(sorted(ids - old_ids)),
        borders=border_changes(old.regions, finished.laid.regions),
        dropped=fewer.dropped,
        unapplied=finished.unapplied,
    )


def _updated(
    session: Session, stored: Map, old: LaidOut, stream: SweepStream, *, allow_apart: bool
) -> tuple[Thinned, Prior, Alignment]:
    """The map with the recording, in the store too; what is known before it, and where it lies."""
    config, store, name = session.config, session.store, stream.log.name
    old_to_align, data = stored_to_align(stored), training_data_of_stored(stored, config)
    known = comparable(classifiers_of(stored), stored, config)
    with KeyframeStore() as own:
        alone = replace(session, store=own)
        new, prior = survey(alone, stream)
        new_to_align = laid_out_to_align(alone, new)
        _refuse_repeated(old, new, store, own)
        stretch, bent = stretch_of(new.findings, new.labels.stamps_ns), None
        if stretch is not None:
            bent = with_other_lengths(stretch, told_m(old.findings), own, new.labels, config)
        alignment = _aligned(session, old_to_align, new_to_align, bent or ())
        if stretch is not None and alignment.old_from_new is not None and alignment.longer_m:
            registered = stretch.longer(own.poses, alignment.longer_m)
            own.keep(np.arange(len(own)), registered)
            new = with_grid(alone, lengthened(new, stretch, alignment.longer_m))
        store.extend(own)
    if alignment.old_from_new is None and not allow_apart:
        raise NoResultError(
            f"fits nowhere in {stored.path}: {alignment.reason}",
            "build a map of its own, or append it as a part of its own with --allow-apart",
            where=name,
            code=NOT_ALIGNED,
        )
    fewer = _joined(session, old, new, alignment, name, allow_apart=allow_apart)
    laid, left = fewer.laid, fewer.left[: fewer.old]
    data = valid_training_data(data, old.labels, laid.labels, left, config.grid.resolution_m)
    features = prior.features.among(store, fewer.old)
    prior = Prior(features.knowing(data.raw.keyframes, data.raw.features), data, known)
    before = stored.counts
    counts = {name: count + before.get(name, 0) for name, count in new.counts.items()}
    return replace(fewer, laid=replace(laid, counts=counts)), prior, alignment


@one_blas_thread()
def build_like(
    logs: Paths,
    like: Map | Path | str,
    out: Path | str,
    config: Config | None = None,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> BuildReport:
    """Build the map of a recording in the frame of the map `like`, with its ids and borders.

    It takes no data of that map. Without `config` the settings are those `like` was built with.
    Only space that `like` does not have is divided afresh and gets new ids. Raises NoResultError
    for a recording that fits nowhere in `like`, and else as `build_map` and `read_map`.
    """
    given, target, progress = paths_of(logs, "logs"), path_of(out, "out"), progress or Silent()
    stored = opened_map(like, "like", config)
    config = config or settings_for(stored, {})
    check_feature_sets(config)
    with (
        open_log(given, config.log) as log,
        OutputDirectory(target, overwrite, progress, made_of=[stored]) as partial,
        KeyframeStore() as store,
    ):
        session = Session(config, store, progress)
        old_to_align, old = stored_to_align(stored), laid_out_of_stored(stored)
        stream = SweepStream(log, config.log)
        new, prior = survey(session, stream)
        alignment = _aligned(session, old_to_align, laid_out_to_align(session, new))
        if alignment.old_from_new is None:
            raise NoResultError(
                f"fits nowhere in {stored.path}: {alignment.reason}",
                "build it without --like",
                where=log.name,
                code=NOT_ALIGNED,
            )
        laid = with_grid(session, _alike(old, new, alignment.old_from_new, config))
        finished = finish(session, laid, prior)
        name = stored.path.resolve().name
        run = write_made(session, partial, finished, log.given, stream.selection, like=name)
    return BuildReport(out=target, run=run, quality=finished.quality, unapplied=finished.unapplied)


def _aligned(
    session: Session, old: MapToAlign, new: MapToAlign, bent: Iterable[MapToAlign] = ()
) -> Alignment:
    """Where the recording lies in the map; `bent` are its other lengths."""
    session.progress.start("aligning", None)
    with session.clock.stage("alignment"):
        return aligned(old, new, bent)


def _joined(
    session: Session,
    old: LaidOut,
    new: LaidOut,
    alignment: Alignment,
    name: str,
    *,
    allow_apart: bool,
) -> Thinned:
    """The recording laid into the map or beside it, thinned and divided; NoResultError if loose."""
    session.progress.start("layout", None)
    with session.clock.stage("layout"):
        where = alignment.old_from_new or place_apart(old.whole, new.whole)
        found = closures_between(old, new, alignment.joints)
        joint = join(session, old, new, where, found)
    if len(old) in joint.layout.loose and not allow_apart:
        raise NoResultError(
            "lies in the map, but no wall that both saw holds it there",
            "build a map of its own, or append it as a part of its own with --allow-apart",
            where=name,
            code=NOT_ALIGNED,
        )
    with session.clock.stage("thinning"):
        fewer = thinned(session, joint, old, new)
    drawn = replace(fewer, laid=with_grid(session, fewer.laid))
    with session.clock.stage("segmentation"):
        return redivided(old, joint, drawn, session.config)


def redivided(old: LaidOut, joint: LaidOut, fewer: Thinned, config: Config) -> Thinned:
    """What is left of the `joint` map, its new space divided as a build of all would divide it.

    The recording that is added saw some rooms only through their doors, and so did those before it.
    By itself its map may give a room that it entered to what lies beyond the next door, and the old
    map may have given parts of it to the corridor. The map of all of them shows the room as it is.
    The keyframes of `old`, with which those of `joint` begin, stay in their submaps, unless a wall
    now cuts them off from most of theirs. What these had of a room stays theirs, though in the map
    of all it is a region of its own that no robot stood in.
    """
    laid = fewer.laid
    if laid.division is None:
        return fewer
    poses, least_m = joint.layout.poses, config.segmentation.region_min_m
    divided = regions_of(laid.whole, laid.division.array, poses, least_m)
    submaps = inherited(old.labels, old.regions, old.next_id, poses, divided, least_m)
    next_id = max(old.next_id, 1 + int(submaps.max()))
    submaps = walled_off(submaps, poses, old.regions, laid.whole, next_id, least_m)
    labels = replace(laid.labels, submaps=submaps[fewer.left])
    next_id = max(next_id, 1 + int(submaps.max()))
    laid = replace(laid, labels=labels, next_id=next_id)
    return replace(fewer, laid=laid.keeping(old.regions))


def _alike(old: LaidOut, new: LaidOut, old_from_new: Pose2, config: Config) -> LaidOut:
    """A recording in the frame of an old map, each keyframe in the submap whose territory it is."""
    layout = placed(new.layout, old_from_new)
    poses = np.concatenate([old.labels.poses, layout.poses])
    submaps = inherit(old, new, poses, old_from_new, config)[len(old) :]
    way = new.trajectory
    return replace(
        new,
        layout=layout,
        labels=replace(new.labels, poses=layout.poses, submaps=submaps),
        trajectory=replace(way, poses=compose(np.array(old_from_new), way.poses)),
        findings=tuple(moved_finding(one, old_from_new) for one in new.findings),
        next_id=max(old.next_id, 1 + int(submaps.max())),
        drawn=None,
        edits=old.edits,
        edits_text=old.edits_text,
        borders=carried(old.borders, old.whole, old.labels.poses, layout.poses),
    )


def _refuse_repeated(old: LaidOut, new: LaidOut, store: KeyframeStore, own: KeyframeStore) -> None:
    """Refuse a recording that the map was made of: its walls would count twice."""
    (log,) = new.logs
    scan = own.scan(0)
    for known in old.logs:
        if known.keyframes is None or known.scans != log.scans:
            continue
        first = store.scan(known.keyframes[0])  # logs are known to the microsecond, scans exactly
        if first.stamp_ns != scan.stamp_ns or first.ranges.shape != scan.ranges.shape:
            continue
        same = np.isclose(first.ranges, scan.ranges, atol=_SAME_M, equal_nan=True)
        if float(same.mean()) > _SAME_SHARE:  # a map keeps the readings at even bearings
            raise InputError(
                f"is in the map already, as {known.name}: nothing to add", where=log.name
            )
