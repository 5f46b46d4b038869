"""Which topic is read, and which sensor on it: several lasers may speak on the same one.

A sensor is a frame. Where one frame holds two kinds of scans by turns, whose fields of view overlap
and begin or end elsewhere, each kind is a sensor: no laser turns to and fro between two scans.
Fields of view side by side are segments of one laser, and a laser whose number of beams varies, or
whose field of view is set anew once, stays one.
"""

from __future__ import annotations

import math
import shlex
from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import combinations, islice, pairwise
from typing import NamedTuple

import numpy as np

from specmap_cli.core.errors import CHOICE, UsageError
from specmap_cli.core.geometry import FloatArray, product
from specmap_cli.core.settings import LogConfig
from specmap_cli.core.text import counted, legible
from specmap_cli.logs.clouds import CLOUD_RANGE_MAX_M, cloud_points, floor_of
from specmap_cli.logs.messages import (
    BadMessageError,
    CloudRecord,
    ScanLayout,
    ScanRecord,
    decode_scan,
)
from specmap_cli.logs.opening import Log
from specmap_cli.logs.planar import ScanLeveller, covers_circle, increment
from specmap_cli.logs.readers.encoding import SCAN_TYPES
from specmap_cli.logs.readers.recording import TopicInfo, refused


def choose_scan_topic(log: Log, asked: str | None) -> TopicInfo:
    """The topic of scans: the asked one, or the only one."""
    chosen = choose_topic(log, SCAN_TYPES, asked, "--scan-topic", "scans")
    if chosen is None:
        there = ", ".join(f"{t.name} ({t.type})" for t in log.topics()) or "no messages at all"
        none = f"no LaserScan, MultiEchoLaserScan or PointCloud2 in it; it has {there}"
        raise refused(legible(log.name), legible(none))
    return chosen


def topics_beside(log: Log, types: Collection[str], scan_topic: str) -> list[TopicInfo]:
    """Topics of such types; where some are in a namespace of the scans, no other robot's."""
    found = [topic for topic in log.topics() if topic.type in types]
    spaces = {topic: topic.name.strip("/").rpartition("/")[0] for topic in found}
    own = [t for t in found if spaces[t] and scan_topic.lstrip("/").startswith(spaces[t] + "/")]
    return [topic for topic in found if topic in own or not spaces[topic]] if own else found


def choose_topic(
    log: Log,
    types: Collection[str],
    asked: str | None,
    option: str,
    what: str,
    scan_topic: str = "",
) -> TopicInfo | None:
    """The topic of such types that is asked for, or the only one; None when there is none.

    Where none is asked for, topics of other robots than that of `scan_topic` do not count.
    """
    found = {
        topic: f"({topic.type.rpartition('/')[2]}, {counted(topic.count, 'message')})"
        for topic in topics_beside(log, types, scan_topic if asked is None else "")
        if topic.count
    }
    if asked is not None:
        for topic in found:
            if topic.name.lstrip("/") == asked.lstrip("/"):
                return topic
        choices = ", ".join(f"{topic.name} {told}" for topic, told in found.items()) or "none"
        none = f"{option} {asked}: no {what} on such a topic"
        raise _unclear(log.name, f"{none}; topics with {what}: {choices}")
    if len(found) > 1:
        choices = " or ".join(f"`{option} {topic.name}` {told}" for topic, told in found.items())
        several, hint = f"{len(found)} topics carry {what}", f"choose {choices}"
        raise _unclear(log.name, several, hint, code=CHOICE)
    return next(iter(found), None)


def _unclear(log: str, found: str, hint: str = "", code: str | None = None) -> UsageError:
    """The error of options that choose nothing in a log, or too little."""
    return UsageError(legible(found), legible(hint) or None, where=legible(log), code=code)


_SENSOR_SHARE = 0.1  # share of the first scans; a rarer sensor is left out without a question
# Scans of one frame that begin or end this much apart by turns: two lasers.
_SENSOR_ANGLE_RAD = 0.0873
_BY_TURNS = 3  # scans of each kind at least: fewer may be damaged ones


class View(NamedTuple):
    """The bearings of the first and the last beam, ascending, radians in the laser's own frame."""

    low: float
    high: float

    def near(self, other: View) -> bool:
        """Whether both ends lie within `_SENSOR_ANGLE_RAD` of each other."""
        off = max(abs(self.low - other.low), abs(self.high - other.high))
        return off <= _SENSOR_ANGLE_RAD

    def shared_with(self, other: View) -> float:
        """How much of both is the same, radians; negative where they lie apart."""
        return min(self.high, other.high) - max(self.low, other.low)


class FirstScan(NamedTuple):
    """What is kept of a scan at the beginning of a log: times, frame, layout (None: a cloud)."""

    stamp_ns: int
    time_ns: int
    frame: str
    layout: ScanLayout | None


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanSensor:
    """A sensor of a topic. `name` is what `--scan-frame` calls it: its frame, or `frame#number`.

    `count` is how many of the scans looked at are its own. `view` is set where the frame has
    several sensors; a scan is of this one when its own view is near. Its scans are whole, or so
    many `segments` of a turn, one after the other.
    """

    name: str
    frame: str
    count: int
    is_cloud: bool
    view: View | None = None
    segments: int = 1

    def made(self, record: ScanRecord | CloudRecord | FirstScan) -> bool:
        """Whether a scan is of this sensor."""
        layout = record.layout
        if record.frame != self.frame or (layout is None) != self.is_cloud:
            return False
        if self.view is None or layout is None:
            return True
        view = view_of(layout)
        return view is not None and self.view.near(view)


class SeveralSensorsError(UsageError):
    """One topic carries several sensors, and none was chosen; `best` is the one with most scans."""

    code = CHOICE
    best = ""


def view_of(layout: ScanLayout) -> View | None:
    """The field of view of a scan, -pi to pi for a full circle; None without angles."""
    try:
        step = increment(layout)
    except BadMessageError:
        return None
    if covers_circle(layout.beams, step):
        return View(-math.pi, math.pi)
    last = layout.angle_min + step * (layout.beams - 1)
    return View(min(layout.angle_min, last), max(layout.angle_min, last))


def sensors_of(scans: Iterable[FirstScan]) -> list[ScanSensor]:
    """The sensors among the scans that were looked at, in the order in which they appear."""
    groups: dict[tuple[str, bool], list[FirstScan]] = {}
    for scan in scans:
        groups.setdefault((scan.frame, scan.layout is None), []).append(scan)
    found = []
    for (frame, is_cloud), group in groups.items():
        kinds, segments = _kinds([scan.layout for scan in group if scan.layout is not None])
        if len(kinds) < 2:
            alone = ScanSensor(
                name=frame, frame=frame, count=len(group), is_cloud=is_cloud, segments=segments
            )
            found.append(alone)
            continue
        for number, (view, count) in enumerate(kinds, start=1):
            name = f"{frame}#{number}"
            found.append(ScanSensor(name=name, frame=frame, count=count, is_cloud=False, view=view))
    return found


def _kinds(layouts: Sequence[ScanLayout]) -> tuple[list[tuple[View, int]], int]:
    """The fields of view that overlap and take turns in one frame, and how often each is met.

    Also how many take turns side by side: segments of one turn; 1 where the scans are whole.
    """
    views: list[View] = []
    turns: list[int] = []  # the number of the view of each scan
    for view in filter(None, map(view_of, layouts)):
        number = next((n for n, other in enumerate(views) if other.near(view)), len(views))
        if number == len(views):
            views.append(view)
        turns.append(number)
    counts = Counter(turns)
    least = max(_BY_TURNS, _SENSOR_SHARE * len(layouts))
    often = [n for n in range(len(views)) if counts[n] >= least]
    found = []
    for number in often:
        view = views[number]
        for other in filter(number.__ne__, often):
            both = [turn for turn in turns if turn in (number, other)]
            changes = sum(a != b for a, b in pairwise(both))
            by_turns = 2 * changes >= min(counts[number], counts[other])
            if by_turns and view.shared_with(views[other]) > _SENSOR_ANGLE_RAD:
                found.append((view, counts[number]))
                break
    met = [view for number, view in enumerate(views) if counts[number] >= _BY_TURNS]
    beside = all(a.shared_with(b) <= _SENSOR_ANGLE_RAD for a, b in combinations(met, 2))
    takes_turns = 2 * sum(a != b for a, b in pairwise(turns)) >= len(turns)
    return found, len(met) if beside and takes_turns and met else 1


def choose_sensor(
    log: str, topic: str, sensors: Sequence[ScanSensor], config: LogConfig
) -> ScanSensor:
    """The sensor that the settings name, or the only one with more than a small share of scans.

    Raises UsageError with the sensors ready to paste.
    """
    total, asked = sum(sensor.count for sensor in sensors), config.scan_frame
    if asked is not None:
        wanted = asked.lstrip("/")
        chosen = next((s for s in sensors if s.name == wanted), None)
        if chosen is not None:
            return chosen
        known = ", ".join(_told(sensor, total) for sensor in sensors)
        nothing = f"--scan-frame {asked}: no scans of such a sensor; there are {known}"
        raise _unclear(log, f"{topic}: {nothing}")
    often = [s for s in sensors if s.count >= _SENSOR_SHARE * total]
    candidates = often or list(sensors)
    if len(candidates) == 1:
        return candidates[0]
    choices = " or ".join(f"`--scan-frame {_told(s, total, '`')}" for s in candidates)
    several = legible(f"{topic}: {len(candidates)} sensors on one topic")
    error = SeveralSensorsError(several, legible(f"choose {choices}"), where=legible(log))
    error.best = max(candidates, key=lambda sensor: sensor.count).name
    raise error


def _told(sensor: ScanSensor, total: int, end: str = "") -> str:
    """`laser (5 of the first 10 scans)`, with the view in degrees where the frame has several."""
    view = ""
    if sensor.view is not None:
        low, high = (math.degrees(bearing) for bearing in sensor.view)
        view = f"{low:.0f} to {high:.0f} degrees, "
    return f"{shlex.quote(sensor.name)}{end} ({view}{sensor.count:,} of the first {total:,} scans)"


TRIED_MESSAGES = 50  # messages of a topic tried in search of one that can be read
LOOK_SCANS = 100  # first scans looked at: which sensors share the topic, what stamps are worth
_FLAT_M = 0.02  # heights of a planar laser's points, which a driver may round
_FLAT_POINTS = 30  # fewer tell nothing of a lidar
_FLOOR_CLOUDS = 5  # first clouds whose floor is held against the mounting
_LOOK_BYTES = 32_000_000  # of messages that are looked at: some twenty clouds


def first_scans(log: Log, topic: TopicInfo) -> list[FirstScan]:
    """The first scans that can be decoded; raises LogError where none of the first can be."""
    found: list[FirstScan] = []
    reason, size = "it holds no message", 0
    for tried, message in enumerate(log.messages([topic.name]), start=1):
        size += len(message.data)
        try:
            record = decode_scan(message)
            times = record.stamp_ns, message.time_ns
            found.append(FirstScan(*times, record.frame, record.layout))
        except BadMessageError as error:
            reason = f"{error}; tried {counted(tried, 'message')}"
        most = LOOK_SCANS if found else TRIED_MESSAGES
        if tried >= most or (found and size >= _LOOK_BYTES):
            break
    if not found:
        none = f"{topic.name}: no usable scan: {reason}"
        raise refused(legible(log.name), legible(none))
    return found


_MOST_RAD = 2.0 * math.tau  # a scan that looks all round spans half of it; in degrees, 360


class Glance(NamedTuple):
    """What the first scans of one sensor show.

    `has_height` says that its clouds are not of a planar laser, whose points have one height.
    `tilt_rad` and `floor_m` are the angle of the floor that they show against the base and its
    height there, None where they show none. `ceilings_m` are the distances that stand for no
    return, `warnings` what is odd about ranges and angles.
    """

    has_height: bool
    tilt_rad: float | None
    floor_m: float | None
    ceilings_m: tuple[float, ...]
    warnings: tuple[str, ...]


def glance(log: Log, topic: TopicInfo, sensor: ScanSensor, base_from_laser: FloatArray) -> Glance:
    """Look at the first scans of one sensor, one in memory at a time.

    `base_from_laser` (4, 4) is its mounting.
    """
    leveller = ScanLeveller(np.eye(4))
    size = points = 0
    has_height, middle_m, span_rad = False, math.nan, math.nan
    for message in islice(log.messages([topic.name]), LOOK_SCANS):
        size += len(message.data)
        with suppress(BadMessageError):
            record = decode_scan(message)
            if sensor.made(record):
                middle_m = _middle_m(record) if math.isnan(middle_m) else middle_m
                if isinstance(record, ScanRecord):
                    if math.isnan(span_rad):
                        span_rad = abs(increment(record.layout)) * (record.layout.beams - 1)
                    leveller.level(record, record.stamp_ns)
                else:
                    heights = cloud_points(record, record.stamp_ns).points[:, 2]
                    points += len(heights)
                    has_height = len(heights) > 0 and float(np.ptp(heights)) > _FLAT_M
        if has_height or size >= _LOOK_BYTES:
            break
    far = (
        f"half of the returns of the first scan on {topic.name} are farther than "
        f"{middle_m:,.0f} m: are they in millimetres or centimetres? They must be in metres"
    )
    wide = (
        f"the angles of the first scan on {topic.name} span {span_rad:,.0f} radians, more than a "
        "turn: are they in degrees? They must be in radians"
    )
    segments = (
        f"the scans are {sensor.segments} segments of a turn, one after the other: each is "
        "registered alone, and sees little; let the driver, or a node behind it, send whole turns"
    )
    unknown = None, None
    tilt_rad, floor_m = _clear_floor(log, topic, sensor, base_from_laser) if has_height else unknown
    return Glance(
        has_height=sensor.is_cloud and (has_height or points < _FLAT_POINTS),
        tilt_rad=tilt_rad,
        floor_m=floor_m,
        ceilings_m=leveller.ceiling.values_m,
        warnings=(
            *((far,) if middle_m > CLOUD_RANGE_MAX_M else ()),
            *((wide,) if span_rad > _MOST_RAD else ()),
            *((segments,) if sensor.segments > 1 else ()),
        ),
    )


def _clear_floor(
    log: Log, topic: TopicInfo, sensor: ScanSensor, base_from_laser: FloatArray
) -> tuple[float | None, float | None]:
    """The angle of a clear floor in the first clouds against the base, and its height there.

    The least of each that a cloud shows, None where none does. The height is that of the floor's
    returns: where the plane meets the base, it errs more.
    """
    tilts, heights = list[float](), list[float]()
    turn, place = base_from_laser[:3, :3], base_from_laser[:3, 3]
    for message in islice(log.messages([topic.name]), _FLOOR_CLOUDS):
        with suppress(BadMessageError):
            record = decode_scan(message)
            if isinstance(record, CloudRecord) and sensor.made(record):
                points = cloud_points(record, record.stamp_ns).points
                level = floor_of(product(points, turn.T))
                if level is not None and level.clear:
                    tilts.append(math.acos(min(1.0, float(level.rotation[2, 2]))))
                    heights.append(level.seen_m + float(place[2]))
    return min(tilts, default=None), min(heights, key=abs, default=None)


def _middle_m(record: ScanRecord | CloudRecord) -> float:
    """The median of the returns as recorded, whatever their unit; NaN without any."""
    if isinstance(record, CloudRecord):
        xyz = [record.points[axis].ravel().astype(np.float64) for axis in "xyz"]
        ranges = np.sqrt(sum(np.square(column) for column in xyz))
    else:
        ranges = record.ranges.astype(np.float64)
    ranges = ranges[np.isfinite(ranges) & (ranges > 0.0)]
    if isinstance(record, ScanRecord) and (ranges <= record.range_max).any():
        ranges = ranges[ranges <= record.range_max]  # else the range may be in metres, they not
    return float(np.median(ranges)) if len(ranges) else math.nan
