"""What the page tells of each submap."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import Pose2
from specmap_cli.core.text import seconds
from specmap_cli.grids.gridmap import FREE, UNKNOWN, GridMap
from specmap_cli.grids.map_server import png_bytes
from specmap_cli.maps.schema import NodeRecord
from specmap_cli.report.evidence import Learned
from specmap_cli.report.ground import Ground
from specmap_cli.topology.topological_map import Door, default_name

_THUMBNAIL = 240  # pixels of the longer side, at most
_AROUND_M = 0.7  # shown round the outline of a submap
_LOOKS, _ALIKE = 6, 4  # features and submaps that are named
_NOTHING = Learned()
_GREYS = np.zeros(256, dtype=np.uint8)
_GREYS[[FREE, UNKNOWN]] = 255, 214


@dataclass(frozen=True, slots=True, kw_only=True)
class DoorLine:
    """A door of a submap, as its sheet tells of it."""

    id: int
    to: int
    width_m: float
    driven: bool
    forbidden: bool
    crossings: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Sheet:
    """All that is told of one submap; `doors` and open borders to `open_to` are its neighbours.

    `visits` are start and length in seconds. `thumbnail` is a PNG as a data URL.
    """

    node: NodeRecord
    named: bool
    doors: tuple[DoorLine, ...]
    open_to: tuple[int, ...]
    visits: tuple[tuple[float, float], ...]
    thumbnail: str
    thumbnail_size: tuple[int, int]
    learned: Learned

    @property
    def stayed_s(self) -> float:
        """Seconds that the robot spent there."""
        return sum(length for _, length in self.visits)

    @property
    def sides_m(self) -> tuple[float, float]:
        """The sides of the smallest upright box round its outline."""
        if not self.node.polygon:
            return 0.0, 0.0
        width, height = np.ptp(np.array(self.node.polygon), axis=0).tolist()
        return width, height


def sheets_of(ground: Ground, learned: Mapping[int, Learned]) -> list[Sheet]:
    """The sheets of all submaps, by id."""
    return [
        _sheet(node, ground, learned.get(id_, _NOTHING))
        for id_, node in sorted(ground.nodes.items())
    ]


def _sheet(node: NodeRecord, ground: Ground, learned: Learned) -> Sheet:
    doors = ground.stored.record.graph.doors
    thumbnail, size = _thumbnail(_close_up(ground.stored.grid(node.id), node))
    return Sheet(
        node=node,
        named=node.name != default_name(node.id),
        doors=tuple(_door(door, node.id) for door in doors if node.id in door.between),
        open_to=_open_to(node.id, ground),
        visits=tuple(
            (seconds(visit.start_ns), seconds(visit.end_ns) - seconds(visit.start_ns))
            for visit in node.visits
        ),
        thumbnail=thumbnail,
        thumbnail_size=size,
        learned=Learned(
            looks=learned.looks[:_LOOKS],
            scans=learned.scans,
            right=learned.right,
            alike=learned.alike[:_ALIKE],
        ),
    )


def _door(door: Door, submap: int) -> DoorLine:
    a, b = door.between
    return DoorLine(
        id=door.id,
        to=b if a == submap else a,
        width_m=door.width_m,
        driven=door.driven,
        forbidden=door.forbidden,
        crossings=len(door.crossings),
    )


def _open_to(submap: int, ground: Ground) -> tuple[int, ...]:
    """The neighbours that no door leads to."""
    ends = [
        (edge.source, edge.target)
        for edge in ground.stored.record.edges
        if submap in (edge.source, edge.target) and not edge.doors
    ]
    return tuple(sorted(b if a == submap else a for a, b in ends))


def _close_up(grid: GridMap, node: NodeRecord) -> GridMap:
    """The part of a submap's grid round its outline: it shows far more, seen through doors."""
    if not node.polygon:
        return grid
    frame = Pose2(node.x, node.y, node.theta)
    part = grid.near(frame.inverse().apply(np.array(node.polygon)), _AROUND_M)
    return part if part.cells.size else grid


def _thumbnail(grid: GridMap) -> tuple[str, tuple[int, int]]:
    """The grid of a submap, cropped to what is known, as a data URL, and its width and height."""
    known = np.argwhere(grid.cells != UNKNOWN)
    if not len(known):
        return "", (0, 0)
    (low, left), (high, right) = known.min(axis=0), known.max(axis=0) + 1
    picture: NDArray[Any] = _GREYS[grid.cells[low:high, left:right][::-1]]
    scale = min(1.0, _THUMBNAIL / max(picture.shape))
    if scale < 1.0:
        size = max(1, round(picture.shape[1] * scale)), max(1, round(picture.shape[0] * scale))
        picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    picture = picture & 0xF0  # sixteen greys: a third of the bytes
    data = base64.b64encode(png_bytes(picture)).decode("ascii")
    return f"data:image/png;base64,{data}", (picture.shape[1], picture.shape[0])
