"""The contents of history.json: buildings, their rooms, visits by day, and what changed when.

These models are the format. `history.schema.json` beside this file is the same as JSON Schema, for
other tools. Lengths are metres; places are in the frame of a building, that of its first map.
Visits of rooms are counted by day (`days_of`), from the room that each keyframe was taken in.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, tzinfo
from typing import Literal
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from pydantic import Field

from specmap_cli.core.errors import UsageError
from specmap_cli.core.geometry import runs
from specmap_cli.core.json_values import Amount, Count, Measured, Number, Stamp
from specmap_cli.core.records import NO_SUBMAP, IntArray, Labels
from specmap_cli.core.schemas import ModelSchema

SCHEMA_VERSION = 1

ChangeKind = Literal[
    "door-closed", "door-opened", "appeared", "vanished", "room-gone", "room-added"
]


def room_name(number: int) -> str:
    """What a room is called that nobody named."""
    return f"room {number}"


class RoomRecord(Measured):
    """A room of a building: a submap of the map that showed it first."""

    number: Count = Field(description="what visits and changes call it by")
    name: str = Field(description="the last one that a person gave, or its number")
    map: Count = Field(description="number of the map that showed it first")
    submap: Count = Field(description="its id in that map")
    area_m2: Amount = Field(description="of its floor in that map")
    visits: Count = Field(description="on all days")
    minutes: Amount = Field(description="on all days")
    days: Count = Field(description="on how many days it was visited")


class MapRecord(Measured):
    """One of the maps, by time."""

    number: Count = Field(description="what rooms and changes call it by")
    map: str = Field(description="the directory, as it was found")
    start: Stamp = Field(description="stamp of its first scan, seconds")
    end: Stamp = Field(description="stamp of its last scan, seconds")
    verdict: str | None = Field(description="what the map thinks of itself")
    submaps: Count
    area_m2: Amount = Field(description="of the floors of its submaps")
    compared_with: Count | None = Field(
        description="number of the earlier map that it was compared with; null for the first"
    )
    residual_m: Amount | None = Field(description="how far its submaps lie off those of that map")


class StayRecord(Measured):
    """A room on one day."""

    room: Count
    visits: Count = Field(description="how often the robot came in on this day")
    minutes: Amount = Field(description="between the scans of these visits")


class DayRecord(Measured):
    """A building on one day."""

    day: str = Field(description="YYYY-MM-DD in the time zone of the record")
    recordings: Count = Field(description="that began on it")
    driven_m: Amount
    minutes: Amount = Field(description="of recordings")
    rooms: list[StayRecord] = Field(description="those that were visited, by number")


class ChangeRecord(Measured):
    """Something that is otherwise in a map than in the map that it was compared with."""

    kind: ChangeKind
    map: Count = Field(description="number of the map that shows it first")
    before: Count = Field(description="number of the map that it was compared with")
    day: str = Field(description="of the last scan of `map`; it happened on it or before")
    since: str = Field(description="of the last scan of `before`; it happened on it or after")
    rooms: list[Count] = Field(description="the rooms it is in, or between; empty when unknown")
    x: Number | None = Field(description="null for a room")
    y: Number | None = Field(description="null for a room")
    size: Amount | None = Field(description="width of a door, m; area of a thing or room, m2")


class BuildingRecord(Measured):
    """Maps that fit to one another, directly or through others."""

    number: Count
    name: str = Field(description="name of the directory of its first map")
    rooms: list[RoomRecord] = Field(description="by number")
    maps: list[MapRecord] = Field(description="by the time of their last scan")
    days: list[DayRecord] = Field(description="those with a recording, in order")
    changes: list[ChangeRecord] = Field(description="in the order of the maps that show them")


class LeftOutRecord(Measured):
    """A map that could not be read."""

    map: str
    reason: str


class HistoryRecord(Measured):
    """The whole file."""

    schema_version: Literal[1] = Field(description="the version of this format")
    timezone: str = Field(description="in which a day begins and ends")
    buildings: list[BuildingRecord] = Field(description="in the order of their first maps")
    left_out: list[LeftOutRecord] = Field(description="what was named and is not in it")


SCHEMA = ModelSchema(HistoryRecord, "history", SCHEMA_VERSION, "specmap history.json")


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
