"""The answer of `specmap info`: what a log holds, as values and as lines for people."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime, timedelta
from typing import Any

from specmap_cli.core.text import counted, decimal, legible
from specmap_cli.logs.readers.recording import TopicInfo

DAY = timedelta(days=1)  # clocks of robot and reader may be in different time zones
EARLIEST_STAMP_S = 631_152_000  # 1990: no robot's log is older
_EARLIEST_DATE_S = 315_532_800  # 1980: smaller stamps count from somewhere else
_NAMED_FILES = 3  # of a split recording, in the summary's first line
_NAMED_GAPS = 3  # in the words for people; all of them are in the JSON
_LEAST_RATE_HZ = 0.05  # a lower one would be shown as 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Pauses:
    """Pauses between the messages of a topic: how many, and the longest with its beginning."""

    count: int = 0
    longest_s: float = 0.0
    longest_at_s: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicCheck:
    """What came of reading a topic to its end.

    `expected` is the number that the file counts, `read` how many were read, `unusable` how many of
    these cannot be decoded. `steps_back` counts messages whose stamp is earlier than that of the
    message before, `repeats` those with the same stamp.
    """

    name: str
    type: str
    read: int
    expected: int
    unusable: int = 0
    pauses: Pauses = field(default_factory=Pauses)
    steps_back: int = 0
    repeats: int = 0

    def text(self) -> str:
        """The result in words, without the name."""
        told = [f"{self.read:,} of {counted(self.expected, 'message')} read"]
        if self.unusable:
            told.append(f"{self.unusable:,} unusable")
        if self.pauses.count:
            told.append(
                f"{counted(self.pauses.count, 'pause')}, the longest {self.pauses.longest_s:.2f} s "
                f"from {self.pauses.longest_at_s:.3f} s on"
            )
        if self.steps_back:
            told.append(f"stamps earlier than the stamp before: {self.steps_back:,}")
        if self.repeats:
            told.append(f"stamps equal to the stamp before: {self.repeats:,}")
        return "; ".join(told)


@dataclass(frozen=True, slots=True)
class Spacing:
    """How scans follow one another: scans a second, metres between, whether these are many.

    The median step while the robot moves, by odometry; None where nothing is known of it.
    """

    rate_hz: float
    step_m: float | None = None
    is_sparse: bool = False

    def text(self) -> str:
        """The spacing in words."""
        if self.step_m is None:
            return f"{self.rate_hz:.1f} scans a second"
        sparse = ": sparse, so that much depends on the odometry" if self.is_sparse else ""
        step = f"{self.step_m:.2f} m from one to the next while the robot moves"
        return f"{self.rate_hz:.1f} scans a second, {step}{sparse}"


@dataclass(frozen=True, slots=True)
class Gap:
    """A gap between two scans: its length, and the stamp at which it begins, seconds."""

    length_s: float
    at_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class StampFaults:
    """What is wrong with the header stamps on a topic, among the `messages` that were read.

    `elsewhen` counts stamps before 1990 or in the future that are not zero, `example_s` is one.
    """

    topic: str
    messages: int = 0
    zero: int = 0
    repeated: int = 0
    backward: int = 0
    elsewhen: int = 0
    example_s: float | None = None

    def text(self) -> str:
        """The faults in words; empty without any."""
        told = [
            f"{what}: {count:,}"
            for what, count in (
                ("zero", self.zero),
                ("equal to the stamp before", self.repeated),
                ("earlier than the stamp before", self.backward),
            )
            if count
        ]
        if self.example_s is not None:
            shown = f"such as {decimal(self.example_s, 3)} s"
            if self.example_s > EARLIEST_STAMP_S:  # it is a day, such as one of the year 2106
                shown += f" ({datetime.fromtimestamp(self.example_s, UTC):%Y-%m-%d})"
            told.append(f"before 1990 or in the future: {self.elsewhen:,}, {shown}")
        if not told:
            return ""
        return f"stamps on {self.topic}, of {counted(self.messages, 'message')}: {'; '.join(told)}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Preview:
    """What `build` will meet, by the first `scans` of the chosen sensor, or by all of them.

    `stale_scans` only repeat others, see `Repeats`. `invalid_share` is that of readings which say
    nothing, None for clouds. `sensors` are the sensors of the topic with their numbers among the
    scans that were looked at.
    """

    scans: int
    blank_scans: int
    stale_scans: int
    invalid_share: float | None
    spacing: Spacing
    gaps: tuple[Gap, ...] = ()
    sensors: tuple[tuple[str, int], ...] = ()
    stamps: tuple[StampFaults, ...] = ()

    def lines(self, of: int) -> list[str]:
        """The preview in words for people; `of` is the number of scans on the topic."""
        part = f"the first {self.scans:,} of {of:,}" if self.scans < of else f"{self.scans:,}"
        told = [self.spacing.text()]
        if self.blank_scans:
            told.append(f"blank scans, without any return: {self.blank_scans:,}")
        if self.stale_scans:
            repeating = "scans that repeat the one before while the robot moves"
            told.append(f"{repeating}: {self.stale_scans:,}")
        if self.invalid_share:
            told.append(f"readings that are invalid: {100 * self.invalid_share:.1f} %")
        if self.gaps:
            longest = sorted(self.gaps, key=lambda gap: (-gap.length_s, gap.at_s))[:_NAMED_GAPS]
            shown = ", ".join(f"{gap.length_s:.2f} s from {gap.at_s:.3f} s on" for gap in longest)
            which = "the longest " if len(self.gaps) > len(longest) else ""
            told.append(f"{counted(len(self.gaps), 'gap')} between scans: {which}{shown}")
        if len(self.sensors) > 1:
            names = ", ".join(f"{name} ({count:,} scans)" for name, count in self.sensors)
            told.append(f"several sensors on the topic: {names}")
        told += [faults.text() for faults in self.stamps if faults.text()]
        return [f"build would meet, in {part} scans:", *(f"  {line}" for line in told)]


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicSummary(TopicInfo):
    """A topic; `rate_hz` over the whole log, 0 for a single message."""

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

    def text(self) -> str:
        """The scan in words."""
        what = f"{self.beams} beams" if self.points is None else f"{self.points:,} points"
        times = "with times" if self.point_times else "all at one time"
        reach = "of any range"
        if math.isfinite(self.range_max_m):
            reach = f"up to {self.range_max_m:g} m"
        view = f"over {self.field_of_view_deg:g} degrees"
        return f"{what} {view} in frame {self.frame}, {reach}, {times}"


@dataclass(frozen=True, slots=True, kw_only=True)
class LogSummary:
    """The answer of `specmap info`: how much is in which files, and what build would read.

    Times are the recorder's. `chosen` is what `build` would read, `problem` what keeps it from
    reading; `next_command` is None when no command can use the log. `checked` is None when only the
    first messages were read.
    """

    files: tuple[str, ...]
    format: str
    size_bytes: int
    messages: int
    start_s: float = 0.0
    end_s: float
    duration_s: float = 0.0
    chosen: str | None = None
    problem: str | None = None
    next_command: str | None = None
    warnings: tuple[str, ...] = ()
    topics: tuple[TopicSummary, ...] = ()
    frames: tuple[FrameSummary, ...] = ()
    scan: ScanSummary | None = None
    checked: tuple[TopicCheck, ...] | None = None
    preview: Preview | None = None
    damage: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON; an unknown maximum range is None."""
        plain = asdict(self)
        if self.scan is not None and not math.isfinite(self.scan.range_max_m):
            plain["scan"]["range_max_m"] = None
        return plain

    def lines(self) -> list[str]:
        """The summary as lines for people."""
        more = " ..." if len(self.files) > _NAMED_FILES else ""
        files = ", ".join(self.files[:_NAMED_FILES]) + more
        told = [
            f"{files}: {self.format}, {self.size_bytes / 1e6:.1f} MB",
            f"{counted(self.messages, 'message')} in {self.duration_s:.1f} s, "
            f"{_time(self.start_s)} to {_time(self.end_s)}",
            "topics:",
        ]
        width = max((len(legible(topic.name)) for topic in self.topics), default=0)
        for topic in self.topics:
            rate = f"  {topic.rate_hz:.1f} Hz" if topic.rate_hz >= _LEAST_RATE_HZ else ""
            told.append(f"  {legible(topic.name):<{width}}  {topic.count:>8,}  {topic.type}{rate}")
        told += _frame_lines(self.frames, self.scan.frame if self.scan else None)
        if self.scan is not None:
            told.append(f"scan: {self.scan.text()}")
        if self.chosen is not None:
            told.append(f"build would read: {self.chosen}")
        if self.preview is not None and self.scan is not None:
            scans = sum(each.count for each in self.topics if each.name == self.scan.topic)
            told += self.preview.lines(scans)
        if self.checked is None:
            only = "only the beginning; --check reads all messages and compares the counts"
            told.append(f"checked: {only}")
        else:
            told.append("checked: all messages")
            width = max((len(legible(topic.name)) for topic in self.checked), default=0)
            told += [f"  {legible(each.name):<{width}}  {each.text()}" for each in self.checked]
        told += [f"warning: {line}" for line in self.warnings]
        told += [f"damage: {line}" for line in self.damage]
        if self.problem is not None:
            told.append(f"problem: {self.problem}")
        if self.next_command is not None:
            told.append(f"next: {self.next_command}")
        return [legible(line) for line in told]


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
    told = ["frames:"] if frames else []
    for frame in shown:
        x, y, z = frame.xyz_m
        roll, pitch, yaw = frame.roll_pitch_yaw_deg
        fixed = f"at ({x:g}, {y:g}, {z:g}) m, roll {roll:g}, pitch {pitch:g}, yaw {yaw:g} degrees"
        when = "on /tf, first " if frame.moving else ""
        told.append(f"  {frame.parent} -> {frame.child}  {when}{fixed}")
    return [*told, f"  and {counted(others, 'other frame')}"] if others else told
