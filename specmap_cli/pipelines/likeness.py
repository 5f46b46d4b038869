"""A fresh map in the frame and with the ids of an older one, of which it takes no data."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from specmap_cli.core.arguments import Paths, instance_of, path_of, paths_of
from specmap_cli.core.errors import NOT_ALIGNED, NoResultError
from specmap_cli.core.geometry import Pose2, compose
from specmap_cli.core.process import one_blas_thread
from specmap_cli.core.progress import Progress, Silent
from specmap_cli.core.settings import Config
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.joining import placed
from specmap_cli.logs import open_log
from specmap_cli.logs.stream import SweepStream
from specmap_cli.maps.directory import OutputDirectory
from specmap_cli.maps.store import StoredMap, opened_map
from specmap_cli.maps.writing import write_map
from specmap_cli.pipelines.assessment import tell
from specmap_cli.pipelines.kept_map import KeptMap, Seen, seen_of_stored
from specmap_cli.pipelines.learning import Known
from specmap_cli.pipelines.map_joining import Joined, inherit, moved_finding
from specmap_cli.pipelines.remaking import remade
from specmap_cli.pipelines.run_record import BuildReport, run_record
from specmap_cli.pipelines.stopwatch import Stopwatch
from specmap_cli.pipelines.survey import Survey, survey
from specmap_cli.recognition.closure.alignment import align
from specmap_cli.recognition.features.sets import check_feature_sets
from specmap_cli.topology.redrawing import carried


@one_blas_thread()
def build_like(
    logs: Paths,
    like: StoredMap | Path | str,
    out: Path | str,
    config: Config | None = None,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> BuildReport:
    """Build the map of a recording in the frame of the map `like`, with its ids and borders.

    Only space that `like` does not have is divided afresh and gets new ids. Raises NoResultError
    for a recording that fits nowhere in `like`, and else as `build_map` and `read_map`.
    """
    config = instance_of(Config() if config is None else config, Config, "config")
    given, target, progress = paths_of(logs, "logs"), path_of(out, "out"), progress or Silent()
    stored = opened_map(like, "like", config.limits)
    check_feature_sets(config)
    clock = Stopwatch()
    with (
        open_log(given, config.log) as log,
        OutputDirectory(target, overwrite, progress) as partial,
        KeyframeStore() as store,
    ):
        old = seen_of_stored(stored)
        stream = SweepStream(log, config.log)
        surveyed = survey(stream, config, store, progress, clock)
        progress.start("aligning", None)
        with clock.stage("alignment"):
            alignment = align(old.known, surveyed.seen.known, config)
        if alignment.old_from_new is None:
            raise NoResultError(
                f"{log.name}: fits nowhere in {stored.path}: {alignment.reason}: build it without "
                "--like",
                code=NOT_ALIGNED,
            )
        joined = alike(old, surveyed, alignment.old_from_new, config)
        counts = surveyed.tracking.counts
        finished = remade(store, joined, config, progress, clock, counts, Known(surveyed.features))
        overview = finished.overview(joined.kept.logs)
        run = {
            **run_record(log.given, stream.selection, config, finished),
            "like": stored.path.resolve().name,
        }
        tell(finished.quality, progress)
        write_map(partial, finished.result(joined.kept.logs, run, overview), store)
    return BuildReport(out=target, run=run, quality=finished.quality, unapplied=finished.unapplied)


def alike(old: Seen, surveyed: Survey, old_from_new: Pose2, config: Config) -> Joined:
    """A recording in the frame of an old map, each keyframe in the submap whose territory it is."""
    new, motion = surveyed.seen, np.array(old_from_new)
    kept, count = new.kept, len(old.kept.labels.poses)
    layout = placed(kept.layout, old_from_new)
    poses = np.concatenate([old.kept.labels.poses, layout.poses])
    submaps = inherit(old.kept, old.regions, new, poses, old_from_new, config)[count:]
    moved = KeptMap(
        layout=layout,
        labels=replace(kept.labels, poses=layout.poses, submaps=submaps),
        trajectory=replace(kept.trajectory, poses=compose(motion, kept.trajectory.poses)),
        stays=kept.stays,
        closures=kept.closures,
        breaks=kept.breaks,
        logs=kept.logs,
        findings=tuple(moved_finding(one, old_from_new) for one in kept.findings),
        next_id=max(old.kept.next_id, 1 + int(submaps.max())),
        edits=old.kept.edits,
        edits_text=old.kept.edits_text,
        borders=carried(old.kept.borders, old.kept.labels.poses, layout.poses),
    )
    return Joined(moved, replace(surveyed.audited, layout=layout))
