"""The contents of history.json: buildings, their rooms, visits by day, and what changed when.

Lengths are metres; places are in the frame of a building, that of its first map.
Visits of rooms are counted by day (`days_of`), from the room that each keyframe was taken in.

For people there are tables for spreadsheets, lines, and a page without a script: a section a
building with tables, and a plan of its first map whose rooms are the darker, the more time the
robots spent in them.
"""

from __future__ import annotations

import os
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, tzinfo
from itertools import groupby
from pathlib import Path
from typing import Any, Literal
from urllib.parse import quote
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

import numpy as np
from pydantic import Field

from specmap_cli.core.arrays import runs
from specmap_cli.core.errors import UsageError
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.json_values import Amount, Count, Measured, Number, Stamp
from specmap_cli.core.records import IntArray
from specmap_cli.core.schemas import ModelSchema
from specmap_cli.core.text import counted, csv_text, legible, one_line
from specmap_cli.maps.store import Map
from specmap_cli.report import layers
from specmap_cli.report.html import html_page, tones
from specmap_cli.report.layers import DrawnMap

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


SCHEMA = ModelSchema(HistoryRecord, "history", 1, "specmap history.json")


_NS = 1_000_000_000
_MINUTE_S = 60.0


@dataclass(frozen=True, slots=True)
class Visit:
    """The robot in one room without a break; the stamps are those of scans."""

    room: int
    start_ns: int
    end_ns: int


@dataclass(frozen=True, slots=True, eq=False)
class Tour:
    """One recording: stamps of its keyframes (n,), how far it had driven at each (n,), visits."""

    stamps_ns: IntArray
    driven_m: FloatArray
    visits: tuple[Visit, ...]

    def days(self, zone: tzinfo) -> Iterator[tuple[str, float, float]]:
        """The days of it, in order: metres and minutes, each step on the day on which it began."""
        first, last = self.stamps_ns[[0, -1]].tolist()
        days = [day_of(first, zone)]
        if day_of(last, zone) == days[0]:
            days *= len(self.stamps_ns)
        else:
            days = [day_of(stamp, zone) for stamp in self.stamps_ns.tolist()]
        metres, minutes = (
            np.append(np.diff(at), 0.0)
            for at in (self.driven_m, (self.stamps_ns - first) / _NS / _MINUTE_S)
        )
        for day, steps in groupby(range(len(days)), key=days.__getitem__):
            own = list(steps)
            yield day, float(metres[own].sum()), float(minutes[own].sum())


def settle_labels(
    labels: IntArray, poses: FloatArray, rows: IntArray, min_path_m: float
) -> IntArray:
    """Labels (n,) of successive keyframes without excursions.

    The keyframes are `rows` (n,) of all scans, which were taken at `poses` (s, 3): of an old visit
    a map may have kept two keyframes at the door. A stay between two stays in one submap becomes
    part of that submap where its way is shorter than `min_path_m`, from its first keyframe over the
    farthest scan to its last. Stays are looked at in turn, the first is kept.
    """
    settled = labels.copy()
    stays = runs(labels)
    for before, (start, end), after in zip(stays, stays[1:], stays[2:], strict=False):
        if settled[before[0]] != settled[after[0]]:
            continue
        way = poses[rows[start] : rows[end - 1] + 1, :2]
        from_first, from_last = (np.hypot(*(way - way[end]).T) for end in (0, -1))
        if float(np.max(from_first + from_last)) < min_path_m:
            settled[start:end] = settled[before[0]]
    return settled


def tour_of(stamps_ns: IntArray, rooms: IntArray, driven_m: FloatArray) -> Tour:
    """The tour of one recording's keyframes at `stamps_ns` (n,); `rooms` (n,) is where each was.

    `driven_m` (n,) is how far the robot had driven at each. A visit lasts until the scan with which
    the next begins, so that no time is lost between two rooms.
    """
    stamps = stamps_ns.tolist()
    visits = tuple(
        Visit(int(rooms[start]), stamps[start], stamps[min(end, len(stamps) - 1)])
        for start, end in runs(rooms)
    )
    return Tour(stamps_ns, driven_m, visits)


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
    recordings = Counter[str]()
    driven_m, minutes = defaultdict[str, float](float), defaultdict[str, float](float)
    visits: dict[str, list[Visit]] = {}
    for tour in tours:
        for number, (day, way_m, lasted) in enumerate(tour.days(zone)):
            recordings[day] += number == 0
            driven_m[day] += way_m
            minutes[day] += lasted
        for visit in tour.visits:
            visits.setdefault(day_of(visit.start_ns, zone), []).append(visit)
    return [
        DayRecord(
            day=day,
            recordings=recordings[day],
            driven_m=driven_m[day],
            minutes=minutes[day],
            rooms=[
                StayRecord(room=room, visits=count, minutes=lasted)
                for room, (count, lasted) in sorted(totals(visits.get(day, ())).items())
            ],
        )
        for day in sorted(recordings)
    ]


def totals(visits: Iterable[Visit]) -> Mapping[int, tuple[int, float]]:
    """How often and how many minutes each room was visited."""
    found: dict[int, tuple[int, float]] = {}
    for visit in visits:
        count, minutes = found.get(visit.room, (0, 0.0))
        lasted = (visit.end_ns - visit.start_ns) / _NS / _MINUTE_S
        found[visit.room] = count + 1, minutes + lasted
    return found


MOST_DAYS = 31  # columns of the table of a building: the last ones
_PACKAGE = "specmap_cli.history"
_STYLES = ("page.css", "parts.css", "history.css", "print.css")


TABLES: Mapping[str, str] = {
    "visits.csv": "building day room name visits minutes",
    "days.csv": "building day recordings driven_m minutes rooms",
    "changes.csv": "building since day kind rooms x y size map before",
}


def tables_of(record: HistoryRecord) -> dict[str, str]:
    """Tables by file name: a line a room visited on a day, a line a day, and a line a change."""
    visits, days, changes = [list[tuple[Any, ...]]() for _ in TABLES]
    for building in record.buildings:
        name, names = building.name, names_of(building)
        maps = {one.number: one.map for one in building.maps}
        for day in building.days:
            driven = day.driven_m, day.minutes
            days.append((name, day.day, day.recordings, *driven, len(day.rooms)))
            for stay in day.rooms:
                stayed = stay.visits, stay.minutes
                visits.append((name, day.day, stay.room, names[stay.room], *stayed))
        for one in building.changes:
            rooms = ", ".join(names[room] for room in one.rooms)
            when, place = (one.since, one.day), (one.x, one.y, one.size)
            both = maps[one.map], maps[one.before]
            changes.append((name, *when, one.kind, rooms, *place, *both))
    return {
        file: csv_text(head.split(), rows)
        for (file, head), rows in zip(TABLES.items(), (visits, days, changes), strict=True)
    }


def lines_of(record: HistoryRecord) -> list[str]:
    """A paragraph a building, then what was left out."""
    lines = []
    for building in record.buildings:
        first, last = building.maps[0], building.maps[-1]
        days = [day.day for day in building.days]
        when = f"{days[0]} to {days[-1]}" if len(days) > 1 else "".join(days)
        lines.append(
            f"{legible(building.name)}: {counted(len(building.maps), 'map')}, "
            f"{counted(len(days), 'day')} ({when}), {counted(len(building.rooms), 'room')}, "
            f"{sum(day.driven_m for day in building.days):,.0f} m driven"
        )
        if last.verdict != first.verdict:
            lines.append(f"  verdict: {first.verdict} at first, {last.verdict} now")
        width = max((len(legible(room.name)) for room in building.rooms), default=0)
        for room in sorted(building.rooms, key=lambda one: (-one.minutes, one.number)):
            lines.append(
                f"  {legible(room.name):<{width}}  {counted(room.visits, 'visit'):>10}"
                f"  {room.minutes:8.1f} min  on {counted(room.days, 'day')}"
            )
        names = names_of(building)
        lines += [f"  {change.day}: {words_of(change, names)}" for change in building.changes]
        if len(building.maps) > 1 and not building.changes:
            lines.append("  no change found")
    return [*lines, *(f"left out: {one.reason}" for one in record.left_out)]


def names_of(building: BuildingRecord) -> dict[int, str]:
    """The names of the rooms by number."""
    return {room.number: room.name for room in building.rooms}


def words_of(change: ChangeRecord, names: Mapping[int, str]) -> str:
    """A change in words."""
    where = " and ".join(legible(names[room]) for room in change.rooms)
    parted, unit = ("between", "m wide") if change.kind.startswith("door-") else ("in", "m2")
    what = change.kind.replace("-", " ") if "-" in change.kind else f"something {change.kind}"
    place = "" if not where else f" {where}" if change.x is None else f" {parted} {where}"
    size = "" if change.size is None else f", {change.size:.2f} {unit}"
    at = "" if change.x is None else f", at ({change.x:.1f}, {change.y:.1f})"
    return f"{what}{place}{size}{at} (since {change.since})"


def render_history(record: HistoryRecord, plans: Sequence[Map], folder: Path) -> str:
    """The page as text; `plans` are the first maps of the buildings, `folder` is where it lies.

    Raises MapError when a file of a map is missing or damaged.
    """
    sections = []
    for building, stored in zip(record.buildings, plans, strict=True):
        names = {number: one_line(name) for number, name in names_of(building).items()}
        days = building.days[-MOST_DAYS:]
        longest = max((stay.minutes for day in days for stay in day.rooms), default=0.0)
        section = {
            "building": building,
            "title": one_line(building.name),
            "names": names,
            "days": days,
            "days_before": len(building.days) - len(days),
            "stays": {
                (stay.room, day.day): (stay, _shade(stay.minutes, longest))
                for day in days
                for stay in day.rooms
            },
            "plan": _plan(building, stored),
            "unplanned": [room for room in building.rooms if room.map != building.maps[0].number],
            "changes": [(change.day, words_of(change, names)) for change in building.changes],
            "links": {one.number: _link(Path(one.map).resolve(), folder) for one in building.maps},
        }
        sections.append(section)
    context = {
        "title": counted(len(sections), "building"),
        "record": record,
        "sections": sections,
        "tones": tones(()),
    }
    return html_page(_PACKAGE, "history.html", context, _STYLES)


def _plan(building: BuildingRecord, stored: Map) -> dict[str, Any]:
    """The first map of a building as path data; its rooms by name or number, and share of time."""
    map_ = DrawnMap(stored)
    rooms = {room.submap: room for room in building.rooms if room.map == building.maps[0].number}
    longest = max((room.minutes for room in rooms.values()), default=0.0)
    regions = [region for region in layers.regions_of(map_) if region["id"] in rooms]
    drawn = [(region, rooms[region["id"]]) for region in regions]
    return {
        "frame": map_.frame,
        "walls": map_.walls,
        "seen": map_.seen,
        "rooms": [
            {
                "name": one_line(room.name),
                "sign": str(room.number)
                if room.name == room_name(room.number)
                else one_line(room.name),
                "outline": region["outline"],
                "badge": region["badge"],
                "shade": _shade(room.minutes, longest),
            }
            for region, room in drawn
        ],
    }


def _shade(minutes: float, longest: float) -> int:
    """How dark a time is against the longest one, in percent; any visit can be seen."""
    return 0 if not longest else 12 + round(68 * (minutes / longest) ** 0.5)


def of_a_job(map_: Path) -> bool:
    """Whether a batch made a map directory: its job has the folder above."""
    return map_.name == "map" and (map_.parent / "job.json").exists()


def _link(map_: Path, folder: Path) -> dict[str, str | None]:
    """Where a map lies from the page, and its report where a batch made one."""
    report = map_.parent / "report.html"
    links = {"map": map_, "report": report if of_a_job(map_) and report.exists() else None}
    return {
        name: quote(os.path.relpath(path, folder.resolve())) if path else None
        for name, path in links.items()
    }
