"""The walls that the robot saw around nodes of the graph, their sides, and the space before them.

Two rooms see the wall between them from either side. Matched with each other the two sides would
lie on one another: the rooms would come nearer by the thickness of the wall, and nearly all of it
would fit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2, compose, invert
from specmap_cli.core.records import BoolArray
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.grids.score_field import ScoreField, thinned
from specmap_cli.layout.path_graph import MATCH_RANGE_M, Graph

PLACE_NODES = 8  # nodes on either side whose walls make one place: some 2 m of path
CELL_M = 0.05  # points are thinned to one in a cell of the fields they are matched on
_REMEMBERED = 256  # nodes whose points stay in memory: some 5 MB
_GATHERED = 10_000  # points that are thinned together: 160 kB

_NEIGHBOURS = 2  # points on either side, from which the direction of a surface is had
_SURFACE_M = 0.5  # such neighbours farther from each other lie on two surfaces
_DISTINCT_M = 1e-6  # nearer ones have no direction
_THICK_M = 0.3  # walls between rooms are no thicker
_CELL_M = 0.1  # of the grid in which sides are added up
_OTHER_SIDE = -0.5  # mean cosine of two facings: above it may be a wall around the corner
_UNIT = 64.0  # normals are whole numbers of its parts: their sums come out the same in any order

_MARGIN_M = 0.6  # beyond what was seen: a robot's width, and what the poses there are off
_FEWEST = 3  # corners of an area


class Walls:
    """Wall points around the nodes of a graph, read from the store as needed; some are kept."""

    def __init__(self, store: KeyframeStore, graph: Graph, before: Walls | None = None) -> None:
        """`before` are those of another graph of the store: what they keep in memory stays."""
        self._store, self._graph = store, graph
        after = [motion.kind != "odometry" for motion in graph.odometry]
        self._pieces = np.cumsum([False, *after])  # between all breaks, bridged or not
        self._points: Callable[[int], FloatArray] = lru_cache(_REMEMBERED)(self._read)
        self._sides: Callable[[int], Sides] = lru_cache(_REMEMBERED)(self._seen)
        if before is not None:
            self._points, self._sides = before._points, before._sides

    def points(self, node: int) -> FloatArray:
        """Points (N, 2) of one node in its base frame."""
        return self._points(int(self._graph.nodes[node]))

    def sides(self, node: int) -> Sides:
        """The same with the sides that its laser saw."""
        return self._sides(int(self._graph.nodes[node]))

    def around(self, node: int, reach: int, poses: FloatArray) -> FloatArray:
        """Points (N, 2) seen from nodes within `reach` of row `node`, in the frame of `node`.

        `poses` (M, 3) place the nodes. Only nodes between the same breaks are used.
        """
        near = self._near(node, reach, poses)
        return np.concatenate([pose.apply(self.points(k)) for k, pose in near])

    def sides_around(self, node: int, reach: int, poses: FloatArray) -> Sides:
        """The same points with the sides of the walls that are seen from there."""
        near = [self.sides(k).placed(pose) for k, pose in self._near(node, reach, poses)]
        points, normals = [one.points for one in near], [one.normals for one in near]
        return Sides(np.concatenate(points), np.concatenate(normals))

    def seen_around(
        self, node: int, reach: int, poses: FloatArray, field: ScoreField, margin_m: float
    ) -> BoolArray:
        """(H, W) which cells of a field in the frame of row `node` were seen from these nodes."""
        near = self._near(node, reach, poses)
        return seen_from([(self.points(k), pose) for k, pose in near], field, margin_m)

    def seen_of_all(
        self, nodes: Sequence[int], poses: FloatArray, field: ScoreField, margin_m: float
    ) -> BoolArray:
        """(H, W) which cells of a field in the map were seen from rows `nodes`."""
        views = [(self.points(k), Pose2(*poses[k].tolist())) for k in nodes]
        return seen_from(views, field, margin_m)

    def _near(self, node: int, reach: int, poses: FloatArray) -> list[tuple[int, Pose2]]:
        """The rows around a row, and where they are in its frame."""
        pieces = self._pieces
        low, high = max(0, node - reach), min(len(pieces), node + reach + 1)
        others = [k for k in range(low, high) if pieces[k] == pieces[node]]
        relative = compose(invert(poses[node]), poses[others])
        return [(k, Pose2(*pose.tolist())) for k, pose in zip(others, relative, strict=True)]

    def of_all(self, nodes: Sequence[int], poses: FloatArray) -> FloatArray:
        """Points (N, 2) seen from all rows `nodes`, in the map, thinned as they are gathered."""
        clouds: list[FloatArray] = [np.zeros((0, 2))]
        count, most = 0, _GATHERED
        for k in nodes:
            clouds.append(Pose2(*poses[k].tolist()).apply(self.points(k)))
            count += len(clouds[-1])
            if count > most:  # twice what was left the last time: each point is thinned a few times
                clouds = [thinned(np.concatenate(clouds), CELL_M)]
                count = len(clouds[0])
                most = max(_GATHERED, 2 * count)
        return thinned(np.concatenate(clouds), CELL_M)

    def _read(self, number: int) -> FloatArray:
        """Points (N, 2) of a keyframe."""
        return thinned(self._store.points(number, MATCH_RANGE_M), CELL_M)

    def _seen(self, number: int) -> Sides:
        """The points of a keyframe with the sides that its laser saw."""
        laser = self._store.base_from_laser(number)
        return Sides.of(self._points(number), (laser.x, laser.y))


@dataclass(frozen=True, slots=True)
class Sides:
    """Wall points (N, 2) and the unit normals (N, 2) of their surfaces, to where they are seen.

    A normal is nought where no surface is known: a post, the end of a wall.
    """

    points: FloatArray
    normals: FloatArray

    @classmethod
    def of(cls, points: FloatArray, viewer: tuple[float, float]) -> Sides:
        """The sides of points (N, 2), in order of bearing, that are seen from one place."""
        normals, reach = np.zeros((len(points), 2)), _NEIGHBOURS
        along = points[2 * reach :] - points[: -2 * reach]
        length = np.hypot(along[:, 0], along[:, 1])
        known = (length > _DISTINCT_M) & (length < _SURFACE_M)
        rows = np.flatnonzero(known) + reach
        across = np.column_stack([-along[:, 1], along[:, 0]])[known] / length[known, None]
        to_viewer = viewer - points[rows]
        outwards = (across * to_viewer).sum(axis=1) < 0.0
        normals[rows] = np.where(outwards[:, None], -across, across)
        return cls(points, normals)

    def placed(self, pose: Pose2) -> Sides:
        """The same in the frame in which theirs lies at a pose."""
        turn = Pose2(0.0, 0.0, pose.theta)
        return Sides(pose.apply(self.points), turn.apply(self.normals))


def from_behind(source: Sides, target: Sides, guess: Pose2, drift_m: float) -> BoolArray:
    """(N,) whether the target shows the wall under a point of the source from its other side only.

    `guess` is `target_from_source`; `drift_m` bounds how wrong it may be: sides are compared that
    far around, and the thickness of a wall. Where walls face each other within that, nothing is
    said.
    """
    cells = np.floor(target.points / _CELL_M).astype(np.int64)
    if not len(cells):
        return np.zeros(len(source.points), dtype=bool)
    reach = math.ceil((drift_m + _THICK_M) / _CELL_M)
    low = cells.min(axis=0) - reach
    width, height = (cells.max(axis=0) - low + reach + 1).tolist()
    columns, rows = (cells - low).T
    normals = np.round(_UNIT * target.normals)
    lengths = np.where(normals.any(axis=1), _UNIT, 0.0)
    # in x and y, and of the lengths, over the square around each cell
    sums = [
        cv2.boxFilter(
            np.bincount(rows * width + columns, each, width * height).reshape(height, width),
            ddepth=-1,
            ksize=(2 * reach + 1, 2 * reach + 1),
            normalize=False,
            borderType=cv2.BORDER_CONSTANT,
        )
        for each in (*normals.T, lengths)
    ]
    placed = source.placed(guess)
    at = np.floor(placed.points / _CELL_M).astype(np.int64) - low
    inside = (at >= 0).all(axis=1) & (at[:, 0] < width) & (at[:, 1] < height)
    x, y, known = (each[at[inside, 1], at[inside, 0]] for each in sums)
    behind = np.zeros(len(at), dtype=bool)
    along = placed.normals[inside]
    behind[inside] = along[:, 0] * x + along[:, 1] * y < _OTHER_SIDE * known
    return behind


def seen_from(
    views: Iterable[tuple[FloatArray, Pose2]], field: ScoreField, margin_m: float
) -> BoolArray:
    """(H, W) which cells of a field lie in what was seen, or so near to it.

    What a scan saw is the area between the robot and its returns, joined in their order: `views`
    are returns (N, 2), and poses of the robot in the frame of the field.
    """
    seen = np.zeros(field.values.shape, dtype=np.uint8)
    height, width = field.values.shape
    for points, pose in views:
        corners = np.concatenate([np.zeros((1, 2)), points])
        if len(corners) >= _FEWEST:
            cells = np.floor((pose.apply(corners) - np.asarray(field.origin)) / field.resolution)
            near = np.clip(cells, (-width, -height), (2 * width, 2 * height))  # 32 bits hold these
            cv2.fillPoly(seen, [near.astype(np.int32)], 1)
    reach = max(1, round(margin_m / field.resolution))
    kernel = np.ones((2 * reach + 1, 2 * reach + 1), dtype=np.uint8)
    return np.asarray(cv2.dilate(seen, kernel) > 0)
