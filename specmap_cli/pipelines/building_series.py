"""The maps of one building one after the other: its rooms, and what each map shows of them.

A room is a submap of the first map that showed its place. So it stays the same room however later
maps divide the building.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from specmap_cli.core.errors import NoResultError
from specmap_cli.core.geometry import BentMotion, FloatArray
from specmap_cli.core.records import NO_SUBMAP, IntArray, Labels
from specmap_cli.history.record import Tour, room_name, tour_of
from specmap_cli.maps.schema import NodeRecord
from specmap_cli.maps.store import Map
from specmap_cli.pipelines.compare import Comparison, compare_maps
from specmap_cli.topology.graph import settle_labels
from specmap_cli.topology.topological_map import ways_m

_MOST = 0.5  # of the keyframes of a submap

Recording = tuple[str, int | None, int | None]  # name, first and last stamp


@dataclass(frozen=True, slots=True)
class Room:
    """A submap of the map `map_` in which the room was seen first."""

    number: int
    map_: int
    node: NodeRecord


@dataclass(frozen=True, slots=True, eq=False)
class Entry:
    """A map of the series: `steps` lead from it to the frame of the building, one by one.

    `room_of` tells the room that most of each submap is in, by the submap's id. `added` are the
    rooms that no map before it showed.
    """

    number: int
    stored: Map
    steps: tuple[BentMotion, ...] = ()
    room_of: Mapping[int, int] = field(default_factory=dict)
    added: tuple[Room, ...] = ()

    def to_building(self, points: FloatArray) -> FloatArray:
        """Points (n, 2) of the map in the frame of the building."""
        for step in self.steps:
            points = step.apply(points)
        return points

    def from_building(self, points: FloatArray) -> FloatArray:
        """Points (n, 2) of the building in the frame of the map."""
        for step in reversed(self.steps):
            points = step.inverse().apply(points)
        return points

    def rooms(self, ids: Iterable[int | None]) -> list[int]:
        """The rooms of some of its submaps, ascending."""
        return sorted({self.room_of[id_] for id_ in ids if id_ is not None and id_ in self.room_of})


@dataclass(frozen=True, slots=True)
class Step:
    """From one map of the series to a later one."""

    before: Entry
    after: Entry
    comparison: Comparison


class BuildingSeries:
    """The maps of a building so far: its rooms by number, its tours, the map taken in last.

    Only the last map and those that showed rooms first (`_plans`) are held, never all of a series.
    """

    def __init__(self, number: int, first: Map) -> None:
        self.rooms: list[Room] = []
        self.tours: list[Tour] = []
        self._plans: list[Entry] = []
        self._names: dict[int, str] = {}
        self._seen: set[Recording] = set()
        self.last = self._take(Entry(number, first))

    def add(self, number: int, stored: Map) -> Step | None:
        """Take in the next map, or None where it fits to none of the building.

        It is compared with the newest map that it fits to, and laid out in the oldest, so that
        small errors do not add up over a long series.
        """
        for before in {entry.number: entry for entry in (self.last, *self._plans[::-1])}.values():
            comparison = _fits(before.stored, stored)
            if comparison is not None:
                break
        else:
            return None
        steps = (comparison.old_from_new, *before.steps)
        first = self._plans[0]
        if before is not first:
            direct = _fits(first.stored, stored)
            steps = steps if direct is None else (direct.old_from_new,)
        self.last = self._take(Entry(number, stored, steps))
        return Step(before, self.last, comparison)

    def name_of(self, room: Room) -> str:
        """The last name that a person gave to a room, or a number."""
        return self._names.get(room.number, room_name(room.number))

    def _take(self, entry: Entry) -> Entry:
        """Find the rooms of a map and count its recordings."""
        labels, known = entry.stored.labels, len(self.rooms)
        submaps, places = labels.submaps, entry.to_building(labels.poses[:, :2])
        # the room of each keyframe by the maps before, the oldest first
        rooms = np.full(len(places), NO_SUBMAP, dtype=np.int64)
        for plan in self._plans:
            owners = plan.stored.regions.owners(plan.from_building(places))
            first_of = {room.node.id: room.number for room in plan.added}
            rooms = np.where(rooms == NO_SUBMAP, _looked_up(owners, first_of), rooms)
        # submaps become rooms where most of their keyframes are in no room yet
        for node in entry.stored.record.nodes:
            own = submaps == node.id
            if own.any() and (rooms[own] == NO_SUBMAP).mean() > _MOST:
                self.rooms.append(Room(len(self.rooms), entry.number, node))
        added = tuple(self.rooms[known:])
        new = {room.node.id: room.number for room in added}
        rooms = np.where(rooms == NO_SUBMAP, _looked_up(submaps, new), rooms)
        room_of = {}
        for id_ in np.unique(submaps[submaps != NO_SUBMAP]).tolist():
            inside = rooms[(submaps == id_) & (rooms != NO_SUBMAP)]
            if len(inside):
                room_of[id_] = int(np.bincount(inside).argmax())
        entry = replace(entry, room_of=room_of, added=added)
        if added:
            self._plans.append(entry)
        self._tours(entry.stored, labels, rooms)
        for id_, name in entry.stored.names.items():
            if id_ in entry.room_of:
                self._names[entry.room_of[id_]] = name
        return entry

    def _tours(self, stored: Map, labels: Labels, rooms: IntArray) -> None:
        """Count the recordings that no earlier map of the building was made of."""
        least_m = stored.config.segmentation.region_min_m
        for log, way_m in zip(stored.logs, ways_m(stored.logs, labels), strict=True):
            recording = log.name, log.start_ns, log.end_ns
            if log.keyframes is None or recording in self._seen:
                continue
            self._seen.add(recording)
            own = slice(log.keyframes[0], log.keyframes[1] + 1)
            part = Labels(
                stamps_ns=labels.stamps_ns[own],
                poses=labels.poses[own],
                submaps=labels.submaps[own],
            )
            if len(part.stamps_ns):
                settled = settle_labels(rooms[own], part.poses, least_m)
                self.tours.append(tour_of(part, settled, way_m))


def _fits(old: Map, new: Map) -> Comparison | None:
    try:
        return compare_maps(old, new)
    except NoResultError:
        return None


def _looked_up(ids: IntArray, table: Mapping[int, int]) -> IntArray:
    """(n,) what a table says of each id, NO_SUBMAP where it says nothing."""
    return np.array([table.get(id_, NO_SUBMAP) for id_ in ids.tolist()], dtype=np.int64)
