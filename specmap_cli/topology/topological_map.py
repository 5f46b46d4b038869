"""The topological map: submaps, the edges between them, the closures that were considered."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2
from specmap_cli.core.records import Closure, Labels
from specmap_cli.core.tracks import path_length
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.topology.borders import Border

# traversed: the robot drove across; closure: joined by matching grids only; loose: joined by a
# guess across scans that could not be registered; seen: they touch, but the robot never went from
# one to the other; doorway: regions of a finished map that touch.
EdgeKind = Literal["traversed", "closure", "loose", "seen", "doorway"]
# What a submap is by its shape (`topology.kinds`), or by a person's word.
SubmapKind = Literal["room", "corridor", "hall"]
Property = str | float | bool  # of a submap, by a person's word


@dataclass(frozen=True, slots=True)
class Visit:
    """One stay in a submap, by the header stamps of its first and last keyframe."""

    start_ns: int
    end_ns: int


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
    properties: Mapping[str, Property] = field(default_factory=dict)
    anchor: tuple[float, float] | None = None
    anchor_clearance_m: float | None = None

    @property
    def given_name(self) -> str:
        """The name that a person gave it; empty without one."""
        return "" if self.name == default_name(self.id) else self.name


@dataclass(frozen=True, slots=True)
class Said:
    """What a person said of a submap."""

    name: str = ""
    kind: SubmapKind | None = None
    properties: Mapping[str, Property] = field(default_factory=dict)


def default_name(submap: int) -> str:
    """What a submap is called until a person gives it a name."""
    return f"submap {submap}"


@dataclass(frozen=True, slots=True)
class Traversal:
    """The robot crossed from one submap to another at `pose` (map frame)."""

    stamp_ns: int
    source: int
    target: int
    pose: Pose2


@dataclass(frozen=True, slots=True, kw_only=True)
class Door:
    """A narrow passage between two submaps, `between` the smaller id and the larger.

    `x`, `y` are its middle in the map, `width_m` the clear width from wall to wall, `theta` the
    direction of who goes through it from the first submap to the second. `crossings` are the
    traversals that went through it, in order of time: none for a door that was only seen.
    `forbidden`: a person said that robots must not go through.
    """

    id: int
    x: float
    y: float
    width_m: float
    theta: float
    between: tuple[int, int]
    crossings: tuple[Traversal, ...] = ()
    forbidden: bool = False

    @property
    def driven(self) -> bool:
        """Whether the robot went through it."""
        return bool(self.crossings)

    @property
    def sides(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """The two ends of its line, in the map: the wall on the right, and that on the left."""
        across = -math.sin(self.theta) * self.width_m / 2, math.cos(self.theta) * self.width_m / 2
        return (self.x - across[0], self.y - across[1]), (self.x + across[0], self.y + across[1])


@dataclass(frozen=True, slots=True, kw_only=True)
class Edge:
    """An undirected link between two submaps, `source` < `target`.

    `traversals` are in order of time. `path` (N, 2), metres of the map, leads from anchor to anchor
    through `doors` (their ids; none in the open) at a clearance of `clearance_m`. It is None when
    the robot is too wide for every way: then `clearance_m` is that of the widest, or None.
    `doorway` (map frame) and `width_m` are of the first of the doors. `forbidden`: a person said
    that robots must not go there.
    """

    source: int
    target: int
    kind: EdgeKind
    traversals: tuple[Traversal, ...] = ()
    source_from_target: Pose2 = IDENTITY
    doorway: tuple[float, float] | None = None
    width_m: float | None = None
    doors: tuple[int, ...] = ()
    path: FloatArray | None = None
    length_m: float | None = None
    clearance_m: float | None = None
    forbidden: bool = False

    @property
    def crossing(self) -> tuple[float, float] | None:
        """Its door; in the open the mean place of the traversals, or None if it was not driven."""
        if self.doorway is not None or not self.traversals:
            return self.doorway
        n = len(self.traversals)
        return (
            sum(t.pose.x for t in self.traversals) / n,
            sum(t.pose.y for t in self.traversals) / n,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Stay:
    """A piece of the way, in which the robot saw a part of the map: what closures compare.

    `keyframes` are ascending, `start_ns` and `end_ns` the stamps of the first and the last of them;
    `submap` is where most of them ended. The pose of the keyframe `origin` is its frame: the first
    of them, unless the robot came back to the stay and earlier keyframes were added to it.
    """

    number: int
    submap: int
    keyframes: tuple[int, ...]
    origin: int
    start_ns: int
    end_ns: int

    @property
    def from_origin(self) -> tuple[int, ...]:
        """The keyframes, that of its frame before the others."""
        return (self.origin, *(keyframe for keyframe in self.keyframes if keyframe != self.origin))


@dataclass(frozen=True, slots=True)
class Break:
    """Tracking restarted with a keyframe.

    `bridge` is how far the motion to it may be off, metres and radians, None where it is a guess.
    """

    keyframe: int
    bridge: tuple[float, float] | None = None


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
    said: Mapping[int, Said] = field(default_factory=dict)
    borders: tuple[Border, ...] = ()

    @property
    def joined(self) -> list[tuple[int, int]]:
        """The pairs of submaps that the robot's way or a closure joins, and nobody forbade."""
        return [
            pair for pair, edge in self.edges.items() if edge.kind != "seen" and not edge.forbidden
        ]


@dataclass(frozen=True, slots=True)
class LogInfo:
    """What a map was made of: a recording, or a finished grid, which has no stamps.

    `name` is that of the file, without directories, which differ from machine to machine.
    `keyframes` are the first and the last that it gave, None for a grid. `path_m` is how far the
    robot drove, where the map keeps only some of its keyframes.
    """

    name: str
    start_ns: int | None = None
    end_ns: int | None = None
    scans: int = 0
    keyframes: tuple[int, int] | None = None
    path_m: float | None = None


def starts_of(logs: Sequence[LogInfo]) -> tuple[int, ...]:
    """The keyframes with which the recordings after the first one begin."""
    return tuple(log.keyframes[0] for log in logs[1:] if log.keyframes is not None)


def driven_m(logs: Sequence[LogInfo], labels: Labels) -> float:
    """Metres driven from keyframe to keyframe, each recording by itself."""
    ways = np.split(labels.poses, starts_of(logs))
    known = [log.path_m for log in logs if log.keyframes is not None]
    if len(known) != len(ways):
        return labels.driven_m(starts_of(logs))
    return sum(
        path_length(way) if driven is None else driven
        for way, driven in zip(ways, known, strict=True)
    )
