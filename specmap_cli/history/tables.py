"""A history as tables: CSV for spreadsheets, lines for a person."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

from specmap_cli.core.tables import csv_text
from specmap_cli.core.text import counted, legible
from specmap_cli.history.record import BuildingRecord, ChangeRecord, HistoryRecord, RoomRecord

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
    head = ("building", "day", "room", "name", "visits", "minutes")
    return csv_text(
        head,
        (
            (building.name, day.day, stay.room, names[stay.room], stay.visits, stay.minutes)
            for building in record.buildings
            for names in (names_of(building),)
            for day in building.days
            for stay in day.rooms
        ),
    )


def days_csv(record: HistoryRecord) -> str:
    """A line a building and day."""
    head = ("building", "day", "recordings", "driven_m", "minutes", "rooms")
    return csv_text(
        head,
        (
            (building.name, day.day, day.recordings, day.driven_m, day.minutes, len(day.rooms))
            for building in record.buildings
            for day in building.days
        ),
    )


def changes_csv(record: HistoryRecord) -> str:
    """A line a change."""
    head = ("building", "since", "day", "kind", "rooms", "x", "y", "size", "map", "before")
    return csv_text(
        head,
        (
            (
                building.name,
                change.since,
                change.day,
                change.kind,
                ", ".join(names[room] for room in change.rooms),
                change.x,
                change.y,
                change.size,
                maps[change.map],
                maps[change.before],
            )
            for building in record.buildings
            for names in (names_of(building),)
            for maps in ({map_.number: map_.map for map_ in building.maps},)
            for change in building.changes
        ),
    )


TABLES: Mapping[str, Callable[[HistoryRecord], str]] = {
    "visits.csv": visits_csv,
    "days.csv": days_csv,
    "changes.csv": changes_csv,
}


def lines_of(record: HistoryRecord) -> list[str]:
    """A paragraph a building, then what was left out."""
    lines = [line for building in record.buildings for line in _lines(building)]
    return [*lines, *(f"left out: {one.map}: {one.reason}" for one in record.left_out)]


def _lines(building: BuildingRecord) -> Iterable[str]:
    first, last = building.maps[0], building.maps[-1]
    days = [day.day for day in building.days]
    when = f"{days[0]} to {days[-1]}" if len(days) > 1 else "".join(days)
    yield (
        f"{legible(building.name)}: {counted(len(building.maps), 'map')}, "
        f"{counted(len(days), 'day')} ({when}), {counted(len(building.rooms), 'room')}, "
        f"{sum(day.driven_m for day in building.days):,.0f} m driven"
    )
    if last.verdict != first.verdict:
        yield f"  verdict: {first.verdict} at first, {last.verdict} now"
    yield from _room_lines(building.rooms)
    names = names_of(building)
    yield from (f"  {change.day}: {words_of(change, names)}" for change in building.changes)
    if len(building.maps) > 1 and not building.changes:
        yield "  no change found"


def _room_lines(rooms: Sequence[RoomRecord]) -> Iterable[str]:
    """The rooms, those with the most time in them first."""
    width = max((len(legible(room.name)) for room in rooms), default=0)
    for room in sorted(rooms, key=lambda one: (-one.minutes, one.number)):
        yield (
            f"  {legible(room.name):<{width}}  {counted(room.visits, 'visit'):>10}"
            f"  {room.minutes:8.1f} min  on {counted(room.days, 'day')}"
        )


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
