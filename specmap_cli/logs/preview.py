"""What `build` will meet in a log: rate, spacing, gaps, blank scans, sensors and faulty stamps."""

from __future__ import annotations

from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from itertools import islice

import numpy as np

from specmap_cli.core.geometry import step_lengths
from specmap_cli.core.records import Sweep
from specmap_cli.core.text import counted, decimal
from specmap_cli.logs.checking import PAUSE_INTERVALS
from specmap_cli.logs.clocks import odometry_of
from specmap_cli.logs.first_scans import LOOK_SCANS
from specmap_cli.logs.messages import BadMessageError, decode_scan
from specmap_cli.logs.readers.recording import Message
from specmap_cli.logs.readers.typestore import NS_PER_S
from specmap_cli.logs.repeats import Repeats
from specmap_cli.logs.stream import SweepStream

_GAP_S = 1.0  # a gap between scans is told that is longer than this and a pause
_SPARSE_STEP_M = 0.25  # scans this far apart are called sparse: views change much between
_CLOUDS = 20  # read at the most, where not the whole log is: each takes as long as many scans
_MOST_MESSAGES = 5_000  # read for their stamps: odometry at 1 kHz for 5 s
_STANDING_M = 0.01  # a shorter step is noise, or a robot that stands
_NAMED_GAPS = 3  # in the words for people; all of them are in the JSON
_1990_S = 631_152_000  # no robot's log is older
DAY = timedelta(days=1)  # clocks of robot and reader may be in different time zones


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
            shown = f"such as {decimal(self.example_s, 3)} s{_date(self.example_s)}"
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
        told += self._gap_lines()
        if len(self.sensors) > 1:
            names = ", ".join(f"{name} ({count:,} scans)" for name, count in self.sensors)
            told.append(f"several sensors on the topic: {names}")
        told += [faults.text() for faults in self.stamps if faults.text()]
        return [f"build would meet, in {part} scans:", *(f"  {line}" for line in told)]

    def _gap_lines(self) -> Iterator[str]:
        if not self.gaps:
            return
        longest = sorted(self.gaps, key=lambda gap: (-gap.length_s, gap.at_s))[:_NAMED_GAPS]
        shown = ", ".join(f"{gap.length_s:.2f} s from {gap.at_s:.3f} s on" for gap in longest)
        which = "the longest " if len(self.gaps) > len(longest) else ""
        yield f"{counted(len(self.gaps), 'gap')} between scans: {which}{shown}"


def preview(stream: SweepStream, *, complete: bool = False) -> tuple[Preview | None, Sweep | None]:
    """Read the first scans, or all of them, as `build` would; the preview and the first sweep.

    None twice when there is no usable scan among them.
    """
    is_cloud = stream.selection.scan.sensor.is_cloud
    most = min(LOOK_SCANS, _CLOUDS) if is_cloud else LOOK_SCANS
    first: Sweep | None = None
    stamps, places = array("q"), array("d")
    readings = invalid = stale = 0
    repeats = Repeats()
    for sweep in islice(stream, None if complete else most):
        first = sweep if first is None else first
        stamps.append(max(-(1 << 62), min(sweep.stamp_ns, (1 << 62) - 1)))
        pose = sweep.odom_from_base
        places.extend((np.nan, np.nan) if pose is None else (pose.x, pose.y))
        readings += len(sweep.planar.ranges)
        invalid += int(np.isnan(sweep.planar.ranges).sum())
        stale += repeats.stale(sweep)
    if first is None:
        return None, None
    times = np.array(stamps, dtype=np.int64)
    found = Preview(
        scans=len(times),
        blank_scans=stream.counts["blank_scans"],
        stale_scans=stale,
        invalid_share=None if is_cloud else invalid / max(readings, 1),
        spacing=_spacing(times, np.array(places).reshape(-1, 2)),
        gaps=_gaps(times),
        sensors=tuple((sensor.name, sensor.count) for sensor in stream.selection.scan.sensors),
        stamps=tuple(_faults(stream, None if complete else most)),
    )
    return found, first


def _spacing(
    stamps_ns: np.ndarray[tuple[int], np.dtype[np.int64]],
    places: np.ndarray[tuple[int, int], np.dtype[np.float64]],
) -> Spacing:
    """The rate by the median interval, 0 without any, and the median step that is motion."""
    ahead = np.diff(stamps_ns)[np.diff(stamps_ns) > 0]
    rate = round(NS_PER_S / float(np.median(ahead)), 6) if len(ahead) else 0.0
    steps = step_lengths(places)
    moving = steps[steps > _STANDING_M]  # false for NaN as well
    if not len(moving):
        return Spacing(rate)
    step = round(float(np.median(moving)), 6)
    return Spacing(rate, step, step >= _SPARSE_STEP_M)


def _gaps(stamps_ns: np.ndarray[tuple[int], np.dtype[np.int64]]) -> tuple[Gap, ...]:
    """The steps ahead that are longer than `_GAP_S`, and than some usual ones."""
    steps = np.diff(stamps_ns) / NS_PER_S
    ahead = steps[steps > 0]
    if not len(ahead):
        return ()
    limit = max(_GAP_S, PAUSE_INTERVALS * float(np.median(ahead)))
    return tuple(
        Gap(round(float(steps[n]), 6), round(float(stamps_ns[n]) / NS_PER_S, 6))
        for n in np.flatnonzero(steps > limit)
    )


def _faults(stream: SweepStream, scans: int | None) -> Iterator[StampFaults]:
    """The faults of header stamps on the topics of scans and odometry, of the first or of all."""
    chosen = stream.selection
    topics = [chosen.scan_topic, *chosen.odom_topics]
    heard = {topic: _Stamps() for topic in topics}
    most = None if scans is None else _MOST_MESSAGES
    for message in islice(stream.log.messages(topics), most):
        try:
            stamp = _stamp(message, chosen.scan_topic, chosen.odometry_source.frame)
        except BadMessageError:
            continue
        if stamp is not None:
            heard[message.topic].take(stamp)
        if scans is not None and heard[chosen.scan_topic].count >= scans:
            break
    for topic, stamps in heard.items():
        yield stamps.faults(topic)


def _stamp(message: Message, scan_topic: str, odometry_frame: str | None) -> int | None:
    if message.topic == scan_topic:
        return decode_scan(message).stamp_ns
    heard = odometry_of(message, odometry_frame)
    return None if heard is None else heard[0]


class _Stamps:
    """Counts the faults of the stamps on one topic."""

    def __init__(self) -> None:
        self.count = self.zero = self.repeated = self.backward = self.elsewhen = 0
        self._example: int | None = None
        self._last: int | None = None
        self._latest_s = (datetime.now(UTC) + DAY).timestamp()

    def take(self, stamp_ns: int) -> None:
        """Count a stamp."""
        self.count += 1
        self.zero += stamp_ns == 0
        if self._last is not None and stamp_ns:
            self.repeated += stamp_ns == self._last
            self.backward += stamp_ns < self._last
        if stamp_ns and not _1990_S <= stamp_ns / NS_PER_S <= self._latest_s:
            self.elsewhen += 1
            self._example = stamp_ns if self._example is None else self._example
        self._last = stamp_ns

    def faults(self, topic: str) -> StampFaults:
        """What was counted."""
        example = None if self._example is None else round(self._example / NS_PER_S, 6)
        return StampFaults(
            topic=topic,
            messages=self.count,
            zero=self.zero,
            repeated=self.repeated,
            backward=self.backward,
            elsewhen=self.elsewhen,
            example_s=example,
        )


def _date(seconds: float) -> str:
    """A day for stamps that are one, such as those of the year 2106."""
    try:
        return f" ({datetime.fromtimestamp(seconds, UTC):%Y-%m-%d})" if seconds > _1990_S else ""
    except (ValueError, OverflowError, OSError):  # beyond the year 9999
        return ""
