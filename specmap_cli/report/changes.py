"""What differs from an older map, drawn on the new one."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from specmap_cli.core.records import BoolArray
from specmap_cli.grids.bent import BentMotion
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.maps.comparison import ComparisonRecord, DoorRecord, ThingRecord
from specmap_cli.maps.store import StoredMap
from specmap_cli.report.layers import DrawnMap
from specmap_cli.report.svg import Frame, outlines, path_data

_LEAST_DOOR_CM = 40.0  # of the mark of a way that was closed or opened


@dataclass(frozen=True, slots=True, kw_only=True)
class Changes:
    """What differs from an older map of the building, as a record and in words.

    `new_from_old` places the old map in the one that the report is about.
    """

    old: StoredMap
    record: ComparisonRecord
    lines: tuple[str, ...]
    new_from_old: BentMotion


@dataclass(frozen=True, slots=True)
class Change:
    """One difference, of a kind `appeared`, `vanished`, `closed` or `opened`, and its place."""

    kind: str
    words: str
    line: str
    place: tuple[int, int]


def old_map(changes: Changes, map_: DrawnMap) -> dict[str, Any]:
    """The older map in the drawing of the new one, and what differs.

    `walls` are its walls, `gone` the submaps that are no more, as path data; `was` says of submaps
    of the new map what they were in the old one.
    """
    old, record, frame = DrawnMap(changes.old), changes.record, map_.frame
    grid, motion = old.regions.grid, changes.new_from_old
    lost = [*record.submaps.gone, *record.submaps.unseen]
    return {
        "name": changes.old.path.resolve().name,
        "walls": _carried(grid.occupied, grid, motion, frame),
        "gone": _carried(np.isin(old.regions.owner, lost), grid, motion, frame),
        "was": _was(record),
        "changes": list(_changes(changes, frame)),
        "lines": changes.lines,
    }


def _was(record: ComparisonRecord) -> dict[int, str]:
    """What became of the submaps, by the ids of the new map."""
    names, submaps = record.old.names, record.submaps
    same = {one.new: names[one.old] for one in submaps.same}
    split = {new: f"a part of {names[one.old]}" for one in submaps.split for new in one.new}
    merged = {one.new: " and ".join(names[old] for old in one.old) for one in submaps.merged}
    new = dict.fromkeys(submaps.new, "not there")
    redrawn = dict.fromkeys(submaps.redrawn_new, "divided otherwise")
    return redrawn | new | merged | split | same


def _carried(cells: BoolArray, grid: GridMap, motion: BentMotion, frame: Frame) -> str:
    """Cells of the old map as path data in the drawing of the new one."""
    rings = [frame.places(motion.apply(ring)) for ring in outlines(cells, grid)]
    return path_data(rings, closed=True)


def _changes(changes: Changes, frame: Frame) -> Iterable[Change]:
    record, motion = changes.record, changes.new_from_old
    for kind, things in (
        ("appeared", record.things.appeared),
        ("vanished", record.things.vanished),
    ):
        yield from (_thing(kind, thing, motion, frame) for thing in things)
    for kind, doors in (("closed", record.doors.closed), ("opened", record.doors.opened)):
        yield from (_door(kind, door, motion, frame) for door in doors)


def _thing(kind: str, thing: ThingRecord, motion: BentMotion, frame: Frame) -> Change:
    corners = frame.places(motion.apply(np.array(thing.corners)))
    words = f"{kind}: {thing.length_m:.1f} m × {thing.width_m:.1f} m"
    return Change(kind, words, path_data([corners], closed=True), _middle(corners.tolist()))


def _door(kind: str, door: DoorRecord, motion: BentMotion, frame: Frame) -> Change:
    place = frame.places(motion.apply(np.array([[door.x, door.y]])))[0]
    half = max(door.width_m * 50.0, _LEAST_DOOR_CM)
    cross = np.array([[-half, -half], [half, half], [-half, half], [half, -half]])
    lines = np.rint(place + cross).astype(np.int64)
    words = f"way {kind}: {door.width_m:.1f} m wide"
    x, y = place.tolist()
    return Change(kind, words, path_data([lines[:2], lines[2:]]), (x, y))


def _middle(corners: Sequence[Sequence[int]]) -> tuple[int, int]:
    x, y = np.mean(corners, axis=0).tolist()
    return round(x), round(y)
