"""What a map directory shows: its regions and the way of the robot, if it has one."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cached_property

import numpy as np

from specmap_cli.core.errors import TOO_LARGE, MapError
from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import BoolArray, Labels
from specmap_cli.drawing.palette import Colour, colours_of
from specmap_cli.drawing.sheet import extent_of
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from specmap_cli.maps import filenames
from specmap_cli.maps.schema import NodeRecord
from specmap_cli.maps.store import StoredMap
from specmap_cli.maps.tum import read_trajectory
from specmap_cli.report.frame import Frame
from specmap_cli.report.words import shown
from specmap_cli.topology.regions import NOBODY, Regions
from specmap_cli.topology.shapes import outline_of
from specmap_cli.topology.topological_map import starts_of

_NO_LABELS = Labels(
    stamps_ns=np.zeros(0, dtype=np.int64),
    poses=np.zeros((0, 3)),
    submaps=np.zeros(0, dtype=np.int64),
)


class Ground:
    """A stored map as a drawing needs it. A divided floor plan has no keyframes and no whole grid.

    Every property raises MapError when a file is damaged.
    """

    def __init__(self, stored: StoredMap) -> None:
        self.stored = stored

    @cached_property
    def labels(self) -> Labels:
        """The keyframes; none of a divided floor plan."""
        known = (self.stored.path / filenames.LABELS).exists()
        return self.stored.labels if known else _NO_LABELS

    @cached_property
    def regions(self) -> Regions:
        """The map divided among the submaps."""
        if (self.stored.path / f"{filenames.MAP_GRID}.yaml").exists():
            return self.stored.regions
        return _composed(self.stored)

    @cached_property
    def lost(self) -> FloatArray:
        """(n, 2) where scans were taken that could not be registered: guesses."""
        path = self.stored.path / filenames.TRAJECTORY
        if not path.exists():
            return np.zeros((0, 2))
        trajectory = read_trajectory(path, self.stored.limits)
        lost = trajectory.lost
        return np.zeros((0, 2)) if lost is None else trajectory.poses[lost, :2]

    @cached_property
    def frame(self) -> Frame:
        """The part of the map to draw: what is known, and the way, which may lead out of it."""
        low, high = extent_of(self.regions)
        return Frame.around(np.vstack([low, high, self.labels.poses[:, :2], self.lost]))

    @cached_property
    def fills(self) -> dict[int, Colour]:
        """The colour of each submap."""
        return colours_of(self.stored.topology, self.regions)

    @property
    def starts(self) -> tuple[int, ...]:
        """The keyframes with which the recordings after the first one begin."""
        return starts_of(self.stored.logs)

    @cached_property
    def nodes(self) -> dict[int, NodeRecord]:
        """The submaps by id."""
        return {node.id: node for node in self.stored.record.nodes}

    @cached_property
    def names(self) -> dict[int, str]:
        """What the submaps are called: by a person, or by their numbers."""
        return {id_: shown(node.name) for id_, node in self.nodes.items()}


def middle_of(node: NodeRecord) -> tuple[float, float]:
    """Where the badge of a submap stands in the map."""
    return node.anchor or node.centroid or (node.x, node.y)


def _composed(stored: StoredMap) -> Regions:
    """The grids of all submaps laid out in the map, each the owner of what is free in it."""
    pieces = [(node, stored.grid(node.id)) for node in stored.record.nodes]
    whole = _canvas(stored, pieces)
    owner = np.full(whole.cells.shape, NOBODY, dtype=np.int64)
    for value in (FREE, OCCUPIED):
        for node, grid in pieces:
            rows, columns = whole.cells_of(_placed(node, grid, grid.cells == value)).T
            whole.cells[rows, columns] = value
            owner[rows, columns] = node.id if value == FREE else NOBODY
    return Regions(
        whole, owner, {node.id: outline_of(owner == node.id, whole) for node, _ in pieces}
    )


def _canvas(stored: StoredMap, pieces: Sequence[tuple[NodeRecord, GridMap]]) -> GridMap:
    """An unknown grid that holds all that is known. MapError when it would be beyond all bounds."""
    cell_m = min((grid.resolution for _, grid in pieces), default=1.0)
    low, high = _corners(_placed(node, grid, grid.cells != UNKNOWN) for node, grid in pieces)
    width, height = (int(side) + 2 for side in np.ceil((high - low) / cell_m))
    if width * height > stored.limits.picture_max_mpixel * 1e6:
        raise MapError(
            f"{stored.path}: its submaps lie so far apart that a picture of them has "
            f"{width:,} x {height:,} cells; if it is meant, raise limits.picture_max_mpixel",
            code=TOO_LARGE,
        )
    left, bottom = (low - 0.5 * cell_m).tolist()
    return GridMap(np.full((height, width), UNKNOWN, dtype=np.uint8), cell_m, (left, bottom))


def _placed(node: NodeRecord, grid: GridMap, cells: BoolArray) -> FloatArray:
    """(n, 2) centres in the map of some cells of a submap's grid."""
    return Pose2(node.x, node.y, node.theta).apply(grid.centres_of(np.argwhere(cells)))


def _corners(parts: Iterable[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Lower left and upper right of all points; the origin without any."""
    points = np.vstack([np.zeros((0, 2)), *parts])
    if not len(points):
        return np.zeros(2), np.zeros(2)
    return points.min(axis=0), points.max(axis=0)
