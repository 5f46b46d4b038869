"""Maps of many days, of one building or of several: rooms, visits by day, changes by map."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from datetime import tzinfo
from pathlib import Path
from typing import Any

import numpy as np

from specmap_cli.core.errors import MapError, path_of
from specmap_cli.core.process import one_blas_thread
from specmap_cli.core.progress import Progress, Silent
from specmap_cli.core.settings import LimitsConfig
from specmap_cli.core.text import encodable, to_json
from specmap_cli.history.record import (
    SCHEMA_VERSION,
    TABLES,
    BuildingRecord,
    ChangeKind,
    ChangeRecord,
    HistoryRecord,
    LeftOutRecord,
    MapRecord,
    RoomRecord,
    day_of,
    days_of,
    lines_of,
    render_history,
    tables_of,
    totals,
    zone_of,
)
from specmap_cli.maps import filenames
from specmap_cli.maps.comparison import ThingRecord
from specmap_cli.maps.directory import OutputDirectory
from specmap_cli.maps.store import Map, read_map
from specmap_cli.pipelines.building_series import BuildingSeries, Entry, Room, Step
from specmap_cli.pipelines.overlaps import stored_to_align

HISTORY, PAGE = "history.json", "history.html"


@dataclass(frozen=True, slots=True)
class HistoryReport:
    """What the maps tell; `plans` are the first maps of the buildings."""

    record: HistoryRecord
    plans: tuple[Path, ...]

    @property
    def whole(self) -> bool:
        """Whether every map could be read."""
        return not self.record.left_out

    def as_dict(self) -> dict[str, Any]:
        """The same for a machine, as `history.record` has it."""
        return self.record.model_dump()

    def lines(self) -> list[str]:
        """The same for a person."""
        return lines_of(self.record)


@dataclass
class _Building:
    """A series of maps, and what was told of them."""

    series: BuildingSeries
    path: Path
    maps: list[MapRecord]
    changes: list[ChangeRecord] = field(default_factory=list)

    def record(self, number: int, zone: tzinfo) -> BuildingRecord:
        """The building as history.json has it.

        It is called as the directory of its first map, or that of the job which made it.
        """
        path = self.path.resolve()
        job = path.parent.name if path.name == "map" else ""
        return BuildingRecord(
            number=number,
            name=encodable(job or path.name),
            rooms=[_room(self.series, room, zone) for room in self.series.rooms],
            maps=self.maps,
            days=days_of(self.series.tours, zone),
            changes=self.changes,
        )


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
        for building in sorted(buildings, key=lambda one: -one.series.last.number):
            step = building.series.add(number, stored)  # the newest that it fits to takes it in
            if step is not None:
                building.maps.append(map_record(step.after, step))
                building.changes.extend(changes_of(step, zone))
                break
        else:
            series = BuildingSeries(number, stored)
            buildings.append(_Building(series, path, [map_record(series.last, None)]))
        progress.advance()
    record = HistoryRecord(
        schema_version=SCHEMA_VERSION,
        timezone=timezone,
        buildings=[one.record(number, zone) for number, one in enumerate(buildings)],
        left_out=left_out,
    )
    return HistoryReport(record, tuple(one.path for one in buildings))


def history_directory(
    out: Path | str, overwrite: bool = False, progress: Progress | None = None
) -> OutputDirectory:
    """The directory `out` for a history: entered before the work, it refuses what is in the way.

    What it gives is for `write_history`. Raises UsageError on entering.
    """
    ours = frozenset({HISTORY, PAGE, *TABLES}).__contains__
    return OutputDirectory(path_of(out, "out"), overwrite, progress, marker=HISTORY, ours=ours)


def write_history(
    report: HistoryReport, directory: Path, out: Path, limits: LimitsConfig | None = None
) -> None:
    """Write history.json, its tables and its page into the `history_directory` of `out`."""
    plans = [read_map(path, limits) for path in report.plans]
    (directory / HISTORY).write_text(to_json(report.as_dict()), encoding="utf-8")
    for name, text in tables_of(report.record).items():
        (directory / name).write_text(text, encoding="utf-8")
    page = render_history(report.record, plans, out)
    (directory / PAGE).write_text(page, encoding="utf-8")


def _found(paths: Sequence[Path | str]) -> Iterator[Path]:
    """Map directories: those named, and all that lie in other directories.

    Hidden ones are left out: maps are written there, or were when their run was killed.
    """
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
            dated.append((span_ns(stored)[1], str(path), path))
        except MapError as error:
            told = encodable(str(path)), encodable(str(error))
            left_out.append(LeftOutRecord(map=told[0], reason=told[1]))
    return [path for _, _, path in sorted(dated)], left_out


_NS = 1_000_000_000


def span_ns(stored: Map) -> tuple[int, int]:
    """The stamps of a map's first and last keyframe."""
    stamps = stored.labels.stamps_ns
    return int(stamps.min()), int(stamps.max())


def map_record(entry: Entry, step: Step | None) -> MapRecord:
    """A map as history.json has it; `step` is that from an earlier map to it."""
    stored = entry.stored
    start_ns, end_ns = span_ns(stored)
    return MapRecord(
        number=entry.number,
        map=encodable(str(stored.path)),
        start=start_ns / _NS,
        end=end_ns / _NS,
        verdict=stored.verdict,
        submaps=len(stored.rooms),
        area_m2=stored.record.area_m2,
        compared_with=None if step is None else step.before.number,
        residual_m=None if step is None else step.comparison.record.alignment.residual_m,
    )


def changes_of(step: Step, zone: tzinfo) -> Iterator[ChangeRecord]:
    """What differs between two maps of a series, in the frame of the building."""
    found, before, after = step.comparison.record, step.before, step.after
    doors, things = found.doors, found.things

    def rooms_of(thing: ThingRecord) -> list[int]:
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
