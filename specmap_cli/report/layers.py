"""The layers of the map: what is drawn of it, ready for the page."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from specmap_cli.core.arrays import evenly
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.json_values import Span
from specmap_cli.core.records import Closure
from specmap_cli.drawing.overview import drawn_as
from specmap_cli.report.colours import fill_names
from specmap_cli.report.frame import Frame, path_data
from specmap_cli.report.ground import Ground, middle_of
from specmap_cli.report.tracing import traced
from specmap_cli.topology.regions import NOBODY, Regions

MOST_REFUSED = 400  # refused closures that are drawn: those with the largest xi

Box = tuple[int, int, int, int]  # left, top, width and height in the drawing


@dataclass(frozen=True, slots=True, kw_only=True)
class Region:
    """A submap on the map: its `outline` and the `rim` of its largest part as path data, its badge,
    and the `box` round it.
    """

    id: int
    fill: str
    outline: str
    rim: str
    badge: tuple[int, int]
    box: Box


@dataclass(frozen=True, slots=True, kw_only=True)
class Link:
    """A way between two submaps, a straight line where there is none; `kind` as it is drawn."""

    source: int
    target: int
    kind: str
    line: str
    forbidden: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class DoorMark:
    """A door from wall to wall."""

    id: int
    line: str
    middle: tuple[int, int]
    width_m: float
    between: tuple[int, int]
    driven: bool
    forbidden: bool


@dataclass(frozen=True, slots=True)
class Closures:
    """The closures that were accepted, and of `refused_known` refused ones those that are drawn."""

    accepted: list[ClosureMark]
    refused: list[ClosureMark]
    refused_known: int


@dataclass(frozen=True, slots=True, kw_only=True)
class ClosureMark:
    """Two places that loop closure compared."""

    line: str
    xi: float | None
    reason: str
    submaps: tuple[int | None, int | None]


def walls(regions: Regions, frame: Frame) -> str:
    """The walls as path data."""
    return path_data(traced(regions.grid.occupied, regions.grid, frame), closed=True)


def unreached(regions: Regions, frame: Frame) -> str:
    """What was seen and belongs to no submap, as path data."""
    cells = regions.grid.free & (regions.owner == NOBODY)
    return path_data(traced(cells, regions.grid, frame), closed=True)


def regions_of(ground: Ground) -> list[Region]:
    """The submaps on the map, by id."""
    names = fill_names(ground.fills.values())
    return [_region(id_, ground, names[ground.fills[id_]]) for id_ in sorted(ground.nodes)]


def _region(id_: int, ground: Ground, fill: str) -> Region:
    rings = traced(ground.regions.owner == id_, ground.regions.grid, ground.frame)
    node, frame = ground.nodes[id_], ground.frame
    badge = frame.place(middle_of(node))
    return Region(
        id=id_,
        fill=fill,
        outline=path_data(rings, closed=True),
        rim=path_data([frame.places(np.array(node.polygon))], closed=True),
        badge=badge,
        box=_box(np.vstack([np.array([badge]), *rings])),
    )


def _box(points: FloatArray) -> Box:
    (left, top), (right, bottom) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    return left, top, right - left, bottom - top


def links_of(ground: Ground) -> list[Link]:
    """The ways of the map, or straight lines where the robot is too wide for every way."""
    edges = ground.stored.topology.edges
    found = []
    for record in ground.stored.record.edges:
        ends = [middle_of(ground.nodes[id_]) for id_ in (record.source, record.target)]
        crossing = [] if record.x is None or record.y is None else [(record.x, record.y)]
        line = record.corners or [ends[0], *crossing, ends[1]]
        found.append(
            Link(
                source=record.source,
                target=record.target,
                kind=drawn_as(ground.stored.topology, edges[record.source, record.target]),
                line=path_data([ground.frame.places(np.array(line))]),
                forbidden=record.forbidden,
            )
        )
    return found


def doors_of(ground: Ground) -> list[DoorMark]:
    """The doors of the map. Where no robot drove, as through a floor plan, all are open alike."""
    frame, records = ground.frame, ground.stored.record.graph.doors
    nobody_drove = not any(record.driven for record in records)
    return [
        DoorMark(
            id=record.id,
            line=path_data([frame.places(np.array(record.sides))]),
            middle=frame.place((record.x, record.y)),
            width_m=record.width_m,
            between=record.between,
            driven=record.driven or nobody_drove,
            forbidden=record.forbidden,
        )
        for record in records
    ]


def closures_of(ground: Ground) -> Closures:
    """The closures that were accepted, and those refused with the largest xi."""
    places, frame = _places_of_stays(ground), ground.frame
    closures = ground.stored.record.graph.closures
    known = [each for each in closures if {each.new, each.old} <= places.keys()]
    accepted = [each for each in known if each.merged]
    refused = [each for each in known if not each.merged]
    drawn = sorted(refused, key=lambda one: 0.0 if math.isnan(one.xi) else -one.xi)[:MOST_REFUSED]
    return Closures(_marks(accepted, places, frame), _marks(drawn, places, frame), len(refused))


def _places_of_stays(ground: Ground) -> dict[int, FloatArray]:
    """A place (2,) of each stay: where the robot was in the middle of it."""
    poses = ground.labels.poses
    found = {}
    for stay in ground.stored.record.graph.stays:
        middle = _middle_of(stay.runs)
        if middle < len(poses):
            found[stay.number] = poses[middle, :2]
    return found


def _middle_of(runs: Sequence[Span]) -> int:
    """The keyframe in the middle of runs [first, last]."""
    half = sum(last - first + 1 for first, last in runs) // 2
    for first, last in runs:
        if first + half <= last:
            return first + half
        half -= last - first + 1
    return runs[-1][1]


def _marks(
    closures: Iterable[Closure], places: dict[int, FloatArray], frame: Frame
) -> list[ClosureMark]:
    return [
        ClosureMark(
            line=path_data([frame.places(np.array([places[each.new], places[each.old]]))]),
            xi=None if math.isnan(each.xi) else each.xi,
            reason=each.reason,
            submaps=(each.new_submap, each.old_submap),
        )
        for each in closures
    ]


def lost_places(ground: Ground, most: int = 500) -> list[tuple[int, int]]:
    """Where scans were lost, at most so many of these places."""
    return [(x, y) for x, y in ground.frame.places(evenly(ground.lost, most)).tolist()]
