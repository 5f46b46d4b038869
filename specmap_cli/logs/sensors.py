"""The sensors of one topic: a driver or a relay may let several lasers speak on the same one.

A sensor is a frame. Where one frame holds two kinds of scans by turns, whose fields of view overlap
and begin or end elsewhere, each kind is a sensor: no laser turns to and fro between two scans.
Fields of view side by side are segments of one laser, and a laser whose number of beams varies, or
whose field of view is set anew once, stays one.
"""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

from specmap_cli.core.errors import CHOICE, UsageError
from specmap_cli.core.settings import LogConfig
from specmap_cli.core.text import legible
from specmap_cli.logs.messages import BadMessageError, CloudRecord, ScanLayout, ScanRecord
from specmap_cli.logs.planar import covers_circle, increment

_SENSOR_SHARE = 0.1  # share of the first scans; a rarer sensor is left out without a question
# Scans of one frame that begin or end this much apart by turns: two lasers.
_SENSOR_ANGLE_RAD = 0.0873
_BY_TURNS = 3  # scans of each kind at least: fewer may be damaged ones


class View(NamedTuple):
    """The bearings of the first and the last beam, ascending, radians in the laser's own frame."""

    low: float
    high: float

    def near(self, other: View, angle: float) -> bool:
        """Whether both ends lie within an angle of each other."""
        return max(abs(self.low - other.low), abs(self.high - other.high)) <= angle

    def overlaps(self, other: View, angle: float) -> bool:
        """Whether the two share more than an angle."""
        return min(self.high, other.high) - max(self.low, other.low) > angle


class Glimpse(NamedTuple):
    """What is kept of a scan that was looked at: its times, frame and layout (None: a cloud)."""

    stamp_ns: int
    time_ns: int
    frame: str
    layout: ScanLayout | None


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanSensor:
    """A sensor of a topic. `name` is what `--scan-frame` calls it: its frame, or `frame#number`.

    `count` is how many of the scans looked at are its own. `view` is set where the frame has
    several sensors; a scan is of this one when both ends of its view are within `angle`.
    """

    name: str
    frame: str
    count: int
    is_cloud: bool
    view: View | None = None
    angle: float = 0.0

    def made(self, record: ScanRecord | CloudRecord | Glimpse) -> bool:
        """Whether a scan is of this sensor."""
        layout = None if isinstance(record, CloudRecord) else record.layout
        if record.frame != self.frame or (layout is None) != self.is_cloud:
            return False
        if self.view is None or layout is None:
            return True
        view = view_of(layout)
        return view is not None and self.view.near(view, self.angle)


class SeveralSensorsError(UsageError):
    """One topic carries several sensors, and none was chosen; `best` is the one with most scans."""

    code = CHOICE

    def __init__(self, message: str, best: str) -> None:
        super().__init__(message)
        self.best = best


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


def sensors_of(glimpses: Sequence[Glimpse]) -> list[ScanSensor]:
    """The sensors among the scans that were looked at, in the order in which they appear."""
    groups: dict[tuple[str, bool], list[Glimpse]] = {}
    for glimpse in glimpses:
        groups.setdefault((glimpse.frame, glimpse.layout is None), []).append(glimpse)
    found = []
    for (frame, is_cloud), group in groups.items():
        kinds = [] if is_cloud else _kinds(group)
        if len(kinds) < 2:
            alone = ScanSensor(name=frame, frame=frame, count=len(group), is_cloud=is_cloud)
            found.append(alone)
            continue
        for number, (view, count) in enumerate(kinds, start=1):
            found.append(
                ScanSensor(
                    name=f"{frame}#{number}",
                    frame=frame,
                    count=count,
                    is_cloud=False,
                    view=view,
                    angle=_SENSOR_ANGLE_RAD,
                )
            )
    return found


def _kinds(group: Sequence[Glimpse]) -> list[tuple[View, int]]:
    """The fields of view that take turns in one frame, and how often each is met."""
    angle = _SENSOR_ANGLE_RAD
    views: list[View] = []
    turns: list[int] = []  # the number of the view of each scan
    for glimpse in group:
        view = None if glimpse.layout is None else view_of(glimpse.layout)
        if view is None:
            continue
        near = (n for n, known in enumerate(views) if known.near(view, angle))
        number = next(near, len(views))
        if number == len(views):
            views.append(view)
        turns.append(number)
    counts = [turns.count(number) for number in range(len(views))]
    least = max(_BY_TURNS, _SENSOR_SHARE * len(group))
    often = [n for n, count in enumerate(counts) if count >= least]
    kept = [n for n in often if _rival(n, often, views, turns, angle)]
    return [(views[n], counts[n]) for n in kept]


def _rival(
    number: int, often: Sequence[int], views: Sequence[View], turns: Sequence[int], angle: float
) -> bool:
    """Whether another view overlaps with this one and takes turns with it."""
    for other in often:
        if other == number or not views[number].overlaps(views[other], angle):
            continue
        both = [turn for turn in turns if turn in (number, other)]
        changes = sum(a != b for a, b in pairwise(both))
        if 2 * changes >= min(both.count(number), both.count(other)):
            return True
    return False


def choose_sensor(where: str, sensors: Sequence[ScanSensor], config: LogConfig) -> ScanSensor:
    """The sensor that the settings name, or the only one with more than a small share of the scans.

    `where` names log and topic. Raises UsageError with the sensors ready to paste.
    """
    total, asked = sum(sensor.count for sensor in sensors), config.scan_frame
    if asked is not None:
        wanted = asked.lstrip("/")
        chosen = next((s for s in sensors if s.name == wanted), None)
        if chosen is not None:
            return chosen
        known = ", ".join(_told(sensor, total) for sensor in sensors)
        nothing = f"{where}: --scan-frame {asked}: no scans of such a sensor; there are {known}"
        raise UsageError(legible(nothing))
    often = [s for s in sensors if s.count >= _SENSOR_SHARE * total]
    candidates = often or list(sensors)
    if len(candidates) == 1:
        return candidates[0]
    best = max(candidates, key=lambda sensor: sensor.count)
    choices = " or ".join(f"`--scan-frame {_told(s, total, '`')}" for s in candidates)
    several = f"{where}: {len(candidates)} sensors on one topic: choose {choices}"
    raise SeveralSensorsError(legible(several), best.name)


def _told(sensor: ScanSensor, total: int, end: str = "") -> str:
    """`laser (5 of the first 10 scans)`, with the view in degrees where the frame has several."""
    view = ""
    if sensor.view is not None:
        low, high = (math.degrees(bearing) for bearing in sensor.view)
        view = f"{low:.0f} to {high:.0f} degrees, "
    return f"{shlex.quote(sensor.name)}{end} ({view}{sensor.count:,} of the first {total:,} scans)"
