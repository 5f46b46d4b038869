"""What a log holds, which of it `build` would use, and the command to run next."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from typing import Any

from specmap_cli.core.config import LogConfig
from specmap_cli.core.errors import InputError, UsageError
from specmap_cli.core.geometry import FloatArray, yaw_of
from specmap_cli.core.records import Sweep
from specmap_cli.logs.frames import read_tree
from specmap_cli.logs.readers.recording import Contents, Log, TopicInfo
from specmap_cli.logs.readers.typestore import LASER_SCAN, NS_PER_S, ODOMETRY, SCAN_TYPES
from specmap_cli.logs.stream import SweepStream
from specmap_cli.logs.transforms import TransformTree

_EARLIEST_DATE_S = 315_532_800  # 1980: smaller stamps count from somewhere else


@dataclass(frozen=True, slots=True)
class TopicSummary:
    """A topic; `rate_hz` over the whole log, 0 for a single message."""

    name: str
    type: str
    count: int
    rate_hz: float


@dataclass(frozen=True, slots=True)
class FrameSummary:
    """A transform parent_from_child; a `moving` one is given as it first was."""

    parent: str
    child: str
    xyz_m: tuple[float, float, float]
    roll_pitch_yaw_deg: tuple[float, float, float]
    moving: bool


@dataclass(frozen=True, slots=True)
class ScanSummary:
    """The first usable scan: planar, or the one made of a 3D cloud of `points`."""

    topic: str
    frame: str
    beams: int
    field_of_view_deg: float
    full_circle: bool
    range_max_m: float
    point_times: bool
    points: int | None


@dataclass(frozen=True, slots=True)
class LogSummary:
    """The answer of `specmap info`; times are the recorder's.

    `chosen` says what `build` would read, or is None with the reason in `problem`. `next_command`
    is None when no command can use the log.
    """

    files: list[str]
    format: str
    size_bytes: int
    start_s: float
    end_s: float
    duration_s: float
    messages: int
    topics: list[TopicSummary]
    frames: list[FrameSummary]
    scan: ScanSummary | None
    chosen: str | None
    problem: str | None
    next_command: str | None
    warnings: list[str] = field(default_factory=list)
    damage: list[str] = field(default_factory=list)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON; an unknown maximum range is None."""
        plain = asdict(self)
        if self.scan is not None and not math.isfinite(self.scan.range_max_m):
            plain["scan"]["range_max_m"] = None
        return plain

    def lines(self) -> list[str]:
        """The summary as lines for people."""
        names = ", ".join(self.files[:3]) + (" ..." if len(self.files) > 3 else "")
        told = [
            f"{names}: {self.format}, {self.size_bytes / 1e6:.1f} MB",
            f"{self.messages:,} messages in {self.duration_s:.1f} s, "
            f"{_time(self.start_s)} to {_time(self.end_s)}",
            "topics:",
        ]
        width = max((len(topic.name) for topic in self.topics), default=0)
        for topic in self.topics:
            rate = f"  {topic.rate_hz:.1f} Hz" if topic.rate_hz >= 0.05 else ""
            told.append(f"  {topic.name:<{width}}  {topic.count:>8,}  {topic.type}{rate}")
        told += _frame_lines(self.frames, self.scan.frame if self.scan else None)
        if self.scan is not None:
            told.append(f"scan: {_scan(self.scan)}")
        if self.chosen is not None:
            told.append(f"build would read: {self.chosen}")
        told += [f"warning: {line}" for line in self.warnings]
        told += [f"damage: {line}" for line in self.damage]
        if self.problem is not None:
            told.append(f"problem: {self.problem}")
        if self.next_command is not None:
            told.append(f"next: {self.next_command}")
        return told


def summarize(log: Log, config: LogConfig | None = None) -> LogSummary:
    """Look at a log as `build` would; what `build` would refuse becomes `problem`."""
    settings = config or LogConfig()
    contents = log.contents
    scan = chosen = problem = None
    warnings: list[str] = []
    command: str | None = _command(log, "")
    try:
        stream = SweepStream(log, settings)
        chosen, tree, warnings = stream.selection.note, stream.selection.tree, stream.warnings
        first = next(iter(stream), None)
        if first is not None:
            scan = _describe(stream, first)
        else:
            problem, command = f"no usable scan on {stream.selection.scan_topic}", None
    except UsageError as error:
        problem, tree = str(error), read_tree(log, "", [])
        command = _command(log, _options(contents.topics, settings))
    except InputError as error:
        problem, tree, command = str(error), read_tree(log, "", []), None
    duration = (contents.end_ns - contents.start_ns) / NS_PER_S
    return LogSummary(
        files=[str(path) for path in log.paths],
        format=log.format,
        size_bytes=sum(path.stat().st_size for path in log.paths),
        start_s=contents.start_ns / NS_PER_S,
        end_s=contents.end_ns / NS_PER_S,
        duration_s=duration,
        messages=contents.messages,
        topics=_topics(contents, duration),
        frames=_frames(tree),
        scan=scan,
        chosen=chosen,
        problem=problem,
        next_command=command,
        warnings=[line for line in warnings if line not in log.damage],
        damage=list(log.damage),
    )


def _topics(contents: Contents, duration_s: float) -> list[TopicSummary]:
    return [
        TopicSummary(t.name, t.type, t.count, (t.count - 1) / duration_s)
        if t.count > 1 and duration_s > 0
        else TopicSummary(t.name, t.type, t.count, 0.0)
        for t in contents.topics
    ]


def _frames(tree: TransformTree) -> list[FrameSummary]:
    return [
        FrameSummary(parent, child, _xyz(matrix), _roll_pitch_yaw(matrix), moving)
        for parent, child, matrix, moving in tree.edges()
    ]


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
    if sweep.cloud is not None:
        times = sweep.cloud_times_s
        seen = ~(planar.ranges != planar.ranges)
        view = view if planar.full_circle else step * int(seen.sum())
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


def _command(log: Log, options: str) -> str:
    files = " ".join(shlex.quote(str(path)) for path in log.given)
    return f"specmap build {files}{options}"


def _time(seconds: float) -> str:
    if seconds < _EARLIEST_DATE_S:
        return f"{seconds:.3f} s"
    return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")


def _frame_lines(frames: list[FrameSummary], scan_frame: str | None) -> list[str]:
    """The frames above the scan's, and how many others there are; all without a scan."""
    by_child = {frame.child: frame for frame in frames}
    chain: list[FrameSummary] = []
    while scan_frame in by_child and len(chain) < len(frames):
        chain.append(by_child[scan_frame])
        scan_frame = by_child[scan_frame].parent
    shown = chain[::-1] or frames
    others = len(frames) - len(shown)
    told = ["frames:", *(f"  {_frame(frame)}" for frame in shown)] if frames else []
    return [*told, f"  and {others} other frames"] if others else told


def _frame(frame: FrameSummary) -> str:
    x, y, z = frame.xyz_m
    roll, pitch, yaw = frame.roll_pitch_yaw_deg
    if frame.moving:
        return f"{frame.parent} -> {frame.child}  moving"
    return (
        f"{frame.parent} -> {frame.child}  at ({x:g}, {y:g}, {z:g}) m, "
        f"roll {roll:g}, pitch {pitch:g}, yaw {yaw:g} degrees"
    )


def _scan(scan: ScanSummary) -> str:
    what = f"{scan.beams} beams" if scan.points is None else f"{scan.points:,} points"
    times = "with times" if scan.point_times else "all at one time"
    reach = f"up to {scan.range_max_m:g} m" if math.isfinite(scan.range_max_m) else "of any range"
    view = f"over {scan.field_of_view_deg:g} degrees"
    return f"{what} {view} in frame {scan.frame}, {reach}, {times}"
