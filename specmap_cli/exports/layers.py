"""What viewers show of a map: grids in colours, a colour for each submap, and the way driven."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.json_values import Point
from specmap_cli.core.progress import Progress
from specmap_cli.drawing import palette
from specmap_cli.grids.gridmap import FREE, OCCUPIED
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.maps import filenames
from specmap_cli.maps.rooms import DOOR as DOOR_FIELDS
from specmap_cli.maps.rooms import LINK, Fields, fields_of, link_line
from specmap_cli.maps.store import Map

RgbaArray = NDArray[np.uint8]
Rgb = tuple[int, int, int]

LAYER_STEP_M = 0.005  # each grid lies on the one before
_FILL_ALPHA = 150  # walls are seen through regions


def _rgb(colour: palette.Colour) -> Rgb:
    blue, green, red = colour
    return red, green, blue


WAY, _UNDRIVEN, _FORBIDDEN, _DOOR = map(
    _rgb, (palette.TRAVERSED, palette.QUIET, palette.WRONG, palette.DOOR)
)


@dataclass(frozen=True, slots=True)
class Layer:
    """A grid in colours: `rgba` (H, W, 4), row 0 the lowest, its corner `origin` in the map."""

    name: str
    rgba: RgbaArray
    resolution: float
    origin: tuple[float, float]


def colours(stored: Map) -> dict[int, Rgb]:
    """The colour of each submap: those of overview.png."""
    found = palette.colours_of(stored.topology, stored.regions)
    return {id_: _rgb(colour) for id_, colour in found.items()}


def layers(stored: Map, fills: Mapping[int, Rgb]) -> Iterator[Layer]:
    """The grid of the whole map, and its regions."""
    grid, owner = stored.regions.grid, stored.regions.owner
    whole, regions = (np.zeros((*owner.shape, 4), dtype=np.uint8) for _ in range(2))
    whole[grid.cells == FREE] = (*_rgb(palette.PAPER), 255)
    whole[grid.cells == OCCUPIED] = (*_rgb(palette.INK), 255)
    yield Layer("map", whole, grid.resolution, grid.origin)
    for id_, colour in fills.items():
        regions[owner == id_] = (*colour, _FILL_ALPHA)
    yield Layer("regions", regions, grid.resolution, grid.origin)


class GraphLine(NamedTuple):
    """A link or a door, as its `kind` says: its ids, and its line, which tells of itself."""

    kind: Literal["link", "door"]
    ids: str
    points: Sequence[Point]
    colour: Rgb
    told: Fields
    is_way: bool = True


def graph_lines(stored: Map) -> Iterator[GraphLine]:
    """The links, then the doors. A link without a way leads straight over its crossing.

    Blue where the robot drove, grey where it did not, or cannot; doors are brown; red is forbidden.
    """
    for edge in stored.record.edges:
        colour = WAY if edge.corners and edge.traversals else _UNDRIVEN
        yield GraphLine(
            "link",
            f"{edge.source}-{edge.target}",
            link_line(edge, stored.rooms),
            _FORBIDDEN if edge.forbidden else colour,
            fields_of(edge, LINK),
            is_way=bool(edge.corners),
        )
    for door in stored.doors:
        colour = _FORBIDDEN if door.forbidden else _DOOR
        yield GraphLine("door", str(door.id), door.sides, colour, fields_of(door, DOOR_FIELDS))


def scans_of(stored: Map, progress: Progress) -> AbstractContextManager[KeyframeStore | None]:
    """The keyframes of a map, one in memory at a time; None, and a note, for one without."""
    if (stored.path / filenames.KEYFRAMES).exists():
        return stored.scans()
    progress.note(f"{stored.path}: has no {filenames.KEYFRAMES}: written without scans")
    return nullcontext()
