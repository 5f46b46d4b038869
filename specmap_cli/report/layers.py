"""The layers of the page: what is drawn of a map directory, and what differs from an older map.

And what a report finds out from the scans, and the way of the robot, thinned for the page: it is
drawn as lines in colours, and is a table that a slider of time follows.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from specmap_cli.core.arrays import evenly, runs
from specmap_cli.core.geometry import BentMotion, FloatArray
from specmap_cli.core.records import BoolArray, Closure, IntArray, Labels
from specmap_cli.core.text import one_line
from specmap_cli.drawing.overview import drawn_as
from specmap_cli.drawing.palette import Colour, colours_of
from specmap_cli.drawing.sheet import extent_of, strokes
from specmap_cli.maps.comparison import ComparisonRecord
from specmap_cli.maps.rooms import link_line
from specmap_cli.maps.store import Map
from specmap_cli.report.html import (
    STEPS,
    Frame,
    fill_names,
    outlines,
    path_data,
    simplified,
)
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
        return {id_: one_line(node.name) for id_, node in self.stored.rooms.items()}

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


MOST_TESTS, MOST_NODES = 500, 90_000  # that a page keeps
_FINEST = 9  # steps of the strength of a node on either side


@dataclass(frozen=True, slots=True, kw_only=True)
class Learned:
    """What the classifier of a submap looks at, and which submaps are like it, with falling shares.

    That of features is of its votes; that of others of `scans` of the submap's own, of which the
    share `right` is told correctly.
    """

    features: tuple[tuple[str, float], ...] = ()
    scans: int = 0
    right: float = 0.0
    alike: tuple[tuple[int, float], ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class SplitTrial:
    """A test that might have split a submap, made when `keyframe` came.

    `eigenvalues` fall; number `chosen`, from 0, divides the way (0: none does). `nodes` (n, 2) are
    in the map; `sides` (n,) the eigenvector there, -1 to 1, positive on the robot's side.
    """

    keyframe: int
    eigenvalues: FloatArray
    chosen: int
    split: bool
    nodes: FloatArray
    sides: FloatArray

    @property
    def eigenvalue(self) -> float:
        """What is held against the threshold; 0 when no eigenvector divides the way."""
        return float(self.eigenvalues[self.chosen]) if self.chosen else 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """All of it. `notes` say what could not be found out, and why.

    `fit` (n,) is the share of the returns of each keyframe that lie on walls of the map, NaN for a
    scan without any. `threshold` is the eigenvalue above which a submap is split.
    """

    learned: Mapping[int, Learned] = field(default_factory=dict)
    fit: FloatArray | None = None
    tests: tuple[SplitTrial, ...] = ()
    threshold: float = 1.0
    notes: tuple[str, ...] = ()


def spectra_of(evidence: Evidence, seconds: Sequence[float], frame: Frame) -> dict[str, Any]:
    """The tests that are kept, of `total` in all, and what the page needs to draw each.

    `dots` are those in the chart, each with the `seconds` of recording of its keyframe; `table` has
    of each at most so many nodes.
    """
    # all that split a submap, and others, evenly spread
    splits, others = (
        np.array([k for k, one in enumerate(evidence.tests) if one.split == split], dtype=np.int64)
        for split in (True, False)
    )
    some = evenly(splits, MOST_TESTS)
    more = evenly(others, MOST_TESTS - len(some)) if len(some) < MOST_TESTS else others[:0]
    kept = [evidence.tests[k] for k in sorted([*some.tolist(), *more.tolist()])]
    most = MOST_NODES // max(len(kept), 1)
    return {
        "dots": [(seconds[one.keyframe], one) for one in kept],
        "table": [_row(one, seconds[one.keyframe], most, frame) for one in kept],
        "threshold": evidence.threshold,
        "total": len(evidence.tests),
        "thinned": any(len(one.nodes) > most for one in kept),
    }


def _row(test: SplitTrial, seconds: float, most: int, frame: Frame) -> dict[str, Any]:
    """A test for the page: `nodes` are x, y and strength in a row."""
    kept = evenly(np.arange(len(test.nodes)), most)
    strength = np.rint(test.sides[kept] * _FINEST).astype(np.int64)
    nodes = np.column_stack([frame.places(test.nodes[kept]), strength])
    return {
        "t": round(seconds, 1),
        "values": np.round(test.eigenvalues, 3).tolist(),
        "chosen": test.chosen,
        "split": test.split,
        "nodes": nodes.reshape(-1).tolist(),
    }


MOST_POINTS = 6000  # of the way: a screen shows no more
_STRAY_CM = 2.0  # how far the drawn line may lie off the way
FIT_STEPS = (0.5, 0.7, 0.85, 0.95)  # where the colours of the fit change
_NO_FIT = -1


@dataclass(frozen=True, slots=True)
class Track:
    """The keyframes that the page keeps, of `total` in all.

    `seconds` (n,) of recording, without the pauses between recordings; `poses` (n, 3) in the map;
    `submaps` (n,); `fit` (n,) or None; `starts` are the seconds at which recordings begin.
    """

    seconds: FloatArray
    poses: FloatArray
    submaps: IntArray
    fit: FloatArray | None
    starts: tuple[float, ...]
    total: int

    @classmethod
    def of(cls, labels: Labels, starts: Sequence[int], fit: FloatArray | None) -> Track:
        """The way by its keyframes; recordings after the first begin with keyframes `starts`."""
        seconds = running_seconds(labels.stamps_ns, starts)
        kept = evenly(np.arange(len(seconds)), MOST_POINTS)
        return cls(
            seconds=seconds[kept],
            poses=labels.poses[kept],
            submaps=labels.submaps[kept],
            fit=None if fit is None else fit[kept],
            starts=tuple(float(seconds[start]) for start in (0, *starts) if start < len(seconds)),
            total=len(seconds),
        )

    @property
    def duration_s(self) -> float:
        """Seconds of recording."""
        return float(self.seconds[-1]) if len(self.seconds) else 0.0

    def by_time(self, frame: Frame) -> list[tuple[int, str]]:
        """Path data by class of time, early to late."""
        classes = (self.seconds / max(self.duration_s, 1e-9) * STEPS).astype(np.int64)
        return self._lines(np.minimum(classes, STEPS - 1), frame)

    def by_fit(self, frame: Frame) -> list[tuple[int, str]]:
        """Path data by class of fit, from bad to good; nothing where it is not known."""
        if self.fit is None:
            return []
        classes = np.searchsorted(FIT_STEPS, self.fit, side="right")
        return self._lines(np.where(np.isnan(self.fit), _NO_FIT, classes), frame)

    def _lines(self, classes: IntArray, frame: Frame) -> list[tuple[int, str]]:
        places = self.poses[:, :2]
        found: dict[int, list[IntArray]] = {}
        for stroke in strokes(places, classes):
            line = frame.places(places[stroke.first : stroke.drawn_to])
            found.setdefault(int(classes[stroke.first]), []).append(simplified(line, _STRAY_CM))
        return [(of, path_data(lines)) for of, lines in sorted(found.items()) if of != _NO_FIT]

    def visits(self) -> list[tuple[float, float, int]]:
        """Stays in submaps: seconds of their start and their end, and the submap."""
        found = []
        for first, end in runs(self.submaps):
            until = self.seconds[min(end, len(self.seconds) - 1)]
            found.append((float(self.seconds[first]), float(until), int(self.submaps[first])))
        return found

    def table(self, frame: Frame) -> dict[str, Any]:
        """The same for the page: steps of tenths of a second, of centimetres, degrees, percent."""
        x, y = frame.places(self.poses[:, :2]).T
        fit = None if self.fit is None else np.rint(np.nan_to_num(self.fit, nan=-0.01) * 100.0)
        return {
            "t": _steps(np.rint(self.seconds * 10.0)),
            "x": _steps(x),
            "y": _steps(y),
            "a": np.rint(np.degrees(self.poses[:, 2])).astype(np.int64).tolist(),
            "s": [[int(self.submaps[first]), end - first] for first, end in runs(self.submaps)],
            "fit": None if fit is None else fit.astype(np.int64).tolist(),
            "starts": [round(start, 1) for start in self.starts],
        }


def running_seconds(stamps_ns: IntArray, starts: Sequence[int]) -> FloatArray:
    """(n,) seconds of recording at each keyframe; between recordings no time passes."""
    steps = np.diff(stamps_ns, prepend=stamps_ns[:1]) / 1e9
    steps[[start for start in starts if start < len(steps)]] = 0.0
    return np.asarray(np.cumsum(np.maximum(steps, 0.0)))


def _steps(values: Any) -> list[int]:
    """The first of some whole numbers, then what each is more than the one before."""
    whole = np.asarray(values).astype(np.int64)
    return np.diff(whole, prepend=0).tolist() if len(whole) else []
