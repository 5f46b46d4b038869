"""From a recorded log to a topological map: Algorithm 1 of the paper, and what follows it.

Brunskill, Kollar and Roy, "Topological Mapping Using Spectral Clustering and Classification"
(IROS 2007). While the log lasts: track, segment, recognise. After it: relax, heal, refute,
divide, assess, learn, write.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from specmap_cli.core.arguments import Paths, instance_of, path_of, paths_of
from specmap_cli.core.errors import NoResultError
from specmap_cli.core.progress import Progress, Silent
from specmap_cli.core.records import Labels, PosedScan
from specmap_cli.core.settings import Config
from specmap_cli.core.text import counted
from specmap_cli.grids.keyframes import KeyframeSelector, KeyframeStore
from specmap_cli.logs import open_log
from specmap_cli.logs.stream import SweepStream
from specmap_cli.maps.directory import OutputDirectory, refuse_inside
from specmap_cli.maps.writing import write_map
from specmap_cli.pipelines.assessment import assess, tell
from specmap_cli.pipelines.exploration import Exploration, Explored
from specmap_cli.pipelines.finished_map import FinishedMap, recording
from specmap_cli.pipelines.laying_out import lay_out
from specmap_cli.pipelines.learning import divide, learn, linked, whole_grid
from specmap_cli.pipelines.run_record import BuildReport, run_record
from specmap_cli.pipelines.split_test_pictures import split_test_pictures
from specmap_cli.pipelines.stopwatch import Stopwatch
from specmap_cli.pipelines.tracking import Tracking, track
from specmap_cli.pipelines.trajectory import TrajectoryRecorder
from specmap_cli.pipelines.worker import ahead
from specmap_cli.recognition.features.sets import check_feature_sets
from specmap_cli.segmentation.online import Observer
from specmap_cli.topology.regions import divide as divide_cells

Accepts = Callable[[PosedScan], bool]


def build_map(
    logs: Paths,
    out: Path | str,
    config: Config | None = None,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
    explain: Path | str | None = None,
) -> BuildReport:
    """Build the map of a recording and write it to the directory `out`, complete or not at all.

    `explain` is a directory for a picture of every test that may split a submap.

    Raises UsageError for an output that cannot be written or topics that must be chosen, LogError
    for a recording that cannot be used, NoResultError when no scan could be registered.
    """
    config = instance_of(Config() if config is None else config, Config, "config")
    given, target, progress = paths_of(logs, "logs"), path_of(out, "out"), progress or Silent()
    pictures = None if explain is None else path_of(explain, "explain")
    refuse_inside(pictures, target)
    with (
        open_log(given, config.log) as log,
        OutputDirectory(target, overwrite, progress) as partial,
        KeyframeStore() as store,
    ):
        observer = split_test_pictures(pictures, config.segmentation, overwrite=overwrite)
        stream = SweepStream(log, config.log)
        finished = map_log(stream, config, store, progress, observer=observer)
        run = run_record(log.given, stream.selection, config, finished)
        tell(finished.quality, progress)
        given_log = recording(log.name, finished.trajectory, len(store))
        write_map(partial, finished.result((given_log,), run), store)
    return BuildReport(out=target, run=run, quality=finished.quality)


def map_log(
    stream: SweepStream,
    config: Config,
    store: KeyframeStore,
    progress: Progress,
    *,
    accepts: Accepts | None = None,
    observer: Observer | None = None,
) -> FinishedMap:
    """The map of a log, its keyframes in `store`.

    `accepts` says of each scan, in turn, whether it is a keyframe; by default the settings say it.
    `observer` is told of every test that may split a submap. Raises NoResultError when the log
    left no keyframe, or none that fits the grid.
    """
    check_feature_sets(config)
    clock = Stopwatch()
    accepts = accepts or KeyframeSelector(config.keyframes).accepts
    explored, tracking = explore_log(  # what only the exploration knew is gone after it
        stream, config, Exploration(config, store, clock, observer), accepts, progress
    )
    refuse_empty(store, stream, tracking)
    return finish(explored, tracking, config, store, progress, clock)


def refuse_empty(store: KeyframeStore, stream: SweepStream, tracking: Tracking) -> None:
    """Raise NoResultError when a log left no keyframe."""
    if not len(store):
        found = "; ".join(tracking.warnings) or "too few returns in them"
        raise NoResultError(
            f"{stream.log.name}: none of {counted(stream.expected, 'scan')} could be registered "
            f"({found}): look at them with `specmap info`"
        )


def explore_log(
    stream: SweepStream,
    config: Config,
    exploration: Exploration,
    accepts: Accepts,
    progress: Progress,
) -> tuple[Explored, Tracking]:
    """Track and explore a log: registration runs ahead where there is a second processor."""
    progress.note(stream.selection.note)
    progress.start("mapping", stream.expected)
    with ahead(lambda: track(stream, config.registration)) as scans:
        explored = explore(scans, exploration, accepts, progress)
        tracking = scans.result
    exploration.clock.seconds["registration"] = tracking.seconds
    return explored, tracking


def explore(
    scans: Iterable[PosedScan], exploration: Exploration, accepts: Accepts, progress: Progress
) -> Explored:
    """Algorithm 1, while the log lasts. Scans come registered: "scan match new observations"."""
    trajectory = TrajectoryRecorder()
    for scan in scans:  # "move forward and gather a new set of laser scan observations"
        trajectory.append(scan)
        if scan.restarted:  # tracking was lost meanwhile: a new submap begins
            exploration.recognise(exploration.break_off(scan.bridge))
        if accepts(scan):
            # "add to submap"; "every 50 steps, use spectral clustering to detect a new submap"
            left = exploration.add(scan)
            # "use learned classifiers to determine if the new submap is an existing submap"; if so
            # "merge [...] and close loop", if not "add submap to graph and train new classifier"
            exploration.recognise(left)
        progress.advance()
    exploration.recognise(exploration.end_submap())
    exploration.recognise_leftovers()
    return exploration.explored(trajectory.trajectory())


def finish(
    explored: Explored,
    tracking: Tracking,
    config: Config,
    store: KeyframeStore,
    progress: Progress,
    clock: Stopwatch,
) -> FinishedMap:
    """What follows Algorithm 1: relax the layout, heal it, refute, divide, assess, learn."""
    laid = lay_out(explored, config, store, progress, clock)
    layout, closures = laid.layout, laid.closures
    with clock.stage("grids"):
        whole, beyond = whole_grid(store, layout, config)
    with clock.stage("segmentation"):
        submaps = divide(whole, layout, explored, closures, config)
    with clock.stage("audit"):
        quality = assess(store, explored, laid, beyond, tracking.warnings, config)
    grids, classifiers = learn(
        store, explored.features, submaps, layout.poses, config, progress, clock
    )
    stamps = np.array(store.stamps_ns, dtype=np.int64)
    labels = Labels(stamps_ns=stamps, poses=layout.poses, submaps=submaps)
    return FinishedMap(
        topology=linked(labels, explored.regions, explored.breaks, closures, grids),
        labels=labels,
        trajectory=laid.trajectory,
        regions=divide_cells(whole, labels),
        classifiers=classifiers,
        layout=layout,
        counts=tracking.counts,
        limits={**layout.limits, "max_extent_m": beyond},
        quality=quality,
        seconds=dict(clock.seconds),
    )
