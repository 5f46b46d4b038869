"""Grids prepared for matching: walls, free space, fields; of stays, and of whole maps."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.arrays import evenly
from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import BoolArray
from specmap_cli.grids.gridmap import NO_OBSTACLE_M, UNKNOWN, GridMap
from specmap_cli.grids.score_field import ScoreField
from specmap_cli.recognition.learning.classifiers import ClassifierSet

_PREPARED = 64  # grids at a time: each takes up to a megabyte
_MATCH_SIGMA_M = 0.15  # how near matched walls pull each other
INLIER_M = 0.15  # a wall point this near a wall agrees
_LEAST_WALL_M = 0.5  # less of it says nothing about where a grid belongs
_MOST_POINTS = 1200  # of walls that are compared: 60 m of them on cells of 5 cm
_WALL_BLUR_CELLS = 2.0  # the picture of walls is smoothed by this to tell their direction
_FLAT = 1e-9  # keeps the direction of a picture without a gradient from dividing by nought

ImageArray = NDArray[np.float32]


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownArea:
    """What a grid knows of each cell, of `resolution` metres from `origin`.

    `wall_distance` and `depth` (H, W) metres to the nearest wall and to the nearest cell that is
    not free; `known` (H, W) whether it was seen, or lies next to what was.
    """

    wall_distance: ImageArray
    depth: ImageArray
    known: BoolArray
    resolution: float
    origin: tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class PreparedGrid:
    """One `grid` prepared for matching, in its own frame.

    `walls` (N, 2) points of the occupied cells, each for `metres_a_point` of wall; `direction` of
    its walls in [0, pi / 2) rad. What the older grid of a match alone needs is made when asked for:
    many a grid is only ever the newer one.
    """

    grid: GridMap
    sigma_m: float
    walls: FloatArray
    metres_a_point: float
    direction: float
    area: KnownArea

    @cached_property
    def wide(self) -> ScoreField:
        """How near walls are, tolerant, for ranking."""
        return ScoreField.from_grid(self.grid, 2.0 * self.sigma_m)

    @cached_property
    def field(self) -> ScoreField:
        """How near walls are, for the refinement."""
        return self.wide.sharper()


def prepared(grid: GridMap) -> PreparedGrid | None:
    """The grid prepared for matching; None when it shows too little of a wall."""
    grid = grid.cropped()
    occupied = np.argwhere(grid.occupied)
    if len(occupied) * grid.resolution < _LEAST_WALL_M:
        return None
    points = evenly(occupied, _MOST_POINTS)
    # what the grid knows ends as far past the cells that were seen as an inlier may be off
    margin = max(1, round(INLIER_M / grid.resolution))
    seen = (grid.cells != UNKNOWN).astype(np.uint8)
    known = cv2.dilate(seen, np.ones((2 * margin + 1, 2 * margin + 1), dtype=np.uint8))
    distances = []  # metres from each cell inside to the nearest outside
    for inside in (~grid.occupied, grid.free):
        metres = np.full(inside.shape, NO_OBSTACLE_M, dtype=np.float32)
        if not inside.all():
            cells = cv2.distanceTransform(inside.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5)
            metres = np.asarray(cells * np.float32(grid.resolution), dtype=np.float32)
        distances.append(metres)
    return PreparedGrid(
        grid=grid,
        sigma_m=max(_MATCH_SIGMA_M, grid.resolution),
        walls=grid.centres_of(points),
        metres_a_point=grid.resolution * len(occupied) / len(points),
        direction=wall_direction(grid),
        area=KnownArea(
            wall_distance=distances[0],
            depth=distances[1],
            known=np.asarray(known > 0),
            resolution=grid.resolution,
            origin=grid.origin,
        ),
    )


class PreparedGrids:
    """Grids prepared for matching by number, the `most` last used of them at a time."""

    def __init__(self, most: int) -> None:
        self.most = most
        self._grids: OrderedDict[int, PreparedGrid | None] = OrderedDict()

    def of(self, number: int, grid: GridMap) -> PreparedGrid | None:
        """The prepared grid of one number, which is always the same."""
        if number not in self._grids:
            self._grids[number] = prepared(grid)
            if len(self._grids) > self.most:
                self._grids.popitem(last=False)
        self._grids.move_to_end(number)
        return self._grids[number]

    def forget(self, number: int) -> None:
        """The grid of this number is another one now."""
        self._grids.pop(number, None)


def wall_direction(grid: GridMap) -> float:
    """The direction of the walls, modulo a right angle, in [0, pi / 2) rad.

    From the gradient of the blurred picture of the obstacles: four times its angle is the same for
    a wall, its back and the walls across.
    """
    picture = cv2.GaussianBlur(grid.occupied.astype(np.float32), (0, 0), _WALL_BLUR_CELLS)
    dx = cv2.Sobel(picture, cv2.CV_32F, 1, 0)
    dy = cv2.Sobel(picture, cv2.CV_32F, 0, 1)
    steep = np.flatnonzero((dx != 0.0) | (dy != 0.0))  # few cells lie near a wall
    gradient = dx.take(steep) + np.complex64(1j) * dy.take(steep)
    square = gradient * gradient
    total = complex((square * square / (np.abs(square) + _FLAT)).sum(dtype=np.complex128))
    return (math.atan2(total.imag, total.real) / 4.0) % (math.pi / 2.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class MapToAlign:
    """A finished map: its `whole` grid, and the grids of its submaps by id.

    `frames` are those of the submaps in the map, `tracks` (k, 2 or more) where the robot was in
    each, in the map; a map that was cut from a finished grid has none, nor `classifiers`.
    """

    whole: GridMap
    grids: Mapping[int, GridMap]
    frames: Mapping[int, Pose2]
    tracks: Mapping[int, FloatArray]
    classifiers: ClassifierSet | None = None

    @property
    def ids(self) -> list[int]:
        """Submap ids, ascending."""
        return sorted(self.frames)


class PlacedGrid(NamedTuple):
    """A submap's prepared grid, in its own frame, and that frame in the map."""

    submap: int
    grid: PreparedGrid
    frame: Pose2


class PreparedMap:
    """The submaps of a map prepared for matching, those last asked for kept."""

    def __init__(self, map_: MapToAlign) -> None:
        self.map = map_
        self._grids = PreparedGrids(_PREPARED)

    def of(self, submap: int) -> PlacedGrid | None:
        """One submap; None when it shows too little of a wall."""
        grid = self._grids.of(submap, self.map.grids[submap])
        return None if grid is None else PlacedGrid(submap, grid, self.map.frames[submap])

    def all(self) -> Iterator[PlacedGrid]:
        """The submaps that show enough of a wall, by id."""
        yield from filter(None, map(self.of, self.map.ids))
