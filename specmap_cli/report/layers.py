"""The layers of the map: what is drawn of a map directory, and what differs from an older map."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from specmap_cli.core.geometry import BentMotion, FloatArray
from specmap_cli.core.records import BoolArray, Closure, IntArray
from specmap_cli.drawing.overview import drawn_as
from specmap_cli.drawing.palette import Colour, colours_of
from specmap_cli.drawing.sheet import extent_of
from specmap_cli.maps.comparison import ComparisonRecord
from specmap_cli.maps.rooms import link_line
from specmap_cli.maps.store import Map
from specmap_cli.report.html import Frame, fill_names, outlines, path_data, shown
from specmap_cli.topology.regions import NOBODY

MOST_REFUSED = 400  # refused closures that are drawn: those with the largest xi


class DrawnMap:
    """A stored map as a drawing needs it. A divided floor plan has no keyframes.

    Every property raises MapError when a file is damaged.
    """

    def __init__(self, stored: Map) -> None:
        self.stored = stored

    @cached_property
    def lost(self) -> FloatArray:
        """(n, 2) where scans were taken that could not be registered: guesses."""
        trajectory = self.stored.trajectory
        lost = trajectory.lost
        return np.zeros((0, 2)) if lost is None else trajectory.poses[lost, :2]

    @cached_property
    def frame(self) -> Frame:
        """The part of the map to draw: what is known, and the way, which may lead out of it."""
        low, high = extent_of(self.stored.regions)
        return Frame.around(np.vstack([low, high, self.stored.keyframes.poses[:, :2], self.lost]))

    @cached_property
    def fills(self) -> dict[int, Colour]:
        """The colour of each submap."""
        return colours_of(self.stored.topology, self.stored.regions)

    @cached_property
    def names(self) -> dict[int, str]:
        """What the submaps are called: by a person, or by their numbers."""
        return {id_: shown(node.name) for id_, node in self.stored.rooms.items()}

    @property
    def walls(self) -> str:
        """The walls as path data."""
        return path_data(self.rings(self.stored.regions.grid.occupied), closed=True)

    @property
    def seen(self) -> str:
        """What was only seen and belongs to no submap, as path data."""
        unowned = self.stored.regions.grid.free & (self.stored.regions.owner == NOBODY)
        return path_data(self.rings(unowned), closed=True)

    def rings(self, cells: BoolArray) -> list[IntArray]:
        """Outlines and holes of cells (H, W) of the whole grid, in the drawing."""
        return [self.frame.places(ring) for ring in outlines(cells, self.stored.regions.grid)]


def regions_of(map_: DrawnMap) -> list[dict[str, Any]]:
    """The submaps by id: `outline`, `rim` of the largest part, `box` (left, top, width, height)."""
    names = fill_names(map_.fills.values())
    found = []
    for id_, room in map_.stored.rooms.items():
        rings = map_.rings(map_.stored.regions.owner == id_)
        badge = map_.frame.place(room.place)
        points = np.vstack([np.array([badge]), *rings])
        (left, top), (right, bottom) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
        found.append(
            {
                "id": id_,
                "fill": names[map_.fills[id_]],
                "outline": path_data(rings, closed=True),
                "rim": map_.frame.line(room.outline, closed=True),
                "badge": badge,
                "box": (left, top, right - left, bottom - top),
            }
        )
    return found


def links_of(map_: DrawnMap) -> list[dict[str, Any]]:
    """The ways of the map, or straight lines where the robot is too wide for every way.

    Each has a `kind`, as it is drawn, and a `line`, and may be `forbidden`.
    """
    edges = map_.stored.topology.edges
    found = []
    for record in map_.stored.record.edges:
        kind = drawn_as(map_.stored.topology, edges[record.source, record.target])
        drawn = map_.frame.line(link_line(record, map_.stored.rooms))
        found.append({"kind": kind, "line": drawn, "forbidden": record.forbidden})
    return found


def closures_of(map_: DrawnMap) -> tuple[dict[str, list[dict[str, Any]]], int]:
    """Those `accepted`, those `refused` with the largest xi, and how many were refused in all."""
    poses = map_.stored.keyframes.poses
    places = {}  # where the robot was in the middle of each stay
    for stay in map_.stored.record.graph.stays:
        left = sum(last - first + 1 for first, last in stay.runs) // 2
        for first, last in stay.runs:  # counted: a damaged map may have runs of any length
            middle = min(first + left, last)
            if first + left <= last:
                break
            left -= last - first + 1
        if middle < len(poses):
            places[stay.number] = poses[middle, :2]

    def mark(closure: Closure) -> dict[str, Any]:
        line = map_.frame.line(np.array([places[closure.new], places[closure.old]]))
        xi = None if math.isnan(closure.xi) else closure.xi
        return {"line": line, "xi": xi, "reason": closure.reason}

    closures = map_.stored.record.graph.closures
    known = [each for each in closures if {each.new, each.old} <= places.keys()]
    refused = [each for each in known if not each.merged]
    drawn = sorted(refused, key=lambda one: 0.0 if math.isnan(one.xi) else -one.xi)[:MOST_REFUSED]
    accepted = [mark(each) for each in known if each.merged]
    marks = {"accepted": accepted, "refused": [mark(each) for each in drawn]}
    return marks, len(refused)


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
