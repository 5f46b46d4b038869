"""The history of one building as history.json has it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from datetime import tzinfo

import numpy as np

from specmap_cli.core.text import encodable
from specmap_cli.history.record import ChangeKind, ChangeRecord, MapRecord, RoomRecord
from specmap_cli.history.visits import day_of, totals
from specmap_cli.maps.comparison import ThingRecord
from specmap_cli.maps.store import StoredMap
from specmap_cli.pipelines.building_series import BuildingSeries, Placed, Room, Step

_NS = 1_000_000_000


def span_ns(stored: StoredMap) -> tuple[int, int]:
    """The stamps of a map's first and last keyframe."""
    stamps = stored.labels.stamps_ns
    return int(stamps.min()), int(stamps.max())


def map_record(placed: Placed, step: Step | None) -> MapRecord:
    """A map as history.json has it; `step` is that from an earlier map to it."""
    stored = placed.stored
    start_ns, end_ns = span_ns(stored)
    quality = stored.record.graph.quality
    return MapRecord(
        number=placed.number,
        map=encodable(str(stored.path)),
        start=start_ns / _NS,
        end=end_ns / _NS,
        verdict=None if quality is None else quality.verdict,
        submaps=len(stored.record.nodes),
        area_m2=sum(node.area_m2 for node in stored.record.nodes),
        compared_with=None if step is None else step.before.placed.number,
        residual_m=None if step is None else step.comparison.record.alignment.residual_m,
    )


@dataclass(frozen=True, slots=True)
class _Told:
    """Tells what differs between two maps, by places and rooms as the building knows them."""

    step: Step
    zone: tzinfo

    def change(
        self,
        kind: ChangeKind,
        rooms: list[int],
        size: float | None,
        place: tuple[float, float] | None = None,
    ) -> ChangeRecord:
        """A change at a place of the map before, or of a room."""
        x: float | None = None
        y: float | None = None
        after, before = self.step.after.placed, self.step.before.placed
        if place is not None:
            ((x, y),) = before.to_building(np.array([place])).tolist()
        return ChangeRecord(
            kind=kind,
            map=after.number,
            before=before.number,
            day=day_of(span_ns(after.stored)[1], self.zone),
            since=day_of(span_ns(before.stored)[1], self.zone),
            rooms=rooms,
            x=x,
            y=y,
            size=size,
        )

    def old(self, ids: Iterable[int | None]) -> list[int]:
        """The rooms of submaps of the map before."""
        return _rooms(ids, self.step.before.room_of)

    def new(self, ids: Iterable[int | None]) -> list[int]:
        """The rooms of submaps of the later map."""
        return _rooms(ids, self.step.after.room_of)


def changes_of(step: Step, zone: tzinfo) -> Iterator[ChangeRecord]:
    """What differs between two maps of a series, in the frame of the building."""
    record, told = step.comparison.record, _Told(step, zone)
    for way in record.doors.closed:
        yield told.change("door-closed", told.old(way.between), way.width_m, (way.x, way.y))
    for way in record.doors.opened:
        yield told.change("door-opened", told.new(way.between), way.width_m, (way.x, way.y))
    for thing in record.things.appeared:
        yield told.change("appeared", _rooms_of(thing, told), thing.area_m2, (thing.x, thing.y))
    for thing in record.things.vanished:
        yield told.change("vanished", _rooms_of(thing, told), thing.area_m2, (thing.x, thing.y))
    for id_ in record.submaps.gone:
        yield told.change("room-gone", told.old([id_]), None)
    for room in step.after.added:
        yield told.change("room-added", [room.number], room.node.area_m2)


def _rooms_of(thing: ThingRecord, told: _Told) -> list[int]:
    return told.old([thing.old_submap]) or told.new([thing.new_submap])


def _rooms(ids: Iterable[int | None], room_of: Mapping[int, int]) -> list[int]:
    return sorted({room_of[id_] for id_ in ids if id_ is not None and id_ in room_of})


def room_records(series: BuildingSeries, zone: tzinfo) -> list[RoomRecord]:
    """The rooms of a building as history.json has them."""
    return [_room(series, room, zone) for room in series.rooms]


def _room(series: BuildingSeries, room: Room, zone: tzinfo) -> RoomRecord:
    visits = [one for tour in series.tours for one in tour.visits if one.room == room.number]
    count, minutes = totals(visits).get(room.number, (0, 0.0))
    return RoomRecord(
        number=room.number,
        name=series.name_of(room),
        map=room.map_,
        submap=room.node.id,
        area_m2=room.node.area_m2,
        visits=count,
        minutes=minutes,
        days=len({day_of(visit.start_ns, zone) for visit in visits}),
    )
