"""The topological map: submaps, the edges between them, the closures that were considered.

What a person decided of it stands here, too: what was said of a submap, and which borders between
submaps were moved: two made one, or one cut in two along a line.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Literal

from pydantic import Field

from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2, path_length
from specmap_cli.core.json_values import (
    Amount,
    Corners,
    Count,
    Motion,
    Number,
    Point,
    PropertyValue,
    Span,
    StampNs,
    Value,
    Written,
    titled,
)
from specmap_cli.core.records import Closure, Labels
from specmap_cli.grids.gridmap import GridMap

EdgeKind = Literal["traversed", "closure", "loose", "seen", "doorway"]
# What a submap is by its shape (`topology.regions`), or by a person's word.
SubmapKind = Literal["room", "corridor", "hall"]


@dataclass(frozen=True, slots=True)
class Visit(Value):
    """One visit of the robot to a submap."""

    start_ns: Annotated[StampNs, Field(alias="start")]
    """stamp of its first keyframe, seconds"""
    end_ns: Annotated[StampNs, Field(alias="end")]
    """stamp of its last keyframe, seconds"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Submap:
    """A region of the building with its own frame, grid and scans.

    `keyframes` are numbers in the keyframe store, ascending; `visits` are in order of time; `grid`
    and `polygon` (N, 2), metres, are in the submap's frame. One cut from a finished map has neither
    keyframes nor visits. `kind` is None where nobody has said it: then its shape says it. `anchor`
    (map frame) is a place in it where a robot can stand, with its clearance.
    """

    id: int
    map_from_submap: Pose2
    grid: GridMap
    keyframes: tuple[int, ...] = ()
    visits: tuple[Visit, ...] = ()
    polygon: FloatArray | None = None
    name: str = ""
    kind: SubmapKind | None = None
    properties: Mapping[str, PropertyValue] = field(default_factory=dict)
    anchor: tuple[float, float] | None = None
    anchor_clearance_m: float | None = None

    @property
    def given_name(self) -> str:
        """The name that a person gave it; empty without one."""
        return "" if self.name == default_name(self.id) else self.name


@dataclass(frozen=True, slots=True)
class Said(Value):
    """What a person said of a submap."""

    id: Count
    """of the node"""
    name: str | None = None
    """null where nobody named it"""
    kind: SubmapKind | None = None
    """null where its shape says it"""
    properties: dict[str, PropertyValue] = field(default_factory=dict)
    """those of the node"""


def default_name(submap: int) -> str:
    """What a submap is called until a person gives it a name."""
    return f"submap {submap}"


@dataclass(frozen=True, slots=True)
class Traversal(Value):
    """The robot went from one submap to another, and its pose at that moment."""

    stamp_ns: Annotated[StampNs, Field(alias="stamp")]
    """seconds"""
    source: Annotated[Count, Field(alias="from")]
    """id of the node that the robot left"""
    target: Annotated[Count, Field(alias="to")]
    """id of the node that it came to"""
    x: Number
    """of the robot, metres"""
    y: Number
    """of the robot, metres"""
    theta: Number
    """of the robot, radians"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Door(Value):
    """A narrow passage between two submaps: narrower than the space on both sides of it."""

    id: Count
    """what edges call it by; given afresh whenever a map is made"""
    x: Number
    """of its middle, metres"""
    y: Number
    """of its middle, metres"""
    width_m: Amount
    """clear width, unseen space being wall, metres"""
    theta: Number
    """direction of who goes through it from the first of `between` to the second, radians; its line
    stands across that"""
    between: tuple[Count, Count]
    """ids of two nodes, the smaller one first"""
    crossings: tuple[Traversal, ...] = ()
    """when the robot went through, in order"""
    driven: bool = False
    """whether it ever did; false: the door was only seen"""
    forbidden: bool = False
    """whether a person said that robots must not go through"""

    @property
    def sides(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """The two ends of its line, in the map: the wall on the right, and that on the left."""
        across = -math.sin(self.theta) * self.width_m / 2, math.cos(self.theta) * self.width_m / 2
        return (self.x - across[0], self.y - across[1]), (self.x + across[0], self.y + across[1])


@dataclass(frozen=True, slots=True, kw_only=True)
class Edge(Value):
    """An undirected link between two submaps."""

    source: Count
    """id of a node, smaller than `target`"""
    target: Count
    """id of a node"""
    kind: EdgeKind
    """traversed: the robot drove across; closure: it did not, but the grids match and the tracks
    meet; loose: only a guess joins them, across scans that could not be registered; seen: they
    touch, but the robot never went from one to the other; doorway: regions of a finished map that
    touch"""
    traversals: tuple[Traversal, ...] = ()
    """each crossing, in order"""
    doors: tuple[Count, ...] = ()
    """ids of the doors that `path` goes through, in order; none: it crosses an open border. Without
    a path: of all doors between the two"""
    path: Corners | None = None
    """from the anchor of `source` to that of `target`, inside the two submaps, through free cells
    that the robot can pass; null where it is too wide for every way"""
    length_m: Amount | None = None
    """along the path, metres; null without one"""
    clearance_m: Amount | None = None
    """the least on the path; without one that of the widest way, smaller than graph.robot_radius_m;
    null where no free cells join the two"""
    x: Number | None = None
    """of the first door on the path; in the open the mean of the traversals; null without them"""
    y: Number | None = None
    """as x"""
    distance_m: Amount = 0.0
    """from centroid to centroid, through the crossing"""
    width_m: Amount | None = None
    """of the first door on the path; null in the open"""
    source_from_target: Annotated[Motion, Field(alias="transform")] = IDENTITY
    """[x, y, theta] of the frame of `target` in the frame of `source`"""
    forbidden: bool = False
    """whether a person said that robots must not go there"""

    @property
    def crossing(self) -> Point | None:
        """Its door; in the open the mean place of the traversals, or None if it was not driven."""
        if self.traversals and (self.x is None or not self.doors):
            n = len(self.traversals)
            return sum(t.x for t in self.traversals) / n, sum(t.y for t in self.traversals) / n
        return None if self.x is None or self.y is None else (self.x, self.y)

    @property
    def corners(self) -> list[Point]:
        """The corners of the path; none without one."""
        return [] if self.path is None else [(x, y) for x, y in self.path.tolist()]


def edge_between(
    submaps: Mapping[int, Submap],
    pair: tuple[int, int],
    kind: EdgeKind,
    traversals: tuple[Traversal, ...] = (),
) -> Edge:
    """An edge between two submaps, the smaller id first, which has no way yet."""
    source, target = (submaps[id_].map_from_submap for id_ in pair)
    return Edge(
        source=pair[0],
        target=pair[1],
        kind=kind,
        traversals=traversals,
        source_from_target=source.inverse() @ target,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Stay(Value):
    """A piece of the way in which the robot saw a part of the map; closures compare such pieces."""

    number: Count
    """what closures call it by"""
    submap: Count
    """id of the node that most of its keyframes are in"""
    start_ns: Annotated[StampNs, Field(alias="start")]
    """stamp of its first keyframe, seconds"""
    end_ns: Annotated[StampNs, Field(alias="end")]
    """stamp of its last keyframe, seconds"""
    origin: Count
    """the keyframe whose pose is the frame of the stay"""
    runs: Annotated[tuple[Span, ...], Field(alias="keyframes", min_length=1)]
    """runs [first, last] of its keyframes, rows of labels.csv"""

    @property
    def keyframes(self) -> tuple[int, ...]:
        """The keyframes, ascending."""
        return tuple(number for first, last in self.runs for number in range(first, last + 1))


@dataclass(frozen=True, slots=True)
class Break(Value):
    """Tracking was lost before a keyframe, and restarted with it."""

    keyframe: Count
    """the keyframe, a row of labels.csv"""
    position_m: Number | None = None
    """how far odometry may be off over the break, metres; null where the motion is a guess"""
    heading_rad: Number | None = None
    """the same for the heading, radians"""


@dataclass(frozen=True, slots=True, kw_only=True)
class TopologicalMap:
    """Submaps by id, edges by (smaller id, larger id), every closure considered, and the doors.

    `stays` are in the order of their numbers, which `closures` use; `breaks` are ascending.
    `next_id` is beyond all ids that were ever given. `doors` are by id; ways keep `robot_radius_m`
    off what is not free, None where nobody looked for ways. `said` is what a person said of
    submaps, and `borders` which ones a person moved, as far as the map shows it. The mappings are
    not to be changed; `dataclasses.replace` makes another map.
    """

    submaps: Mapping[int, Submap] = field(default_factory=dict)
    edges: Mapping[tuple[int, int], Edge] = field(default_factory=dict)
    closures: tuple[Closure, ...] = ()
    stays: tuple[Stay, ...] = ()
    breaks: tuple[Break, ...] = ()
    next_id: int = 0
    doors: tuple[Door, ...] = ()
    robot_radius_m: float | None = None
    said: tuple[Said, ...] = ()
    borders: tuple[BorderEdit, ...] = ()

    @property
    def joined(self) -> list[tuple[int, int]]:
        """The pairs of submaps that the robot's way or a closure joins, and nobody forbade."""
        return [
            pair for pair, edge in self.edges.items() if edge.kind != "seen" and not edge.forbidden
        ]


@dataclass(frozen=True, slots=True)
class LogInfo(Value):
    """A recording that the map was made of, or a finished grid, which has no stamps."""

    __pydantic_config__ = titled("LogRecord")
    may_lack = frozenset({"path_m"})

    name: str
    """name of the file, without directories"""
    start_ns: Annotated[StampNs | None, Field(alias="start")] = None
    """stamp of the first scan, seconds; null for a grid"""
    end_ns: Annotated[StampNs | None, Field(alias="end")] = None
    """stamp of the last scan, seconds; null for a grid"""
    scans: Count = 0
    """number of its scans that were read"""
    keyframes: Span | None = None
    """first and last keyframe that it gave, rows of labels.csv; null where there are none or it is
    not known"""
    path_m: Amount | None = None
    """metres driven in it, where the map keeps only some of its keyframes; null where it
    keeps all"""


def starts_of(logs: Sequence[LogInfo]) -> tuple[int, ...]:
    """The keyframes with which the recordings after the first one begin."""
    return tuple(log.keyframes[0] for log in logs[1:] if log.keyframes is not None)


def ways_m(logs: Sequence[LogInfo], labels: Labels) -> list[float]:
    """Metres driven in each recording, from keyframe to keyframe; of dropped ones, as was known."""
    spans = [(0, 0) if log.keyframes is None else log.keyframes for log in logs]
    return [
        path_length(labels.poses[first : last + 1]) if log.path_m is None else log.path_m
        for log, (first, last) in zip(logs, spans, strict=True)
    ]


def driven_m(logs: Sequence[LogInfo], labels: Labels) -> float:
    """Metres driven in all recordings: the figure that every command tells of a map."""
    if any(log.keyframes is not None for log in logs):
        return sum(ways_m(logs, labels))
    return path_length(labels.poses)


@dataclass(frozen=True, slots=True, kw_only=True)
class Seen(Value):
    """A connected piece of what was only seen: free cells of no submap, which nobody entered."""

    area_m2: Amount
    """of its cells, square metres"""
    x: Number
    """of the cell in it that is farthest from its border, metres"""
    y: Number
    """of the same cell, metres"""


Line = tuple[Point, Point]  # its two ends, metres


@dataclass(frozen=True, slots=True)
class Merge(Value):
    """One submap became part of another."""

    merge: tuple[Count, Count]
    """[kept, gone]: ids of the two"""
    runs: Annotated[tuple[Span, ...], Field(alias="keyframes")] = ()
    """runs [first, last] of the keyframes that came with it, rows of labels.csv"""
    known: Count = 0
    """number of keyframes that the map had then"""

    @property
    def kept(self) -> int:
        """The submap that the other one became part of."""
        return self.merge[0]

    @property
    def gone(self) -> int:
        """The submap that became part of the other one."""
        return self.merge[1]

    @property
    def keyframes(self) -> tuple[int, ...]:
        """The keyframes that came with it, of the `known` first ones of the map."""
        return tuple(number for first, last in self.runs for number in range(first, last + 1))


@dataclass(frozen=True, slots=True, kw_only=True)
class Split(Value):
    """A submap was cut along a line."""

    submap: Annotated[Count, Field(alias="split")]
    """id of the submap, and of what is left of the line"""
    new: Annotated[int | None, Written(Count)] = None
    """id of what is right of the line, seen along it"""
    line: Line
    """two places in the map, as a person gave them"""
    fence: Annotated[Line | None, Written(Line)] = None
    """the line from border to border of the submap; no region reaches across it"""


BorderEdit = Merge | Split


def bare(border: BorderEdit) -> BorderEdit:
    """A border as it was requested."""
    return Merge(border.merge) if isinstance(border, Merge) else replace(border, fence=None)


def fences_of(borders: Iterable[BorderEdit]) -> tuple[Line, ...]:
    """The lines that no region grows across."""
    return tuple(
        border.fence for border in borders if isinstance(border, Split) and border.fence is not None
    )


def heirs(submap: int, borders: Iterable[BorderEdit]) -> frozenset[int]:
    """What a submap became by the borders that were made after it was called so."""
    found = {submap}
    for border in borders:
        if isinstance(border, Merge) and border.gone in found:
            found = found - {border.gone} | {border.kept}
        elif isinstance(border, Split) and border.submap in found and border.new is not None:
            found.add(border.new)
    return frozenset(found)
