"""From a recorded log to a map directory: the order of the stages."""

from __future__ import annotations

import platform
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

from specmap_cli import __version__
from specmap_cli.core.config import Config
from specmap_cli.core.errors import NoResultError
from specmap_cli.core.geometry import Pose2
from specmap_cli.core.progress import Progress, Silent
from specmap_cli.core.records import PosedScan
from specmap_cli.core.text import counted, legible
from specmap_cli.drawing.overview import render_overview
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.g2o import write_g2o
from specmap_cli.logs import Log, open_log
from specmap_cli.logs.selection import Selection
from specmap_cli.logs.stream import SweepStream
from specmap_cli.maps.directory import OutputDirectory
from specmap_cli.maps.store import MapResult, write_map
from specmap_cli.pipelines.finishing import FinishedMap, finish_map
from specmap_cli.pipelines.mapper import Mapper
from specmap_cli.pipelines.split_test_pictures import TestAlbum
from specmap_cli.pipelines.worker import ahead
from specmap_cli.topology.regions import divide
from specmap_cli.topology.topological_map import LogInfo

_LIBRARIES = ("kiss-icp", "mcap", "numpy", "opencv-python-headless", "rosbags", "scipy")


@dataclass(frozen=True, slots=True)
class BuildReport:
    """What `build` did, for a person and for a machine."""

    out: Path
    run: dict[str, Any]

    def as_dict(self) -> dict[str, Any]:
        """The counts and the directory."""
        return {"out": str(self.out), **self.run["counts"], "warnings": self.run["warnings"]}

    def lines(self) -> list[str]:
        """A summary in two lines."""
        counts = self.run["counts"]
        return [
            f"{self.out}: {counted(counts['submaps'], 'submap')}, "
            f"{counted(counts['edges'], 'edge')}, "
            f"{counted(counts['merges'], 'revisit')} recognised; "
            f"{counted(counts['scans'], 'scan')} over "
            f"{counts['path_m']:.0f} m, {counts['lost']} lost",
            f"look at {self.out / 'overview.png'}",
        ]


def build_map(
    logs: Sequence[Path],
    out: Path,
    config: Config,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
    explain: Path | None = None,
) -> BuildReport:
    """Build the map of a recording and write it to the directory `out`, complete or not at all.

    `explain` is a directory for a picture of every test that may split a submap.

    Raises UsageError for an output that cannot be written or topics that must be chosen, LogError
    for a recording that cannot be used, NoResultError when no scan could be registered.
    """
    progress = progress or Silent()
    with (
        open_log(logs) as log,
        OutputDirectory(out, overwrite) as partial,
        KeyframeStore() as store,
    ):
        observer = None
        if explain is not None:
            observer = TestAlbum(explain, config.segmentation, overwrite=overwrite)
        stream = SweepStream(log, config.log)
        progress.note(stream.selection.note)
        mapper = Mapper(config, store, progress, observer)
        progress.start("mapping", stream.expected)
        tracking = _Tracking()
        with ahead(lambda: _registered(stream, mapper)) as scans:
            for scan in scans:
                if isinstance(scan, _Tracking):
                    tracking = scan
                    continue
                mapper.take(scan)
                progress.advance()
        mapper.clock.seconds["registration"] = tracking.seconds
        mapper.finish()
        if not len(store):
            found = "; ".join(tracking.warnings) or "too few returns in them"
            raise NoResultError(
                f"{log.name}: none of {counted(stream.expected, 'scan')} could be registered "
                f"({found}): look at them with `specmap info`"
            )
        finished = finish_map(mapper, progress)
        run = _run_record(logs, stream.selection, tracking, mapper, finished)
        for warning in run["warnings"]:
            progress.warn(warning)
        write_map(partial, _result(log, finished, run))
    return BuildReport(out, run)


@dataclass(frozen=True, slots=True)
class _Tracking:
    """What reading and registration have to tell when the log is at its end."""

    counts: dict[str, int] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    seconds: float = 0.0


def _registered(stream: SweepStream, mapper: Mapper) -> Iterator[PosedScan | _Tracking]:
    """Every scan of the log registered, then how it went."""
    for sweep in stream:
        yield mapper.register(sweep)
    counts = {**stream.counts, **mapper.front_end.counts}
    yield _Tracking(counts, stream.warnings, mapper.clock.seconds.get("registration", 0.0))


def _result(log: Log, finished: FinishedMap, run: dict[str, Any]) -> MapResult:
    stamps = finished.trajectory.stamps_ns
    info = LogInfo(legible(Path(log.name).name), int(stamps.min()), int(stamps.max()), len(stamps))
    topology, regions = finished.topology, divide(finished.grid, finished.labels)
    return MapResult(
        topology=topology,
        regions=regions,
        trajectory=finished.trajectory,
        labels=finished.labels,
        classifiers=finished.classifiers,
        log=info,
        run=run,
        pose_graph=write_g2o(finished.layout),
        overview=render_overview(topology, regions, finished.trajectory, finished.labels, info),
    )


def _run_record(
    logs: Sequence[Path],
    selection: Selection,
    tracking: _Tracking,
    mapper: Mapper,
    finished: FinishedMap,
) -> dict[str, Any]:
    """The contents of run.json."""
    counts = {
        "scans": len(finished.trajectory.stamps_ns),
        "keyframes": len(mapper.store),
        "submaps": len(finished.topology.submaps),
        "edges": len(finished.topology.edges),
        "merges": sum(closure.merged for closure in finished.topology.closures),
        "path_m": round(finished.path_m, 3),
        **tracking.counts,
    }
    return {
        "inputs": [path.name for path in logs],
        "selection": _selected(selection),
        "config": mapper.config.model_dump(),
        "versions": {
            "specmap": __version__,
            "python": platform.python_version(),
            **{name: version(name) for name in _LIBRARIES},
        },
        "counts": counts,
        "seconds": {name: round(value, 3) for name, value in mapper.clock.seconds.items()},
        "warnings": [*tracking.warnings, *finished.layout.warnings],
    }


def _selected(selection: Selection) -> dict[str, Any]:
    """Which topics and frames were read."""
    mounting = Pose2.from_matrix(selection.base_from_laser)
    return {
        "scan_topic": selection.scan_topic,
        "scan_type": selection.scan_type,
        "odometry": selection.odometry,
        "odom_topics": list(selection.odom_topics),
        "base_frame": selection.base_frame,
        "laser_frame": selection.laser_frame,
        "base_from_laser": [round(value, 6) for value in mounting],
        "height_band_m": selection.band_m,
    }
