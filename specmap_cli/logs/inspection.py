"""Looking at a log as `build` would: what it holds, and which command to run next."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from specmap_cli.core.arguments import instance_of
from specmap_cli.core.errors import InputError, UsageError
from specmap_cli.core.geometry import FloatArray, yaw_of
from specmap_cli.core.progress import Progress
from specmap_cli.core.records import Sweep
from specmap_cli.core.settings import LogConfig
from specmap_cli.logs.checking import check
from specmap_cli.logs.frames import read_frames
from specmap_cli.logs.log import Log
from specmap_cli.logs.preview import Preview, preview
from specmap_cli.logs.readers.recording import Contents, TopicInfo
from specmap_cli.logs.readers.typestore import LASER_SCAN, NS_PER_S, ODOMETRY, SCAN_TYPES
from specmap_cli.logs.sensors import SeveralSensorsError
from specmap_cli.logs.stream import SweepStream
from specmap_cli.logs.summary import (
    Extent,
    FrameSummary,
    LogSummary,
    Outlook,
    ScanSummary,
    TopicSummary,
)
from specmap_cli.logs.transforms import TransformTree


def summarize(
    log: Log,
    config: LogConfig | None = None,
    *,
    complete: bool = False,
    progress: Progress | None = None,
) -> LogSummary:
    """Look at a log as `build` would; what `build` would refuse becomes `problem`.

    Messages are counted as the file counts them, and only the first ones are read. With `complete`
    all of them are read, too, and compared with the counts.

    Raises TypeError for what is no `Log` or no `LogConfig`.
    """
    instance_of(log, Log, "log")
    settings = LogConfig() if config is None else instance_of(config, LogConfig, "config")
    scan, tree, outlook, met = _look(log, settings, complete=complete)
    checked = check(log, progress) if complete else None
    extent = _extent(log)
    return LogSummary(
        extent=extent,
        topics=_topics(log.contents, extent.duration_s),
        frames=_frames(tree),
        scan=scan,
        outlook=outlook,
        checked=checked,
        preview=met,
        damage=tuple(log.damage),
    )


class _Look(NamedTuple):
    """The first scan that `build` would read, the frames, and what would come of it."""

    scan: ScanSummary | None
    tree: TransformTree
    outlook: Outlook
    met: Preview | None = None


def _look(log: Log, config: LogConfig, *, complete: bool) -> _Look:
    """Read the first scans as `build` would."""
    try:
        stream = SweepStream(log, config)
        met, first = preview(stream, complete=complete)
    except UsageError as error:
        command = _command(log, _likeliest(log, error, config))
        problem = Outlook(problem=str(error), next_command=command)
        return _Look(None, _frames_alone(log, config), problem)
    except InputError as error:
        return _Look(None, _frames_alone(log, config), Outlook(problem=str(error)))
    chosen = stream.selection
    nothing = None if first is not None else f"no usable scan on {chosen.scan_topic}"
    outlook = Outlook(
        chosen=chosen.note,
        problem=nothing,
        next_command=_command(log, _given(config)) if nothing is None else None,
        warnings=(
            *chosen.warnings,
            *_lonely(stream),
            *stream.ceiling.notes,
            *stream.own_body.notes,
        ),
    )
    scan = _describe(stream, first) if first is not None else None
    return _Look(scan, chosen.tree, outlook, met)


def _lonely(stream: SweepStream) -> Iterator[str]:
    """That most scans have no odometry, although the log has some."""
    without, scans = stream.counts["without_odometry"], stream.counts["scans"]
    if 2 * without > scans:
        yield f"scans without odometry near their stamp: {without:,} of {scans:,}"


def _frames_alone(log: Log, config: LogConfig) -> TransformTree:
    return read_frames(log, "", [], config).tree


def _extent(log: Log) -> Extent:
    contents = log.contents
    return Extent(
        files=tuple(str(path) for path in log.paths),
        format=log.format,
        size_bytes=sum(path.stat().st_size for path in log.paths),
        messages=contents.messages,
        start_s=contents.start_ns / NS_PER_S,
        end_s=contents.end_ns / NS_PER_S,
        duration_s=(contents.end_ns - contents.start_ns) / NS_PER_S,
    )


def _topics(contents: Contents, duration_s: float) -> tuple[TopicSummary, ...]:
    return tuple(
        TopicSummary(
            name=topic.name,
            type=topic.type,
            count=topic.count,
            rate_hz=(topic.count - 1) / duration_s if topic.count > 1 and duration_s > 0 else 0.0,
        )
        for topic in contents.topics
    )


def _frames(tree: TransformTree) -> tuple[FrameSummary, ...]:
    return tuple(
        FrameSummary(
            parent=parent,
            child=child,
            xyz_m=_xyz(matrix),
            roll_pitch_yaw_deg=_roll_pitch_yaw(matrix),
            moving=moving,
        )
        for parent, child, matrix, moving in tree.edges()
    )


def _xyz(matrix: FloatArray) -> tuple[float, float, float]:
    x, y, z = (round(float(value), 6) + 0.0 for value in matrix[:3, 3])
    return x, y, z


def _roll_pitch_yaw(matrix: FloatArray) -> tuple[float, float, float]:
    """Angles of the rotation Rz(yaw) Ry(pitch) Rx(roll), degrees."""
    roll = math.atan2(float(matrix[2, 1]), float(matrix[2, 2]))
    pitch = math.asin(min(max(-float(matrix[2, 0]), -1.0), 1.0))
    angles = (roll, pitch, yaw_of(matrix))
    roll, pitch, yaw = (round(math.degrees(angle), 4) + 0.0 for angle in angles)
    return roll, pitch, yaw


def _describe(stream: SweepStream, sweep: Sweep) -> ScanSummary:
    planar, times = sweep.planar, sweep.planar.beam_times_s
    bearings = planar.bearings
    step = float(bearings[1] - bearings[0]) if len(bearings) > 1 else 0.0
    view = 2.0 * math.pi if planar.full_circle else float(bearings[-1] - bearings[0])
    if stream.selection.scan.sensor.is_cloud and not planar.full_circle:
        view = step * int((~np.isnan(planar.ranges)).sum())
    if sweep.cloud is not None:
        times = sweep.cloud_times_s
    return ScanSummary(
        topic=stream.selection.scan_topic,
        frame=stream.selection.laser_frame,
        beams=len(bearings),
        field_of_view_deg=round(math.degrees(view), 2),
        full_circle=planar.full_circle,
        range_max_m=round(planar.range_max, 3),
        point_times=times is not None,
        points=None if sweep.cloud is None else len(sweep.cloud),
    )


def _options(topics: Iterable[TopicInfo], config: LogConfig) -> str:
    """The options that make the likeliest choice where there are several."""
    chosen = []
    scans = [t for t in topics if t.type in SCAN_TYPES and t.count]
    if scans and (len(scans) > 1 or config.scan_topic is not None):
        best = max(scans, key=lambda t: (t.type == LASER_SCAN, t.count))
        chosen.append(f" --scan-topic {shlex.quote(best.name)}")
    poses = [t for t in topics if t.type == ODOMETRY and t.count]
    if len(poses) > 1:
        best = max(poses, key=lambda t: t.count)
        chosen.append(f" --odom-topic {shlex.quote(best.name)}")
    return "".join(chosen)


def _likeliest(log: Log, error: UsageError, config: LogConfig) -> str:
    """The options that make the likeliest choice after an error that asks for one."""
    if isinstance(error, SeveralSensorsError):
        return _given(config.model_copy(update={"scan_frame": error.best}))
    return _options(log.contents.topics, config)


def _given(config: LogConfig) -> str:
    """The options that choose the topics and the frame as `config` does."""
    choices = {
        "--scan-topic": config.scan_topic,
        "--scan-frame": config.scan_frame,
        "--odom-topic": config.odom_topic,
        "--base-frame": config.base_frame,
    }
    named = [f" {key} {shlex.quote(name)}" for key, name in choices.items() if name is not None]
    return "".join(named) + ("" if config.use_odometry else " --no-odometry")


def _command(log: Log, options: str) -> str:
    files = " ".join(shlex.quote(str(path)) for path in log.given)
    return f"specmap build {files}{options}"
