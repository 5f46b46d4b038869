"""The page of a history: rooms by day, and what changed, a section a building.

It runs no script: tables, and a plan of the first map whose rooms are the darker, the more time the
robots spent in them.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

from specmap_cli.core.text import counted
from specmap_cli.history.record import BuildingRecord, HistoryRecord, RoomRecord, room_name
from specmap_cli.history.tables import names_of, words_of
from specmap_cli.maps.store import StoredMap
from specmap_cli.report import layers
from specmap_cli.report.html import html_page, shown
from specmap_cli.report.layers import DrawnMap
from specmap_cli.report.svg import Frame, tones

MOST_DAYS = 31  # columns of the table of a building: the last ones
_PACKAGE = "specmap_cli.history"
_STYLES = ("page.css", "parts.css", "history.css", "print.css")


@dataclass(frozen=True, slots=True)
class Plan:
    """The first map of a building: path data, and the rooms with what share of time each had."""

    frame: Frame
    walls: str
    floor: str
    rooms: tuple[PlannedRoom, ...]


@dataclass(frozen=True, slots=True)
class PlannedRoom:
    """A room in the plan: its floor, where its sign stands, and how dark it is, in percent.

    The sign is the name that a person gave, or the number alone: rooms may be small.
    """

    name: str
    sign: str
    outline: str
    badge: tuple[int, int]
    shade: int


def render_history(record: HistoryRecord, plans: Sequence[StoredMap], folder: Path) -> str:
    """The page as text; `plans` are the first maps of the buildings, `folder` is where it lies.

    Raises MapError when a file of a map is missing or damaged.
    """
    sections = [
        _section(building, stored, folder)
        for building, stored in zip(record.buildings, plans, strict=True)
    ]
    context = {
        "title": counted(len(sections), "building"),
        "record": record,
        "sections": sections,
        "tones": tones(()),
    }
    return html_page(_PACKAGE, "history.html", context, _STYLES)


def _section(building: BuildingRecord, stored: StoredMap, folder: Path) -> dict[str, Any]:
    names = {number: shown(name) for number, name in names_of(building).items()}
    days = building.days[-MOST_DAYS:]
    longest = max((stay.minutes for day in days for stay in day.rooms), default=0.0)
    return {
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
        "links": {each.number: _link(Path(each.map).resolve(), folder) for each in building.maps},
    }


def _plan(building: BuildingRecord, stored: StoredMap) -> Plan:
    map_ = DrawnMap(stored)
    first = building.maps[0].number
    rooms = {room.submap: room for room in building.rooms if room.map == first}
    longest = max((room.minutes for room in rooms.values()), default=0.0)
    return Plan(
        map_.frame,
        layers.walls(map_.regions, map_.frame),
        layers.unreached(map_.regions, map_.frame),
        tuple(
            PlannedRoom(
                shown(rooms[region.id].name),
                _sign(rooms[region.id]),
                region.outline,
                region.badge,
                _shade(rooms[region.id].minutes, longest),
            )
            for region in layers.regions_of(map_)
            if region.id in rooms
        ),
    )


def _sign(room: RoomRecord) -> str:
    return str(room.number) if room.name == room_name(room.number) else shown(room.name)


def _shade(minutes: float, longest: float) -> int:
    """How dark a time is against the longest one, in percent; any visit can be seen."""
    return 0 if not longest else 12 + round(68 * (minutes / longest) ** 0.5)


def _link(map_: Path, folder: Path) -> Mapping[str, str | None]:
    """Where a map lies from the page, and its report where a batch made one."""
    report = map_.parent / "report.html"
    of_a_job = map_.name == "map" and (map_.parent / "job.json").exists() and report.exists()
    return {
        "map": _relative(map_, folder),
        "report": _relative(report, folder) if of_a_job else None,
    }


def _relative(path: Path, folder: Path) -> str:
    return quote(os.path.relpath(path, folder.resolve()))
