"""What viewers show of a map: grids in colours, a colour for each submap, and the way driven."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2
from specmap_cli.core.json_values import Point
from specmap_cli.core.progress import Progress
from specmap_cli.drawing.palette import (
    DOOR,
    INK,
    PAPER,
    QUIET,
    TRAVERSED,
    WRONG,
    Colour,
    colour_graph,
    colours_of,
)
from specmap_cli.exports.flat_formats import DOOR as DOOR_FIELDS
from specmap_cli.exports.flat_formats import LINK, Fields, fields_of, link_line
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.maps import filenames
from specmap_cli.maps.schema import TopologyRecord
from specmap_cli.maps.store import StoredMap
from specmap_cli.maps.text_files import read_trajectory

RgbaArray = NDArray[np.uint8]
Rgb = tuple[int, int, int]

LAYER_STEP_M = 0.005  # each grid lies on the one before
_FILL_ALPHA = 150  # walls are seen through regions


def _rgb(colour: Colour) -> Rgb:
    blue, green, red = colour
    return red, green, blue


WAY, _UNDRIVEN, _FORBIDDEN, _DOOR = map(_rgb, (TRAVERSED, QUIET, WRONG, DOOR))


@dataclass(frozen=True, slots=True)
class Layer:
    """A grid in colours: `rgba` (H, W, 4), row 0 the lowest, its corner `origin` in `pose`.

    `pose` is where the frame of the grid lies in the map.
    """

    name: str
    rgba: RgbaArray
    resolution: float
    origin: tuple[float, float]
    pose: Pose2 = IDENTITY


def has_whole_map(stored: StoredMap) -> bool:
    """Whether a map has one grid of all; those of `specmap segment` have one a submap."""
    return (stored.path / f"{filenames.MAP_GRID}.yaml").exists()


def colours(stored: StoredMap) -> dict[int, Rgb]:
    """The colour of each submap: those of overview.png."""
    if has_whole_map(stored):
        found = colours_of(stored.topology, stored.regions)
    else:
        pairs = [(edge.source, edge.target) for edge in stored.record.edges]
        found = colour_graph(stored.ids, pairs)
    return {id_: _rgb(colour) for id_, colour in found.items()}


def layers(stored: StoredMap, fills: Mapping[int, Rgb]) -> Iterator[Layer]:
    """The grid of the whole map and its regions; else the grid of each submap."""
    if has_whole_map(stored):
        whole, owner = stored.map_grid, stored.regions.owner
        yield _layer("map", whole, _rgb(PAPER))
        rgba = np.zeros((*owner.shape, 4), dtype=np.uint8)
        for id_, colour in fills.items():
            rgba[owner == id_] = (*colour, _FILL_ALPHA)
        yield Layer("regions", rgba, whole.resolution, whole.origin)
        return
    for node in stored.record.nodes:
        pose = Pose2(node.x, node.y, node.theta)
        yield _layer(f"map/{node.id}", stored.grid(node.id), fills[node.id], pose)


def _layer(name: str, grid: GridMap, free: Rgb, pose: Pose2 = IDENTITY) -> Layer:
    rgba = np.zeros((*grid.cells.shape, 4), dtype=np.uint8)
    rgba[grid.cells == FREE] = (*free, 255)
    rgba[grid.cells == OCCUPIED] = (*_rgb(INK), 255)
    return Layer(name, rgba, grid.resolution, grid.origin, pose)


class GraphLine(NamedTuple):
    """A link or a door, as its `kind` says: its ids, and its line, which tells of itself."""

    kind: Literal["link", "door"]
    ids: str
    points: Sequence[Point]
    colour: Rgb
    told: Fields
    is_way: bool = True


def graph_lines(record: TopologyRecord) -> Iterator[GraphLine]:
    """The links, then the doors. A link without a way leads straight over its crossing.

    Blue where the robot drove, grey where it did not, or cannot; doors are brown; red is forbidden.
    """
    nodes = {node.id: node for node in record.nodes}
    for edge in record.edges:
        colour = WAY if edge.corners and edge.traversals else _UNDRIVEN
        yield GraphLine(
            "link",
            f"{edge.source}-{edge.target}",
            link_line(edge, nodes),
            _FORBIDDEN if edge.forbidden else colour,
            fields_of(edge, LINK),
            is_way=bool(edge.corners),
        )
    for door in record.graph.doors:
        colour = _FORBIDDEN if door.forbidden else _DOOR
        yield GraphLine("door", str(door.id), door.sides, colour, fields_of(door, DOOR_FIELDS))


def driven(stored: StoredMap) -> FloatArray:
    """(N, 3) the poses of all scans that could be registered; none of a map without a recording."""
    path = stored.path / filenames.TRAJECTORY
    if not path.exists():
        return np.zeros((0, 3))
    trajectory = read_trajectory(path, stored.limits)
    return trajectory.poses if trajectory.lost is None else trajectory.poses[~trajectory.lost]


def scans_of(stored: StoredMap, progress: Progress) -> AbstractContextManager[KeyframeStore | None]:
    """The keyframes of a map, one in memory at a time; None, and a note, for one without."""
    if (stored.path / filenames.KEYFRAMES).exists():
        return stored.keyframes()
    progress.note(f"{stored.path}: has no {filenames.KEYFRAMES}: written without scans")
    return nullcontext()


def start_of(stored: StoredMap) -> int:
    """The stamp of the first keyframe, nanoseconds; 0 without any."""
    if not (stored.path / filenames.LABELS).exists() or not len(stored.labels.stamps_ns):
        return 0
    return max(int(stored.labels.stamps_ns[0]), 0)
