"""Visits of rooms by day, from the room that each keyframe was taken in."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, tzinfo
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from specmap_cli.core.arrays import runs
from specmap_cli.core.errors import UsageError
from specmap_cli.core.records import NO_SUBMAP, IntArray, Labels
from specmap_cli.history.record import DayRecord, StayRecord

_NS = 1_000_000_000
_MINUTE_S = 60.0


@dataclass(frozen=True, slots=True)
class Visit:
    """The robot in one room without a break; the stamps are those of scans."""

    room: int
    start_ns: int
    end_ns: int


@dataclass(frozen=True, slots=True)
class Tour:
    """One recording: when it began and ended, how far the robot drove, and where it was."""

    start_ns: int
    end_ns: int
    driven_m: float
    visits: tuple[Visit, ...]


def tour_of(keyframes: Labels, rooms: IntArray, driven_m: float) -> Tour:
    """The tour of one recording's keyframes, of which `rooms` (n,) holds the room of each.

    A keyframe in no room has NO_SUBMAP. A visit lasts until the scan with which the next begins, so
    that no time is lost between two rooms.
    """
    stamps = keyframes.stamps_ns.tolist()
    spans = runs(rooms)
    visits = tuple(
        Visit(int(rooms[start]), stamps[start], stamps[min(end, len(stamps) - 1)])
        for start, end in spans
        if rooms[start] != NO_SUBMAP
    )
    return Tour(stamps[0], stamps[-1], driven_m, visits)


def _minutes_of(span: Visit | Tour) -> float:
    """How long it lasted."""
    return (span.end_ns - span.start_ns) / _NS / _MINUTE_S


def zone_of(name: str) -> tzinfo:
    """The time zone of a name such as `Europe/Berlin`. Raises UsageError for one unknown here."""
    if name == "UTC":  # known without the system's names
        return UTC
    try:
        return ZoneInfo(name)
    except (ZoneInfoNotFoundError, ValueError, OSError):
        raise UsageError(
            f"time zone {name!r} is not known on this machine",
            "give a name such as Europe/Berlin or UTC; names come with the system package tzdata",
        ) from None


def day_of(stamp_ns: int, zone: tzinfo) -> str:
    """The day of a stamp, YYYY-MM-DD. One that counts from no known day lies in 1970."""
    moment = datetime.fromtimestamp(stamp_ns // _NS, tz=UTC)
    return moment.astimezone(zone).date().isoformat()


def days_of(tours: Sequence[Tour], zone: tzinfo) -> list[DayRecord]:
    """The days of a building. A visit counts on the day it began."""
    by_day: dict[str, list[Tour]] = {}
    visits: dict[str, list[Visit]] = {}
    for tour in sorted(tours, key=lambda one: one.start_ns):
        by_day.setdefault(day_of(tour.start_ns, zone), []).append(tour)
        for visit in tour.visits:
            visits.setdefault(day_of(visit.start_ns, zone), []).append(visit)
    return [
        DayRecord(
            day=day,
            recordings=len(by_day.get(day, ())),
            driven_m=sum(tour.driven_m for tour in by_day.get(day, ())),
            minutes=sum(_minutes_of(tour) for tour in by_day.get(day, ())),
            rooms=[
                StayRecord(room=room, visits=count, minutes=minutes)
                for room, (count, minutes) in sorted(totals(visits.get(day, ())).items())
            ],
        )
        for day in sorted({*by_day, *visits})
    ]


def totals(visits: Iterable[Visit]) -> Mapping[int, tuple[int, float]]:
    """How often and how many minutes each room was visited."""
    found: dict[int, tuple[int, float]] = {}
    for visit in visits:
        count, minutes = found.get(visit.room, (0, 0.0))
        found[visit.room] = count + 1, minutes + _minutes_of(visit)
    return found
