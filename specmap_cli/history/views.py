"""A history for people: tables for spreadsheets, lines, and a page with a section a building.

The page runs no script. It has tables, and a plan of the first map whose rooms are the darker, the
more time the robots spent in them.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

from specmap_cli.core.text import counted, csv_text, legible
from specmap_cli.history.record import (
    BuildingRecord,
    ChangeRecord,
    HistoryRecord,
    room_name,
)
from specmap_cli.maps.store import Map
from specmap_cli.report import layers
from specmap_cli.report.html import html_page, shown
from specmap_cli.report.layers import DrawnMap
from specmap_cli.report.svg import tones

MOST_DAYS = 31  # columns of the table of a building: the last ones
_PACKAGE = "specmap_cli.history"
_STYLES = ("page.css", "parts.css", "history.css", "print.css")
_WORDS: Mapping[str, str] = {
    "door-closed": "door closed",
    "door-opened": "door opened",
    "appeared": "something appeared",
    "vanished": "something vanished",
    "room-gone": "room gone",
    "room-added": "room added",
}
_UNITS: Mapping[str, str] = {"door-closed": "m wide", "door-opened": "m wide"}


def visits_csv(record: HistoryRecord) -> str:
    """A line a building, day and room that was visited."""
    return csv_text(
        ("building", "day", "room", "name", "visits", "minutes"),
        [
            (building.name, day.day, stay.room, names[stay.room], stay.visits, stay.minutes)
            for building in record.buildings
            for names in (names_of(building),)
            for day in building.days
            for stay in day.rooms
        ],
    )


def days_csv(record: HistoryRecord) -> str:
    """A line a building and day."""
    return csv_text(
        ("building", "day", "recordings", "driven_m", "minutes", "rooms"),
        [
            (building.name, day.day, day.recordings, day.driven_m, day.minutes, len(day.rooms))
            for building in record.buildings
            for day in building.days
        ],
    )


def changes_csv(record: HistoryRecord) -> str:
    """A line a change."""
    rows: list[tuple[Any, ...]] = []
    for building in record.buildings:
        names, maps = names_of(building), {one.number: one.map for one in building.maps}
        for one in building.changes:
            rooms = ", ".join(names[room] for room in one.rooms)
            when, place = (one.since, one.day), (one.x, one.y, one.size)
            both = maps[one.map], maps[one.before]
            rows.append((building.name, *when, one.kind, rooms, *place, *both))
    head = ("building", "since", "day", "kind", "rooms", "x", "y", "size", "map", "before")
    return csv_text(head, rows)


TABLES: Mapping[str, Callable[[HistoryRecord], str]] = {
    "visits.csv": visits_csv,
    "days.csv": days_csv,
    "changes.csv": changes_csv,
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
    parted = {"door-closed": "between ", "door-opened": "between "}.get(change.kind, "in ")
    place = "" if not where else f" {where}" if change.x is None else f" {parted}{where}"
    size = "" if change.size is None else f", {change.size:.2f} {_UNITS.get(change.kind, 'm2')}"
    at = "" if change.x is None else f", at ({change.x:.1f}, {change.y:.1f})"
    return f"{_WORDS[change.kind]}{place}{size}{at} (since {change.since})"


def render_history(record: HistoryRecord, plans: Sequence[Map], folder: Path) -> str:
    """The page as text; `plans` are the first maps of the buildings, `folder` is where it lies.

    Raises MapError when a file of a map is missing or damaged.
    """
    sections = []
    for building, stored in zip(record.buildings, plans, strict=True):
        names = {number: shown(name) for number, name in names_of(building).items()}
        days = building.days[-MOST_DAYS:]
        longest = max((stay.minutes for day in days for stay in day.rooms), default=0.0)
        section = {
            "building": building,
            "title": shown(building.name),
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
    """The first map of a building: path data, and the rooms with what share of time each had.

    The sign of a room is the name that a person gave, or the number alone: rooms may be small.
    """
    map_ = DrawnMap(stored)
    rooms = {room.submap: room for room in building.rooms if room.map == building.maps[0].number}
    longest = max((room.minutes for room in rooms.values()), default=0.0)
    drawn = [(region, rooms[region.id]) for region in layers.regions_of(map_) if region.id in rooms]
    return {
        "frame": map_.frame,
        "walls": map_.walls,
        "seen": map_.seen,
        "rooms": [
            {
                "name": shown(room.name),
                "sign": str(room.number)
                if room.name == room_name(room.number)
                else shown(room.name),
                "outline": region.outline,
                "badge": region.badge,
                "shade": _shade(room.minutes, longest),
            }
            for region, room in drawn
        ],
    }


def _shade(minutes: float, longest: float) -> int:
    """How dark a time is against the longest one, in percent; any visit can be seen."""
    return 0 if not longest else 12 + round(68 * (minutes / longest) ** 0.5)


def _link(map_: Path, folder: Path) -> dict[str, str | None]:
    """Where a map lies from the page, and its report where a batch made one."""
    report = map_.parent / "report.html"
    of_a_job = map_.name == "map" and (map_.parent / "job.json").exists() and report.exists()
    links = {"map": map_, "report": report if of_a_job else None}
    return {
        name: quote(os.path.relpath(path, folder.resolve())) if path else None
        for name, path in links.items()
    }
