"""Maps of many days, of one building or of several: rooms, visits by day, changes by map.

A room is a submap of the first map that showed its place. So it stays the same room however later
maps divide the building.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import tzinfo
from pathlib import Path
from typing import NamedTuple

import numpy as np

from specmap_cli.core.arrays import carried_on
from specmap_cli.core.errors import MapError, NoResultError, path_of
from specmap_cli.core.geometry import BentMotion, FloatArray, travelled
from specmap_cli.core.process import one_blas_thread
from specmap_cli.core.progress import Progress, Silent
from specmap_cli.core.records import NO_SUBMAP, IntArray
from specmap_cli.core.settings import LimitsConfig
from specmap_cli.core.text import encodable, to_json
from specmap_cli.history.record import (
    TABLES,
    BuildingRecord,
    ChangeKind,
    ChangeRecord,
    HistoryRecord,
    LeftOutRecord,
    MapRecord,
    RoomRecord,
    Tour,
    day_of,
    days_of,
    lines_of,
    of_a_job,
    render_history,
    room_name,
    settle_labels,
    tables_of,
    totals,
    tour_of,
    zone_of,
)
from specmap_cli.maps import filenames
from specmap_cli.maps.comparison import ComparisonRecord
from specmap_cli.maps.schema import NodeRecord
from specmap_cli.maps.store import Map, read_map
from specmap_cli.pipelines.compare import Comparison, compare_maps
from specmap_cli.pipelines.map_in_making import way_of_stored
from specmap_cli.pipelines.overlaps import stored_to_align
from specmap_cli.topology.differences import Obstacle
from specmap_cli.topology.graph import metres_in
from specmap_cli.topology.regions import NOBODY
from specmap_cli.topology.topological_map import ways_m

HISTORY, PAGE = "history.json", "history.html"
FILES = (HISTORY, PAGE, *TABLES)
_NS = 1_000_000_000
_TINY_M = 1e-9  # keeps a robot that never moved from dividing by nought


class HistoryReport(NamedTuple):
    """What the maps tell; `plans` are the first maps of the buildings."""

    record: HistoryRecord
    plans: tuple[Path, ...]

    def lines(self) -> list[str]:
        """The same for a person."""
        return lines_of(self.record)


@one_blas_thread()
def history_of(
    maps: Sequence[Path | str],
    timezone: str = "UTC",
    limits: LimitsConfig | None = None,
    progress: Progress | None = None,
) -> HistoryReport:
    """Rooms, visits and changes of maps, or of all maps in some directories, sorted by time.

    Maps that fit to one another are one building. A map that cannot be read is left out, and
    warned of. Raises UsageError for an unknown time zone, MapError when no map can be read.
    """
    progress = progress or Silent()
    zone = zone_of(timezone)
    readable, left_out = _dated(_found(maps), limits, progress)
    for one in left_out if readable else left_out[1:]:  # the error tells of the first
        progress.warn(f"left out: {one.reason}")
    if not readable:
        raise MapError(left_out[0].reason if left_out else "no maps were named")
    buildings: list[_Building] = []
    progress.start("comparing maps", len(readable))
    for number, path in enumerate(readable):
        stored = read_map(path, limits)
        newest_first = sorted(buildings, key=lambda one: -one.last.number)
        if not any(building.add(number, stored) for building in newest_first):
            buildings.append(_Building(number, path, stored, zone))
        progress.advance()
    record = HistoryRecord(
        schema_version=1,
        timezone=timezone,
        buildings=[one.record(number) for number, one in enumerate(buildings)],
        left_out=left_out,
    )
    return HistoryReport(record, tuple(one.path for one in buildings))


def write_history(
    report: HistoryReport, directory: Path, out: Path, limits: LimitsConfig | None = None
) -> None:
    """Write history.json, its tables and its page into the `result_directory` of `out`."""
    plans = [read_map(path, limits) for path in report.plans]
    (directory / HISTORY).write_text(to_json(report.record.model_dump()), encoding="utf-8")
    for name, text in tables_of(report.record).items():
        (directory / name).write_text(text, encoding="utf-8")
    page = render_history(report.record, plans, out)
    (directory / PAGE).write_text(page, encoding="utf-8")


def _found(paths: Sequence[Path | str]) -> Iterator[Path]:
    """Map directories: those named, and those in others; hidden ones are unfinished."""
    for given in paths:
        path = path_of(given, "maps")
        found = sorted(path.rglob(filenames.TOPOLOGY)) if path.is_dir() else []
        inside = [
            file.parent
            for file in found
            if not any(part.startswith(".") for part in file.relative_to(path).parts)
        ]
        if (path / filenames.TOPOLOGY).exists() or not inside:
            yield path
        else:
            yield from inside


def _dated(
    paths: Iterator[Path], limits: LimitsConfig | None, progress: Progress
) -> tuple[list[Path], list[LeftOutRecord]]:
    """The maps that can be read by the time of their last scan, and the others with the reason."""
    dated: list[tuple[int, str, Path]] = []
    left_out = []
    progress.start("reading maps", None)
    for path in dict.fromkeys(paths):
        try:
            stored = read_map(path, limits)
            if not len(stored.keyframes.stamps_ns):
                raise MapError("was not made of a recording: it knows no visits", where=path)
            stored_to_align(stored)  # all that a comparison needs
            way_of_stored(stored)
            dated.append((span_ns(stored)[1], str(path), path))
        except MapError as error:
            told = encodable(str(path)), encodable(str(error))
            left_out.append(LeftOutRecord(map=told[0], reason=told[1]))
    return [path for _, _, path in sorted(dated)], left_out


@dataclass(frozen=True, slots=True)
class Room:
    """A submap of the map `map_` in which the room was seen first.

    Its number is the submap's id, unless another room of the building has that.
    """

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


class _Building:
    """The maps of a building so far; only the last and those with new rooms (`_plans`) are held."""

    def __init__(self, number: int, path: Path, first: Map, zone: tzinfo) -> None:
        self.path, self._zone = path, zone
        self.rooms: list[Room] = []
        self.tours: list[Tour] = []
        self._plans: list[Entry] = []
        self._names: dict[int, str] = {}
        self._seen: set[tuple[str, int | None, int | None]] = set()  # name, first and last stamp
        self._maps: list[MapRecord] = []
        self._changes: list[ChangeRecord] = []
        self.last = self._take(Entry(number, first))

    def add(self, number: int, stored: Map) -> bool:
        """Take in the next map, unless it fits to none of the building.

        It is compared with the newest map that it fits to, and laid out in the oldest, so that
        small errors do not add up over a long series.
        """
        for before in {entry.number: entry for entry in (self.last, *self._plans[::-1])}.values():
            comparison = _fits(before.stored, stored)
            if comparison is not None:
                break
        else:
            return False
        steps = (comparison.old_from_new, *before.steps)
        first = self._plans[0]
        if before is not first:
            direct = _fits(first.stored, stored)
            steps = steps if direct is None else (direct.old_from_new,)
        found = comparison.record
        self.last = self._take(Entry(number, stored, steps), before, found.alignment.residual_m)
        self._changes.extend(_changes(found, before, self.last, self._zone))
        return True

    def record(self, number: int) -> BuildingRecord:
        """The building as history.json has it, called as the directory of its first map or job."""
        path = self.path.resolve()
        named = path.parent if of_a_job(path) else path
        return BuildingRecord(
            number=number,
            name=encodable(named.name),
            rooms=[self._room(room) for room in self.rooms],
            maps=self._maps,
            days=days_of(self.tours, self._zone),
            changes=self._changes,
        )

    def _room(self, room: Room) -> RoomRecord:
        """A room, called by the last name that a person gave to it, or by its number."""
        visits = [one for tour in self.tours for one in tour.visits if one.room == room.number]
        count, minutes = totals(visits).get(room.number, (0, 0.0))
        return RoomRecord(
            number=room.number,
            name=self._names.get(room.number, room_name(room.number)),
            map=room.map_,
            submap=room.node.id,
            area_m2=room.node.area_m2,
            visits=count,
            minutes=minutes,
            days=len({day_of(visit.start_ns, self._zone) for visit in visits}),
        )

    def _take(
        self, entry: Entry, before: Entry | None = None, residual_m: float | None = None
    ) -> Entry:
        """Find the rooms of a map and count its recordings; it was compared with one `before`."""
        submaps, rooms, known = entry.stored.labels.submaps, self._rooms(entry), len(self.rooms)
        room_of, most = dict[int, int](), dict[int, tuple[int, int]]()
        for node in entry.stored.record.nodes:
            own = submaps == node.id
            if not own.any():
                continue
            if (rooms[own] == NO_SUBMAP).all():
                taken = {room.number for room in self.rooms}
                number = 1 + max(taken) if node.id in taken else node.id
                self.rooms.append(Room(number, entry.number, node))
                rooms[own] = number
            inside = np.bincount(rooms[own & (rooms != NO_SUBMAP)])
            room_of[node.id] = room = int(inside.argmax())
            most[room] = max(most.get(room, (0, node.id)), (int(inside[room]), node.id))
        added = tuple(self.rooms[known:])
        entry = replace(entry, room_of=room_of, added=added)
        if added:
            self._plans.append(entry)
        self._count_tours(entry.stored, rooms)
        names = entry.stored.names
        self._names.update((room, names[id_]) for room, (_, id_) in most.items() if id_ in names)
        start_ns, end_ns = span_ns(entry.stored)
        self._maps.append(
            MapRecord(
                number=entry.number,
                map=encodable(str(entry.stored.path)),
                start=start_ns / _NS,
                end=end_ns / _NS,
                verdict=entry.stored.verdict,
                submaps=len(entry.stored.rooms),
                area_m2=entry.stored.record.area_m2,
                compared_with=None if before is None else before.number,
                residual_m=residual_m,
            )
        )
        return entry

    def _rooms(self, entry: Entry) -> IntArray:
        """(n,) the room of an earlier map that each keyframe of a map is in, NO_SUBMAP for none.

        A room counts in those submaps in which robots drove while they were in it: what they only
        looked into is not known. That of the oldest map has the place.
        """
        labels, least_m = entry.stored.labels, entry.stored.config.segmentation.region_min_m
        places = entry.to_building(labels.poses[:, :2])
        found = np.full(len(places), NO_SUBMAP, dtype=np.int64)
        for plan in self._plans:
            rooms = {room.node.id: room.number for room in plan.added}
            owners = _looked_up(plan.stored.regions.owners(plan.from_building(places)), rooms)
            before = plan.stored.labels
            way = entry.from_building(plan.to_building(before.poses[:, :2]))
            there = entry.stored.regions.owners(way)
            for id_, room in rooms.items():
                driven_m = metres_in(np.where(before.submaps == id_, there, NOBODY), way)
                known = [submap for submap, way_m in driven_m.items() if way_m >= least_m]
                inside = (owners == room) & np.isin(labels.submaps, known)
                found[inside & (found == NO_SUBMAP)] = room
        return found

    def _count_tours(self, stored: Map, rooms: IntArray) -> None:
        """Count the recordings that no earlier map of the building was made of."""
        labels, least_m = stored.labels, stored.config.segmentation.region_min_m
        way, rows = way_of_stored(stored)
        driven_m = travelled(way.poses)[rows]
        for log, length_m in zip(stored.logs, ways_m(stored.logs, labels), strict=True):
            recording = log.name, log.start_ns, log.end_ns
            if log.keyframes is None or recording in self._seen:
                continue
            self._seen.add(recording)
            own = slice(log.keyframes[0], log.keyframes[1] + 1)
            stamps_ns = labels.stamps_ns[own]
            known = rooms[own] != NO_SUBMAP
            if known.any():
                entered = carried_on(rooms[own], known)  # a place of no room is still the last one
                settled = settle_labels(entered, way.poses, rows[own], least_m)
                way_m = driven_m[own] - driven_m[own][0]
                way_m *= length_m / max(float(way_m[-1]), _TINY_M)
                self.tours.append(tour_of(stamps_ns, settled, way_m))


def _changes(
    found: ComparisonRecord, before: Entry, after: Entry, zone: tzinfo
) -> Iterator[ChangeRecord]:
    """What differs between two maps of a building, in its frame."""
    doors, things = found.doors, found.things

    def rooms_of(thing: Obstacle) -> list[int]:
        return before.rooms([thing.old_submap]) or after.rooms([thing.new_submap])

    def change(
        kind: ChangeKind, rooms: list[int], size: float | None, at: tuple[float, ...] = ()
    ) -> ChangeRecord:
        """A change at a place of the map before, or of a room."""
        x, y = before.to_building(np.array([at]))[0].tolist() if at else (None, None)
        return ChangeRecord(
            kind=kind,
            map=after.number,
            before=before.number,
            day=day_of(span_ns(after.stored)[1], zone),
            since=day_of(span_ns(before.stored)[1], zone),
            rooms=rooms,
            x=x,
            y=y,
            size=size,
        )

    for way in doors.closed:
        yield change("door-closed", before.rooms(way.between), way.width_m, (way.x, way.y))
    for way in doors.opened:
        yield change("door-opened", after.rooms(way.between), way.width_m, (way.x, way.y))
    for thing in things.appeared:
        yield change("appeared", rooms_of(thing), thing.area_m2, (thing.x, thing.y))
    for thing in things.vanished:
        yield change("vanished", rooms_of(thing), thing.area_m2, (thing.x, thing.y))
    for id_ in found.submaps.gone:
        yield change("room-gone", before.rooms([id_]), None)
    for room in after.added:
        yield change("room-added", [room.number], room.node.area_m2)


def span_ns(stored: Map) -> tuple[int, int]:
    """The stamps of a map's first and last keyframe."""
    stamps = stored.labels.stamps_ns
    return int(stamps.min()), int(stamps.max())


def _fits(old: Map, new: Map) -> Comparison | None:
    try:
        return compare_maps(old, new)
    except NoResultError:
        return None


def _looked_up(ids: IntArray, table: Mapping[int, int]) -> IntArray:
    """(n,) what a table says of each id, NO_SUBMAP where it says nothing."""
    return np.array([table.get(id_, NO_SUBMAP) for id_ in ids.tolist()], dtype=np.int64)
