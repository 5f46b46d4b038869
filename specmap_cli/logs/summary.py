"""The answer of `specmap info`: what a log holds, as values and as lines for people."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import Any

from specmap_cli.core.text import counted, legible
from specmap_cli.logs.checking import TopicCheck
from specmap_cli.logs.preview import DAY, Preview

_EARLIEST_DATE_S = 315_532_800  # 1980: smaller stamps count from somewhere else
_NAMED_FILES = 3  # of a split recording, in the summary's first line
_LEAST_RATE_HZ = 0.05  # a lower one would be shown as 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicSummary:
    """A topic; `rate_hz` over the whole log, 0 for a single message."""

    name: str
    type: str
    count: int
    rate_hz: float


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameSummary:
    """A transform parent_from_child; a `moving` one is given as it first was."""

    parent: str
    child: str
    xyz_m: tuple[float, float, float]
    roll_pitch_yaw_deg: tuple[float, float, float]
    moving: bool


@dataclass(frozen=True, slots=True, kw_only=True)
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Extent:
    """The files of a log and how much is in them; times are the recorder's."""

    files: tuple[str, ...]
    format: str
    size_bytes: int
    messages: int
    start_s: float
    end_s: float
    duration_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Outlook:
    """What `build` would read (`chosen`), or the `problem` that keeps it from reading.

    `next_command` is None when no command can use the log.
    """

    chosen: str | None = None
    problem: str | None = None
    next_command: str | None = None
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class LogSummary:
    """The answer of `specmap info`; `checked` is None when only the first messages were read."""

    extent: Extent
    topics: tuple[TopicSummary, ...]
    frames: tuple[FrameSummary, ...]
    scan: ScanSummary | None
    outlook: Outlook
    checked: tuple[TopicCheck, ...] | None = None
    preview: Preview | None = None
    damage: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON, on one level; an unknown maximum range is None."""
        plain = asdict(self)
        plain = {**plain.pop("extent"), **plain.pop("outlook"), **plain}
        if self.scan is not None and not math.isfinite(self.scan.range_max_m):
            plain["scan"]["range_max_m"] = None
        return plain

    def lines(self) -> list[str]:
        """The summary as lines for people."""
        told = [*_extent_lines(self.extent), "topics:"]
        width = max((len(legible(topic.name)) for topic in self.topics), default=0)
        for topic in self.topics:
            rate = f"  {topic.rate_hz:.1f} Hz" if topic.rate_hz >= _LEAST_RATE_HZ else ""
            told.append(f"  {legible(topic.name):<{width}}  {topic.count:>8,}  {topic.type}{rate}")
        told += _frame_lines(self.frames, self.scan.frame if self.scan else None)
        if self.scan is not None:
            told.append(f"scan: {_scan_text(self.scan)}")
        if self.outlook.chosen is not None:
            told.append(f"build would read: {self.outlook.chosen}")
        if self.preview is not None and self.scan is not None:
            told += self.preview.lines(self._scans_on(self.scan.topic))
        told += _checked_lines(self.checked)
        told += [f"warning: {line}" for line in self.outlook.warnings]
        told += [f"damage: {line}" for line in self.damage]
        if self.outlook.problem is not None:
            told.append(f"problem: {self.outlook.problem}")
        if self.outlook.next_command is not None:
            told.append(f"next: {self.outlook.next_command}")
        return [legible(line) for line in told]

    def _scans_on(self, topic: str) -> int:
        """How many messages a topic holds."""
        return sum(each.count for each in self.topics if each.name == topic)


def _extent_lines(extent: Extent) -> list[str]:
    """Which files, how much is in them, and when it was recorded."""
    more = " ..." if len(extent.files) > _NAMED_FILES else ""
    files = ", ".join(extent.files[:_NAMED_FILES]) + more
    return [
        f"{files}: {extent.format}, {extent.size_bytes / 1e6:.1f} MB",
        f"{counted(extent.messages, 'message')} in {extent.duration_s:.1f} s, "
        f"{_time(extent.start_s)} to {_time(extent.end_s)}",
    ]


def _checked_lines(checked: Sequence[TopicCheck] | None) -> list[str]:
    """What came of reading all messages, or that only the first ones were read."""
    if checked is None:
        return ["checked: only the beginning; --check reads all messages and compares the counts"]
    width = max((len(legible(topic.name)) for topic in checked), default=0)
    lines = [f"  {legible(topic.name):<{width}}  {topic.text()}" for topic in checked]
    return ["checked: all messages", *lines]


def _time(seconds: float) -> str:
    if seconds < _EARLIEST_DATE_S:
        return f"{seconds:.3f} s"
    date = datetime.fromtimestamp(seconds, UTC)
    future = " (in the future)" if date > datetime.now(UTC) + DAY else ""
    return date.strftime("%Y-%m-%d %H:%M:%S UTC") + future


def _frame_lines(frames: Sequence[FrameSummary], scan_frame: str | None) -> list[str]:
    """The frames above the scan's, and how many others there are; all without a scan."""
    by_child = {frame.child: frame for frame in frames}
    chain: list[FrameSummary] = []
    while scan_frame in by_child and len(chain) < len(frames):
        chain.append(by_child[scan_frame])
        scan_frame = by_child[scan_frame].parent
    shown = chain[::-1] or list(frames)
    others = len(frames) - len(shown)
    told = ["frames:", *(f"  {_frame_text(frame)}" for frame in shown)] if frames else []
    return [*told, f"  and {counted(others, 'other frame')}"] if others else told


def _frame_text(frame: FrameSummary) -> str:
    x, y, z = frame.xyz_m
    roll, pitch, yaw = frame.roll_pitch_yaw_deg
    if frame.moving:
        return f"{frame.parent} -> {frame.child}  moving"
    return (
        f"{frame.parent} -> {frame.child}  at ({x:g}, {y:g}, {z:g}) m, "
        f"roll {roll:g}, pitch {pitch:g}, yaw {yaw:g} degrees"
    )


def _scan_text(scan: ScanSummary) -> str:
    what = f"{scan.beams} beams" if scan.points is None else f"{scan.points:,} points"
    times = "with times" if scan.point_times else "all at one time"
    reach = f"up to {scan.range_max_m:g} m" if math.isfinite(scan.range_max_m) else "of any range"
    view = f"over {scan.field_of_view_deg:g} degrees"
    return f"{what} {view} in frame {scan.frame}, {reach}, {times}"
