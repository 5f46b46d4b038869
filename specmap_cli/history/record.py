"""The contents of history.json: buildings, their rooms, visits by day, and what changed when.

These models are the format. `history.schema.json` beside this file is the same as JSON Schema, for
other tools. Lengths are metres; places are in the frame of a building, that of its first map.
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from specmap_cli.core.json_values import Amount, Count, Measured, Number, Stamp
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
