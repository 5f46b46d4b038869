"""The history of one building as history.json has it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from datetime import tzinfo
from typing import Any

import numpy as np

from specmap_cli.history.visits import Visit, day_of, days_of, totals
from specmap_cli.maps.comparison import ComparisonRecord
from specmap_cli.maps.store import StoredMap
from specmap_cli.pipelines.building_series import BuildingSeries, Placed, Room, Step

_NS = 1_000_000_000
_NOWHERE: Mapping[str, Any] = {"x": None, "y": None}


def span_ns(stored: StoredMap) -> tuple[int, int]:
    """The stamps of a map's first and last keyframe."""
    stamps = stored.labels.stamps_ns
    return int(stamps.min()), int(stamps.max())


def map_entry(placed: Placed, step: Step | None) -> dict[str, Any]:
    """A map as history.json has it; `step` is that from an earlier map to it."""
    stored = placed.stored
    start_ns, end_ns = span_ns(stored)
    quality = stored.record.graph.quality
    found = None if step is None else step.comparison.record.alignment.residual_m
    return {
        "number": placed.number,
        "map": str(stored.path),
        "start": start_ns / _NS,
        "end": end_ns / _NS,
        "verdict": None if quality is None else quality.verdict,
        "submaps": len(stored.record.nodes),
        "area_m2": sum(node.area_m2 for node in stored.record.nodes),
        "compared_with": None if step is None else step.before.placed.number,
        "residual_m": found,
    }


def change_entries(step: Step, zone: tzinfo) -> list[dict[str, Any]]:
    """What differs between two maps of a series, in the frame of the building."""
    told = {
        "map": step.after.placed.number,
        "before": step.before.placed.number,
        "day": day_of(span_ns(step.after.placed.stored)[1], zone),
        "since": day_of(span_ns(step.before.placed.stored)[1], zone),
    }
    return [told | change for change in _changes(step, step.comparison.record)]


@dataclass(frozen=True, slots=True)
class _Frame:
    """Places and submaps of two maps as the building knows them."""

    step: Step

    def at(self, x: float, y: float) -> dict[str, Any]:
        """A place of the map before in the frame of the building."""
        ((x, y),) = self.step.before.placed.to_building(np.array([[x, y]])).tolist()
        return {"x": x, "y": y}

    def old(self, ids: Iterable[int | None]) -> list[int]:
        """The rooms of submaps of the map before."""
        return _rooms(ids, self.step.before.room_of)

    def new(self, ids: Iterable[int | None]) -> list[int]:
        """The rooms of submaps of the later map."""
        return _rooms(ids, self.step.after.room_of)


def _changes(step: Step, record: ComparisonRecord) -> Iterator[dict[str, Any]]:
    frame = _Frame(step)
    for way in record.doors.closed:
        yield frame.at(way.x, way.y) | _what("door-closed", frame.old(way.between), way.width_m)
    for way in record.doors.opened:
        yield frame.at(way.x, way.y) | _what("door-opened", frame.new(way.between), way.width_m)
    things = record.things
    for kind, found in (("appeared", things.appeared), ("vanished", things.vanished)):
        for thing in found:
            rooms = frame.old([thing.old_submap]) or frame.new([thing.new_submap])
            yield frame.at(thing.x, thing.y) | _what(kind, rooms, thing.area_m2)
    for id_ in record.submaps.gone:
        yield {**_NOWHERE} | _what("room-gone", frame.old([id_]), None)
    for room in step.after.added:
        yield {**_NOWHERE} | _what("room-added", [room.number], room.node.area_m2)


def _what(kind: str, rooms: list[int], size: float | None) -> dict[str, Any]:
    return {"kind": kind, "rooms": rooms, "size": size}


def _rooms(ids: Iterable[int | None], room_of: Mapping[int, int]) -> list[int]:
    return sorted({room_of[id_] for id_ in ids if id_ is not None and id_ in room_of})


def building_entry(
    number: int,
    series: BuildingSeries,
    name: str,
    parts: tuple[list[dict[str, Any]], list[dict[str, Any]]],
    zone: tzinfo,
) -> dict[str, Any]:
    """A building as history.json has it; `parts` are its maps and its changes."""
    maps, changes = parts
    return {
        "number": number,
        "name": name,
        "rooms": [_room(series, room, zone) for room in series.rooms],
        "maps": maps,
        "days": days_of(series.tours, zone),
        "changes": changes,
    }


def _room(series: BuildingSeries, room: Room, zone: tzinfo) -> dict[str, Any]:
    visits = [one for tour in series.tours for one in tour.visits if one.room == room.number]
    count, minutes = totals(visits).get(room.number, (0, 0.0))
    return {
        "number": room.number,
        "name": series.name_of(room),
        "map": room.map_,
        "submap": room.node.id,
        "area_m2": room.node.area_m2,
        "visits": count,
        "minutes": minutes,
        "days": len(_days(visits, zone)),
    }


def _days(visits: Iterable[Visit], zone: tzinfo) -> set[str]:
    return {day_of(visit.start_ns, zone) for visit in visits}
