"""What differs from an older map, drawn on the new one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from specmap_cli.core.records import BoolArray
from specmap_cli.grids.bent import BentMotion
from specmap_cli.maps.comparison import ComparisonRecord
from specmap_cli.maps.store import Map
from specmap_cli.report.layers import DrawnMap
from specmap_cli.report.svg import Frame, outlines, path_data

_LEAST_DOOR_CM = 40.0  # of the mark of a way that was closed or opened


@dataclass(frozen=True, slots=True, kw_only=True)
class Changes:
    """What differs from an older map of the building, as a record and in words.

    `new_from_old` places the old map in the one that the report is about.
    """

    old: Map
    record: ComparisonRecord
    lines: tuple[str, ...]
    new_from_old: BentMotion


def old_map(changes: Changes, map_: DrawnMap) -> dict[str, Any]:
    """The older map in the drawing of the new one, and what differs.

    `walls` are its walls, `gone` the submaps that are no more, as path data; `was` says of submaps
    of the new map what they were in the old one.
    """
    old, record, frame = changes.old, changes.record, map_.frame

    def carried(cells: BoolArray) -> str:
        """Cells of the old map as path data in the drawing of the new one."""
        rings = outlines(cells, old.regions.grid)
        places = [frame.places(changes.new_from_old.apply(ring)) for ring in rings]
        return path_data(places, closed=True)

    names, submaps = record.old.names, record.submaps
    same = {one.new: names[one.old] for one in submaps.same}
    split = {new: f"a part of {names[one.old]}" for one in submaps.split for new in one.new}
    merged = {one.new: " and ".join(names[old] for old in one.old) for one in submaps.merged}
    new = dict.fromkeys(submaps.new, "not there")
    redrawn = dict.fromkeys(submaps.redrawn_new, "divided otherwise")
    lost = [*record.submaps.gone, *record.submaps.unseen]
    return {
        "name": changes.old.path.resolve().name,
        "walls": carried(old.regions.grid.occupied),
        "gone": carried(np.isin(old.regions.owner, lost)),
        "was": redrawn | new | merged | split | same,
        "changes": list(_changes(changes, frame)),
        "lines": changes.lines,
    }


def _changes(changes: Changes, frame: Frame) -> Iterator[dict[str, Any]]:
    """Each difference: its kind, in words, as path data, and its place in the drawing."""
    things, doors = changes.record.things, changes.record.doors
    for kind, some in (("appeared", things.appeared), ("vanished", things.vanished)):
        for thing in some:
            corners = frame.places(changes.new_from_old.apply(np.array(thing.corners)))
            words = f"{kind}: {thing.length_m:.1f} m × {thing.width_m:.1f} m"
            line = path_data([corners], closed=True)
            place = corners.mean(axis=0).round().astype(int).tolist()
            yield {"kind": kind, "words": words, "line": line, "place": place}
    for kind, ways in (("closed", doors.closed), ("opened", doors.opened)):
        for way in ways:
            place = frame.places(changes.new_from_old.apply(np.array([[way.x, way.y]])))
            half = max(way.width_m * 50.0, _LEAST_DOOR_CM)
            cross = np.array([[-half, -half], [half, half], [-half, half], [half, -half]])
            lines = np.rint(place + cross).astype(np.int64)
            words = f"way {kind}: {way.width_m:.1f} m wide"
            line = path_data([lines[:2], lines[2:]])
            yield {"kind": kind, "words": words, "line": line, "place": place[0].tolist()}
