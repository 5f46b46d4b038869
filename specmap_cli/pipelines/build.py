"""From a recorded log to a topological map: Algorithm 1 of the paper, and what follows it.

Brunskill, Kollar and Roy, "Topological Mapping Using Spectral Clustering and Classification"
(IROS 2007). While the log lasts: track, segment, recognise. After it: relax, turn, heal,
refute, divide, assess, learn, write.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from specmap_cli.core.arguments import Paths, instance_of, path_of, paths_of
from specmap_cli.core.errors import NoResultError, UsageError
from specmap_cli.core.process import one_blas_thread
from specmap_cli.core.progress import Progress, Silent
from specmap_cli.core.records import PosedScan
from specmap_cli.core.settings import Config
from specmap_cli.core.text import counted
from specmap_cli.grids.keyframes import KeyframeSelector, KeyframeStore
from specmap_cli.logs import open_log
from specmap_cli.logs.stream import SweepStream
from specmap_cli.maps.directory import OutputDirectory, refuse_inside
from specmap_cli.maps.filenames import EDITS
from specmap_cli.pipelines.stopwatch import Stopwatch
from specmap_cli.pipelines.tracking import Tracking, track
from specmap_cli.pipelines.trajectory import TrajectoryRecorder
from specmap_cli.pipelines.worker import ahead
from specmap_cli.recognition.features.sets import check_feature_sets

if TYPE_CHECKING:  # slow to load: it is, while the other process reads and registers
    from specmap_cli.pipelines.exploration import Exploration, Explored
    from specmap_cli.pipelines.finished_map import FinishedMap
    from specmap_cli.pipelines.run_record import BuildReport
    from specmap_cli.segmentation.online import Observer

Accepts = Callable[[PosedScan], bool]


@one_blas_thread()
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
    _refuse_edited(target)
    with (
        open_log(given, config.log) as log,
        OutputDirectory(target, overwrite, progress) as partial,
        KeyframeStore() as store,
    ):
        observer = None if pictures is None else _pictures(pictures, config, overwrite=overwrite)
        stream = SweepStream(log, config.log)
        finished = map_log(stream, config, store, progress, observer=observer)
        from specmap_cli.maps.writing import write_map
        from specmap_cli.pipelines.assessment import tell
        from specmap_cli.pipelines.finished_map import recording
        from specmap_cli.pipelines.run_record import BuildReport, run_record

        logs_read = (recording(log.name, finished.trajectory, len(store)),)
        overview = finished.overview(logs_read)
        run = run_record(log.given, stream.selection, config, finished)
        tell(finished.quality, progress)
        write_map(partial, finished.result(logs_read, run, overview), store)
    return BuildReport(out=target, run=run, quality=finished.quality)


def _refuse_edited(target: Path) -> None:
    """Refuse to replace a map by one that knows nothing of what a person decided about it."""
    if (target / EDITS).exists():
        raise UsageError(
            f"{target}: its {EDITS} holds a person's decisions, which a new map would lose: keep "
            f"them with --like {target}, or move the file away"
        )


def _pictures(directory: Path, config: Config, *, overwrite: bool) -> Observer:
    """An observer that draws every test that may split a submap."""
    from specmap_cli.pipelines.split_test_pictures import split_test_pictures

    return split_test_pictures(directory, config.segmentation, overwrite=overwrite)


@one_blas_thread()
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

    def begin() -> Exploration:
        from specmap_cli.pipelines.exploration import Exploration

        return Exploration(config, store, clock, observer)

    # what only the exploration knew is gone after it
    explored, tracking = explore_log(stream, config, begin, accepts, progress)
    refuse_empty(store, stream, tracking)
    from specmap_cli.pipelines.finishing import finish

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
    begin: Callable[[], Exploration],
    accepts: Accepts,
    progress: Progress,
) -> tuple[Explored, Tracking]:
    """Track and explore a log: registration runs ahead where there is a second processor.

    What `begin` takes to load is loaded meanwhile.
    """
    progress.note(stream.selection.note)
    progress.start("mapping", stream.expected)
    with ahead(lambda: track(stream, config.registration)) as scans:
        exploration = begin()
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
