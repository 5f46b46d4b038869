"""Looking at a log as `build` would: what it holds, and which command to run next."""

from __future__ import annotations

import math
import shlex
from array import array
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from itertools import islice

import numpy as np

from specmap_cli.core.errors import InputError, UsageError, instance_of
from specmap_cli.core.geometry import step_lengths, yaw_of
from specmap_cli.core.progress import Progress, Silent
from specmap_cli.core.records import IntArray, Sweep
from specmap_cli.core.settings import LogConfig
from specmap_cli.core.text import legible
from specmap_cli.logs import summary
from specmap_cli.logs.clocks import MOST_MESSAGES, odometry_of
from specmap_cli.logs.clouds import cloud_points
from specmap_cli.logs.messages import BadMessageError, CloudRecord, decode_scan
from specmap_cli.logs.opening import Log
from specmap_cli.logs.planar import Repeats
from specmap_cli.logs.readers.encoding import (
    LASER_SCAN,
    NS_PER_S,
    ODOMETRY,
    SCAN_TYPES,
    TF_MESSAGE,
    TF_STATIC,
)
from specmap_cli.logs.readers.recording import Message, time_text
from specmap_cli.logs.selection import Selection, TransformTree, read_frames
from specmap_cli.logs.sensors import LOOK_SCANS, SeveralSensorsError, topics_beside
from specmap_cli.logs.stream import SweepStream

_PAUSE_INTERVALS = 5.0  # a pause is told that is so many usual intervals, medians, long
_GAP_S = 1.0  # a gap between scans is told that is longer than this and a pause
_SPARSE_STEP_M = 0.25  # scans this far apart are called sparse: views change much between
_CLOUDS = 20  # read at the most, where not the whole log is: each takes as long as many scans
_STANDING_M = 0.01  # a shorter step is noise, or a robot that stands
_STAMP_LIMIT_NS = (1 << 62) - 1  # differences of such stamps fit into 64 bits; they end in 2116


def summarize(
    log: Log,
    config: LogConfig | None = None,
    *,
    complete: bool = False,
    progress: Progress | None = None,
) -> summary.LogSummary:
    """Look at a log as `build` would; what `build` would refuse becomes `problem`.

    Messages are counted as the file counts them, and only the first ones are read. With `complete`
    all of them are read, too, and compared with the counts.

    Raises TypeError for what is no `Log` or no `LogConfig`.
    """
    instance_of(log, Log, "log")
    settings = LogConfig() if config is None else instance_of(config, LogConfig, "config")
    told, chosen = _look(log, settings, complete=complete)
    reading = _read(log, chosen if told.preview is not None else None, progress, complete=complete)
    start_ns, odd = _start_of(log)
    duration_s = (log.contents.end_ns - start_ns) / NS_PER_S
    return replace(
        told,
        start_s=start_ns / NS_PER_S,
        duration_s=duration_s,
        warnings=(*odd, *told.warnings),
        topics=tuple(
            summary.TopicSummary(
                *(topic.name, topic.type, topic.count),
                rate_hz=max(topic.count - 1, 0) / duration_s if duration_s > 0 else 0.0,
            )
            for topic in log.contents.topics
        ),
        checked=_checked(log, reading) if complete else None,
        preview=told.preview and replace(told.preview, stamps=tuple(_faults(reading))),
        damage=tuple(log.damage),
    )


def _start_of(log: Log) -> tuple[int, list[str]]:
    """When a log begins, ns, and a line of topics whose recorder's clock had not been set."""
    earliest_ns, contents = summary.EARLIEST_STAMP_S * NS_PER_S, log.contents
    if not contents.start_ns < earliest_ns <= contents.end_ns:
        return contents.start_ns, []
    first = {
        topic.name: message.time_ns
        for topic in contents.topics
        for message in islice(log.messages([topic.name]), 1)
    }
    usual = [time_ns for time_ns in first.values() if time_ns >= earliest_ns]
    if not usual:
        return contents.start_ns, []
    # a fixed transform holds at all times, and is often written with none
    odd = [name for name, time_ns in first.items() if time_ns < earliest_ns and name != TF_STATIC]
    if not odd:
        return min(usual), []
    told = f"recorded at {time_text(first[odd[0]])}: {', '.join(map(legible, odd))}; the times "
    return min(usual), [f"{told}of the log are those of the other topics"]


def _look(
    log: Log, config: LogConfig, *, complete: bool
) -> tuple[summary.LogSummary, Selection | None]:
    """What the first scans, or all, tell when read as `build` would; and what it would read."""
    told = summary.LogSummary(
        files=tuple(str(path) for path in log.paths),
        format=log.format,
        size_bytes=sum(path.stat().st_size for path in log.paths),
        messages=log.contents.messages,
        end_s=log.contents.end_ns / NS_PER_S,
    )
    try:
        stream = SweepStream(log, config)
        met, first = _preview(stream, complete=complete)
    except (InputError, UsageError) as error:
        command = None
        if isinstance(error, UsageError):
            config = _likeliest(log, error, config)
            command = _command(log, config)
        frames = tuple(_frames(read_frames(log, config, config.scan_topic or "")[0]))
        return replace(told, frames=frames, problem=str(error), next_command=command), None
    chosen = stream.selection
    warnings = [*chosen.warnings]
    without, scans = stream.counts["without_odometry"], stream.counts["scans"]
    if 2 * without > scans:  # although the log has some
        warnings.append(f"scans without odometry near their stamp: {without:,} of {scans:,}")
    warnings += [*stream.ceiling.notes, *stream.own_body.notes]
    seen = replace(
        told,
        chosen=chosen.note,
        frames=tuple(_frames(chosen.tree)),
        problem=f"no usable scan on {chosen.topic.name}" if first is None else None,
        next_command=_command(log, config) if first is not None else None,
        warnings=tuple(warnings),
        scan=_describe(chosen, first) if first is not None else None,
        preview=met,
    )
    return seen, chosen


def _preview(stream: SweepStream, *, complete: bool) -> tuple[summary.Preview | None, Sweep | None]:
    """What the first scans, or all, tell but for their stamps; the first sweep; or None twice."""
    first: Sweep | None = None
    stamps, places = array("q"), array("d")
    readings = invalid = stale = 0
    repeats = Repeats()
    for sweep in islice(stream, None if complete else _most_scans(stream.selection)):
        first = sweep if first is None else first
        stamps.append(_clipped(sweep.stamp_ns))
        pose = sweep.odom_from_base
        places.extend((np.nan, np.nan) if pose is None else (pose.x, pose.y))
        readings += len(sweep.planar.ranges)
        invalid += int(np.isnan(sweep.planar.ranges).sum())
        stale += repeats.stale(sweep)
    if first is None:
        return None, None
    steps = _Steps(stamps)
    ahead = steps.steps_ns[steps.steps_ns > 0]
    rate_hz = round(NS_PER_S / float(np.median(ahead)), 6) if len(ahead) else 0.0
    lengths = step_lengths(np.array(places).reshape(-1, 2))
    moving = lengths[lengths > _STANDING_M]  # false for NaN as well
    step_m = round(float(np.median(moving)), 6) if len(moving) else None
    is_cloud = stream.selection.sensor.is_cloud
    found = summary.Preview(
        scans=len(stamps),
        blank_scans=stream.counts["blank_scans"],
        stale_scans=stale,
        invalid_share=None if is_cloud else invalid / max(readings, 1),
        spacing=summary.Spacing(rate_hz, step_m, step_m is not None and step_m >= _SPARSE_STEP_M),
        gaps=tuple(
            summary.Gap(*steps.told(n))
            for n in steps.longer_than(max(_GAP_S, _PAUSE_INTERVALS * steps.usual_s))
        ),
        sensors=tuple((sensor.name, sensor.count) for sensor in stream.selection.sensors),
    )
    return found, first


def _most_scans(selection: Selection) -> int:
    return min(LOOK_SCANS, _CLOUDS) if selection.sensor.is_cloud else LOOK_SCANS


def _clipped(stamp_ns: int) -> int:
    return max(-_STAMP_LIMIT_NS, min(stamp_ns, _STAMP_LIMIT_NS))


class _Steps:
    """The steps in time from one stamp (ns) to the next; `usual_s` is the median of those ahead."""

    def __init__(self, stamps_ns: array[int]) -> None:
        self.stamps_ns: IntArray = np.array(stamps_ns, dtype=np.int64)
        self.steps_ns: IntArray = np.diff(self.stamps_ns)
        ahead = self.steps_ns[self.steps_ns > 0]
        self.usual_s = float(np.median(ahead / NS_PER_S)) if len(ahead) else math.inf

    def longer_than(self, seconds: float) -> list[int]:
        """The numbers of the steps that take longer."""
        return [int(n) for n in np.flatnonzero(self.steps_ns / NS_PER_S > seconds)]

    def told(self, number: int) -> tuple[float, float]:
        """How long a step takes, and the stamp at which it begins, seconds."""
        length, begin = self.steps_ns[number], self.stamps_ns[number]
        return round(float(length / NS_PER_S), 6), round(float(begin) / NS_PER_S, 6)


class _Reading:
    """Stamps of all topics by name and type, header stamps of those chosen, what is unusable."""

    def __init__(self, chosen: Selection | None) -> None:
        topics = (chosen.topic.name, *chosen.odom_topics) if chosen is not None else ()
        self.headers_ns = {topic: array("q") for topic in topics}
        self.stamps_ns: defaultdict[tuple[str, str], array[int]] = defaultdict(lambda: array("q"))
        self.unusable: Counter[tuple[str, str]] = Counter()


def _read(
    log: Log, chosen: Selection | None, progress: Progress | None, *, complete: bool
) -> _Reading:
    """The stamps of all messages, or of the first ones on the topics that build would read."""
    reading = _Reading(chosen)
    messages: Iterator[Message] = iter(())
    told = Silent() if progress is None else progress
    if complete:
        told.start("reading", log.contents.messages)
        messages = log.messages()
    elif chosen is not None:
        messages = islice(log.messages(list(reading.headers_ns)), MOST_MESSAGES)
    for message in messages:
        name, kind = message.topic, message.type
        is_scan, stamp = kind in SCAN_TYPES, None
        try:
            if is_scan:
                record = decode_scan(message)
                stamp = record.stamp_ns
                if isinstance(record, CloudRecord):
                    cloud_points(record, stamp)
            elif kind in (ODOMETRY, TF_MESSAGE):
                pose = odometry_of(message, chosen.odom_frame if chosen else None)
                stamp = None if pose is None else pose.stamp_ns
        except BadMessageError:
            reading.unusable[name, kind] += 1
        of_scans = chosen is not None and name == chosen.topic.name
        if stamp is not None and name in reading.headers_ns and is_scan == of_scans:
            reading.headers_ns[name].append(stamp)
        stamp = None if kind == TF_MESSAGE else stamp
        reading.stamps_ns[name, kind].append(_clipped(stamp or message.time_ns))
        if complete:
            told.advance()
        elif chosen and len(reading.headers_ns[chosen.topic.name]) >= _most_scans(chosen):
            break
    return reading


def _checked(log: Log, reading: _Reading) -> tuple[summary.TopicCheck, ...]:
    """What came of reading all messages, in the order of `log.contents`."""
    expected = {(topic.name, topic.type): topic.count for topic in log.contents.topics}
    checks = []
    for key in sorted(expected.keys() | reading.stamps_ns.keys()):
        steps = _Steps(reading.stamps_ns[key])
        pauses = steps.longer_than(_PAUSE_INTERVALS * steps.usual_s)
        told = summary.Pauses()
        if pauses:
            longest_s, at_s = steps.told(int(np.argmax(steps.steps_ns)))
            told = summary.Pauses(count=len(pauses), longest_s=longest_s, longest_at_s=at_s)
        checks.append(
            summary.TopicCheck(
                name=key[0],
                type=key[1],
                read=len(steps.stamps_ns),
                expected=expected.get(key, 0),
                unusable=reading.unusable[key],
                pauses=told,
                steps_back=int((steps.steps_ns < 0).sum()),
                repeats=int((steps.steps_ns == 0).sum()),
            )
        )
    return tuple(checks)


def _faults(reading: _Reading) -> Iterator[summary.StampFaults]:
    """What is wrong with the header stamps on the topics that build would read."""
    latest_s = (datetime.now(UTC) + summary.DAY).timestamp()
    for topic, headers in reading.headers_ns.items():
        stamps = np.array(headers, dtype=np.int64)
        steps, is_set = np.diff(stamps), stamps != 0
        seconds = stamps / NS_PER_S
        elsewhen = is_set & ~((seconds >= summary.EARLIEST_STAMP_S) & (seconds <= latest_s))
        odd = np.flatnonzero(elsewhen)
        yield summary.StampFaults(
            topic=topic,
            messages=len(stamps),
            zero=int((~is_set).sum()),
            repeated=int(((steps == 0) & is_set[1:]).sum()),
            backward=int(((steps < 0) & is_set[1:]).sum()),
            elsewhen=len(odd),
            example_s=round(headers[int(odd[0])] / NS_PER_S, 6) if len(odd) else None,
        )


def _frames(tree: TransformTree) -> Iterator[summary.FrameSummary]:
    """The transforms; their angles are those of Rz(yaw) Ry(pitch) Rx(roll)."""
    for edge in tree.edges():
        matrix = edge.parent_from_child
        x, y, z = (round(float(value), 6) + 0.0 for value in matrix[:3, 3])
        roll = math.atan2(float(matrix[2, 1]), float(matrix[2, 2]))
        pitch = math.asin(min(max(-float(matrix[2, 0]), -1.0), 1.0))
        angles = (roll, pitch, yaw_of(matrix))
        roll, pitch, yaw = (round(math.degrees(angle), 4) + 0.0 for angle in angles)
        yield summary.FrameSummary(
            parent=edge.parent,
            child=edge.child,
            xyz_m=(x, y, z),
            roll_pitch_yaw_deg=(roll, pitch, yaw),
            moving=edge.child in tree.moving,
        )


def _describe(chosen: Selection, sweep: Sweep) -> summary.ScanSummary:
    planar, times = sweep.planar, sweep.planar.beam_times_s
    bearings = planar.bearings
    step = float(bearings[1] - bearings[0]) if len(bearings) > 1 else 0.0
    view = math.tau if planar.full_circle else float(bearings[-1] - bearings[0])
    if chosen.sensor.is_cloud and not planar.full_circle:
        view = step * int((~np.isnan(planar.ranges)).sum())
    if sweep.cloud is not None:
        times = sweep.cloud_times_s
    return summary.ScanSummary(
        topic=chosen.topic.name,
        frame=chosen.sensor.frame,
        beams=len(bearings),
        field_of_view_deg=round(math.degrees(view), 2),
        full_circle=planar.full_circle,
        range_max_m=round(planar.range_max, 3),
        point_times=times is not None,
        points=None if sweep.cloud is None else len(sweep.cloud),
    )


def _likeliest(log: Log, error: UsageError, config: LogConfig) -> LogConfig:
    """The settings of the likeliest choice after an error that asks for one."""
    chosen: dict[str, object] = {}
    if isinstance(error, SeveralSensorsError):
        chosen = {**config.model_dump(), "scan_frame": error.best}
        return LogConfig.model_validate(chosen)
    scans = [t for t in log.contents.topics if t.type in SCAN_TYPES and t.count]
    if scans and (len(scans) > 1 or config.scan_topic is not None):
        chosen["scan_topic"] = max(scans, key=lambda t: (t.type == LASER_SCAN, t.count)).name
    beside = topics_beside(log, {ODOMETRY}, str(chosen.get("scan_topic", "")))
    poses = [topic for topic in beside if topic.count]
    if len(poses) > 1:
        chosen["odom_topic"] = max(poses, key=lambda t: t.count).name
    return LogConfig.model_validate(chosen)


def _command(log: Log, config: LogConfig) -> str:
    """The command that builds a map, with the options that choose as `config` does."""
    choices = {
        "--scan-topic": config.scan_topic,
        "--scan-frame": config.scan_frame,
        "--odom-topic": config.odom_topic,
        "--base-frame": config.base_frame,
    }
    named = [f" {key} {shlex.quote(name)}" for key, name in choices.items() if name is not None]
    files = " ".join(shlex.quote(str(path)) for path in log.given)
    without = "" if config.use_odometry else " --no-odometry"
    return f"specmap build {files}{''.join(named)}{without}"
