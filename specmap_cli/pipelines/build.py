"""From a recorded log to a topological map: Algorithm 1 of the paper, and what follows it.

Brunskill, Kollar and Roy, "Topological Mapping Using Spectral Clustering and Classification"
(IROS 2007). While the log lasts: track, segment, recognise. After it: relax, turn, refute,
divide, assess, learn, write.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

from specmap_cli.core.errors import NoResultError, Paths, UsageError, instance_of, path_of, paths_of
from specmap_cli.core.process import one_blas_thread
from specmap_cli.core.progress import Progress, Silent
from specmap_cli.core.records import PosedScan
from specmap_cli.core.settings import Config
from specmap_cli.core.text import counted
from specmap_cli.core.worker import ahead
from specmap_cli.grids.keyframes import KeyframeSelector, KeyframeStore
from specmap_cli.logs import open_log
from specmap_cli.logs.stream import SweepStream
from specmap_cli.maps.directory import OutputDirectory, refuse_inside
from specmap_cli.pipelines.session import Session
from specmap_cli.pipelines.tracking import TrajectoryRecorder, track
from specmap_cli.recognition.features.sets import check_feature_sets

if TYPE_CHECKING:  # slow to load: it is, while the other process reads and registers
    from specmap_cli.pipelines.exploration import Exploration
    from specmap_cli.pipelines.learning import Prior
    from specmap_cli.pipelines.map_in_making import Explored, FinishedMap, LaidOut
    from specmap_cli.pipelines.reports import BuildReport
    from specmap_cli.segmentation.online import Observer, Occasion, SplitTest

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
    with (
        open_log(given, config.log) as log,
        OutputDirectory(target, overwrite, progress) as partial,
        KeyframeStore() as store,
    ):
        session = Session(config, store, progress)
        observer = None if pictures is None else _pictures(pictures, config, overwrite=overwrite)
        stream = SweepStream(log, config.log)
        finished = map_log(session, stream, observer=observer)
        from specmap_cli.pipelines.finishing import write_made
        from specmap_cli.pipelines.reports import BuildReport

        run = write_made(session, partial, finished, log.given, stream.selection)
    return BuildReport(out=target, run=run, quality=finished.quality)


@one_blas_thread()
def map_log(
    session: Session,
    stream: SweepStream,
    *,
    accepts: Accepts | None = None,
    observer: Observer | None = None,
) -> FinishedMap:
    """The map of a log, its keyframes in the store of the session.

    `accepts` says of each scan, in turn, whether it is a keyframe; by default the settings say it.
    `observer` is told of every test that may split a submap. Raises NoResultError when the log
    left no keyframe, or none that fits the grid.
    """
    laid, prior = survey(session, stream, accepts=accepts, observer=observer)
    from specmap_cli.pipelines.finishing import finish

    return finish(session, laid, prior)


def survey(
    session: Session,
    stream: SweepStream,
    *,
    accepts: Accepts | None = None,
    observer: Observer | None = None,
) -> tuple[LaidOut, Prior]:
    """A log explored and laid out by itself, and what is known before it is learned.

    Registration runs ahead where there is a second processor. The arguments, and what it raises,
    are those of `map_log`.
    """
    config = session.config
    check_feature_sets(config)
    session.progress.note(stream.selection.note)
    for warning in stream.selection.warnings:  # before the work, which may be in vain
        session.progress.warn(warning)
    session.progress.start("mapping", stream.selection.topic.count)
    with ahead(lambda: track(stream, config.registration)) as scans:
        from specmap_cli.pipelines.exploration import Exploration  # all are loaded meanwhile
        from specmap_cli.pipelines.laying_out import lay_out
        from specmap_cli.pipelines.learning import Prior

        accepts = accepts or KeyframeSelector(config.keyframes).accepts
        explored = explore(scans, Exploration(session, observer), accepts)
        tracking = scans.result
    session.clock.seconds["registration"] = tracking.seconds
    if not len(session.store):
        found = "; ".join(tracking.warnings) or "too few returns in them"
        all_ = counted(stream.selection.topic.count, "scan")
        raise NoResultError(
            f"none of {all_} could be registered ({found})",
            "look at them with `specmap info`",
            where=stream.log.name,
        )
    return lay_out(session, explored, tracking, stream.log.name), Prior(explored.features)


def explore(scans: Iterable[PosedScan], exploration: Exploration, accepts: Accepts) -> Explored:
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
        exploration.session.progress.advance()
    exploration.recognise(exploration.end_submap())
    exploration.recognise_again()
    return exploration.explored(trajectory.trajectory())


def _pictures(folder: Path, config: Config, *, overwrite: bool) -> Observer:
    """An observer that draws each test as test_0001.png, ...; UsageError where it cannot write."""
    from specmap_cli.drawing.split_tests import draw_test
    from specmap_cli.grids.map_server import write_png

    try:
        folder.mkdir(parents=True, exist_ok=True)
        old = sorted(folder.glob("test_*.png"))
        if old and not overwrite:
            raise UsageError(
                "holds pictures of an earlier run",
                "use --overwrite to replace them, or another directory",
                where=folder,
            )
        for picture in old:
            picture.unlink()
    except OSError as error:
        raise UsageError(
            f"cannot write pictures there: {error.strerror}",
            "choose another directory",
            mark=";",
            where=folder,
        ) from None
    numbers = count(1)

    def draw(test: SplitTest, split: bool, occasion: Occasion) -> None:
        if test.grid.cells.size:  # one outside the grid has nothing to show
            picture = draw_test(test, config.segmentation.split_eigenvalue, split, occasion)
            write_png(folder / f"test_{next(numbers):04d}.png", picture)

    return draw
