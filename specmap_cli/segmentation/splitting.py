"""The test on the current submap: has the robot entered a second region? (section II-C)

The paper splits when the second eigenvalue passes 0.8. On real maps every glimpse through a door is
a weakly tied cluster of its own, so that eigenvalue is nearly always above. The default looks for
the largest eigenvalue whose eigenvector divides the robot's own way, in a graph of the free space
near that way; with a share of 0 this is the paper's second eigenvalue. What is tested stands below:
the keyframes of the submap, and a grid of them that is just good enough to find doors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial import cKDTree

from specmap_cli.core.geometry import FloatArray, moved, step_lengths
from specmap_cli.core.records import BoolArray
from specmap_cli.core.settings import GridConfig, SegmentationConfig
from specmap_cli.grids.gridmap import GridMap, clearance_of
from specmap_cli.grids.keyframes import KeyframeStore, add_keyframes
from specmap_cli.grids.occupancy import OccupancyGrid
from specmap_cli.segmentation.cells import flooded_at
from specmap_cli.segmentation.furniture import small_obstacles
from specmap_cli.segmentation.spectral import bisect, largest_eigenpairs, normalised, similarity
from specmap_cli.segmentation.visibility import (
    IndexArray,
    LabelArray,
    sample_nodes,
    visibility_graph,
)

_SPLIT_NODES = 250  # most nodes in a test: the blocks grow
_SPLIT_EIGENPAIRS = 12  # looked at in a test: each room seen but not entered takes one
_FEWEST_NODES = 3  # two nodes share one sight line: nothing to divide
_STANDING_M = 1e-6  # counted at every pose, so that a robot that stands still has a way

SPLIT_CELL_M = 0.1  # cells of the working grid in a test; finer ones are only slower
_SPLIT_STEP_M = 0.15  # motion between scans in a test's map
_SPLIT_STEP_RAD = 0.2  # turn between scans in a test's map
PATH_MARGIN_M = 1.0  # map kept round the band of the path: obstacles at its edge are seen whole


@dataclass(frozen=True, slots=True, kw_only=True)
class SplitTest:
    """One test and its outcome.

    `grid` is the part of the map that was looked at; `nodes` (n, 2) x and y in metres;
    `eigenvalues` (k,) falling; `eigenvector` (n,) is number `chosen`, counted from 0, of them
    (0: none divides the way); `near` (n,) the nodes and `stays` (p,) the poses that lie with the
    latest pose; `reached` (p,) the poses that free space joins with the latest one.
    """

    grid: GridMap
    poses: FloatArray
    nodes: FloatArray
    eigenvalues: FloatArray
    chosen: int
    eigenvector: FloatArray
    near: BoolArray
    stays: BoolArray
    reached: BoolArray

    @property
    def eigenvalue(self) -> float:
        """The eigenvalue to hold against the threshold, 0 when no eigenvector divides the way."""
        return float(self.eigenvalues[self.chosen]) if self.chosen else 0.0


def examine(grid: GridMap, poses: FloatArray, config: SegmentationConfig) -> SplitTest:
    """Look for a second region in `grid` along the way `poses` (p, 3), oldest first.

    What decides, in this order:

    1. what is free near the way, small obstacles taken out, and the nodes in it;
    2. in whose region each pose lies: the flood from the nodes says it;
    3. the eigenvectors of the nodes that sight lines join with that of the latest pose;
    4. the first of these that divides the way (`_dividing`).
    """
    window = grid
    if config.path_band_m:
        window = grid.near(poses, config.path_band_m + PATH_MARGIN_M)
    if not window.cells.size:  # the way leaves a grid that may not grow any more
        return _undivided(window, poses, np.empty((0, 2)))
    opened = window.free | small_obstacles(window.free, config.split_obstacle_m / window.resolution)
    clearance, cell_m = clearance_of(opened), window.resolution
    way = np.clip(window.cells_of(poses[:, :2]), 0, np.array(clearance.shape) - 1)
    nodes = _nodes_along(clearance, cell_m, way, config)
    places = window.centres_of(nodes)
    if len(nodes) < _FEWEST_NODES:
        return _undivided(window, poses, places)
    numbers = np.arange(len(nodes), dtype=np.int32)
    home = flooded_at(clearance, nodes, numbers, way).astype(np.intp)
    lost = home < 0
    if lost.any():
        home[lost] = cKDTree(nodes).query(way[lost])[1]
    members, values, vectors = _spectrum(clearance, cell_m, nodes, int(home[-1]), config)
    place = np.full(len(nodes), -1)  # of the members
    place[members] = np.arange(len(members))
    home = place[home]
    reached = home >= 0
    weight, halves = np.zeros(len(poses)), 0.5 * step_lengths(poses)  # the way at each pose
    weight[1:] += halves
    weight[:-1] += halves
    weight += _STANDING_M
    weight = weight / weight.sum() * reached
    chosen, sides = _dividing(vectors, home, weight, config.split_share)
    near = sides == sides[home[-1]]
    return SplitTest(
        grid=window,
        poses=poses,
        nodes=places[members],
        eigenvalues=values,
        chosen=chosen,
        eigenvector=vectors[:, chosen],
        near=near,
        stays=np.where(reached, near[home], True),
        reached=reached,
    )


def _undivided(window: GridMap, poses: FloatArray, nodes: FloatArray) -> SplitTest:
    """The outcome for a map too small for a graph: nothing to split."""
    every_pose = np.ones(len(poses), dtype=bool)
    return SplitTest(
        grid=window,
        poses=poses,
        nodes=nodes,
        eigenvalues=np.ones(1),
        chosen=0,
        eigenvector=np.ones(len(nodes)),
        near=np.ones(len(nodes), dtype=bool),
        stays=every_pose,
        reached=every_pose,
    )


def _nodes_along(
    clearance: FloatArray, cell_m: float, way: IndexArray, config: SegmentationConfig
) -> IndexArray:
    """Nodes near the cells `way` (p, 2); the blocks grow until there are few enough."""
    if config.path_band_m:
        off = np.ones(clearance.shape, dtype=np.uint8)
        off[way[:, 0], way[:, 1]] = 0
        distance = cv2.distanceTransform(off, cv2.DIST_L2, cv2.DIST_MASK_5)
        clearance = np.where(distance * cell_m <= config.path_band_m, clearance, 0.0)
    block = max(1, round(config.node_step_m / cell_m))
    least = config.split_clearance_m / cell_m
    while True:
        nodes = sample_nodes(clearance, block, least, config.nodes)
        if len(nodes) <= _SPLIT_NODES:
            return nodes
        block = max(block + 1, int(block * (len(nodes) / _SPLIT_NODES) ** 0.5))


def _spectrum(
    clearance: FloatArray,
    cell_m: float,
    nodes: IndexArray,
    here: int,
    config: SegmentationConfig,
) -> tuple[IndexArray, FloatArray, FloatArray]:
    """The nodes joined with node `here` (n,), their eigenvalues (k,) and vectors (n, k)."""
    least = config.split_clearance_m / cell_m
    graph = visibility_graph(clearance, nodes, config.split_sight_m / cell_m, least)
    S = similarity(graph, config.neighbours, config.split_scale, dense=True)
    joined, newest = np.zeros(len(nodes), dtype=np.bool_), np.array([here])
    while len(newest):
        joined[newest] = True
        newest = np.flatnonzero((S[newest] > 0.0).any(axis=0) & ~joined)
    members = np.flatnonzero(joined)
    L, _ = normalised(S[np.ix_(members, members)])
    return members, *largest_eigenpairs(L, _SPLIT_EIGENPAIRS)


def _dividing(
    vectors: FloatArray, home: IndexArray, weight: FloatArray, share: float
) -> tuple[int, LabelArray]:
    """The first eigenvector from the second on that divides the way, and the sides of the nodes.

    A division is Algorithm 2 with k = 2 on that eigenvector and the first; each side must hold more
    than `share` of the way, of which each pose has a `weight` (p,). Number 0 and one side when none
    does.
    """
    for column in range(1, vectors.shape[1]):
        sides = bisect(vectors[:, 0], vectors[:, column])
        part = float(weight[sides[home] == 1].sum() / weight.sum())
        if share == 0.0 or share <= part <= 1.0 - share:
            return column, sides
    return 0, np.zeros(len(vectors), dtype=np.int32)


class CoarseSubmap:
    """Keyframes of a submap in order, and a grid of them that is just good enough to find doors.

    Its cells are no finer than `SPLIT_CELL_M`, the working grid's. A keyframe enters the grid when
    the robot moved `_SPLIT_STEP_M` or turned `_SPLIT_STEP_RAD` since the last that did, and does so
    once: what a split leaves of a grid is counted by taking out the rest.
    """

    def __init__(
        self, config: SegmentationConfig, grid_config: GridConfig, store: KeyframeStore
    ) -> None:
        self.config = config
        coarse = max(SPLIT_CELL_M, grid_config.resolution_m)
        self.grid_config = GridConfig.model_validate(
            {**grid_config.model_dump(), "resolution_m": coarse}
        )
        self._store = store
        self._keyframes: list[int] = []
        self._chosen: list[int] = []  # keyframes for the grid, ascending
        self._counted = 0  # of these that are in it
        self._grid = OccupancyGrid(self.grid_config)

    @property
    def keyframes(self) -> tuple[int, ...]:
        """Numbers of the keyframes in the order they were added."""
        return tuple(self._keyframes)

    @property
    def poses(self) -> FloatArray:
        """(p, 3) poses of the keyframes."""
        return self._store.poses_of(self._keyframes)

    def add(self, keyframe: int) -> float:
        """Append a keyframe; the metres driven since the one before it."""
        driven = way_driven(self._store, [*self._keyframes[-1:], keyframe])
        pose = self._store.pose(keyframe)
        self._keyframes.append(keyframe)
        last = self._store.pose(self._chosen[-1]) if self._chosen else None
        if moved(last, pose, _SPLIT_STEP_M, _SPLIT_STEP_RAD):
            self._chosen.append(keyframe)
        return driven

    def grid(self) -> GridMap:
        """The map of the keyframes so far: the part near the way, if nodes lie only there."""
        self._count()
        if not self.config.path_band_m:
            return self._grid.snapshot()
        return self._grid.near(self.poses, self.config.path_band_m + PATH_MARGIN_M)

    def split(self, stays: BoolArray) -> tuple[CoarseSubmap, CoarseSubmap]:
        """Those of the keyframes (p,) that stay, and those that do not: two submaps."""
        self._count()
        staying = set(np.array(self._keyframes)[stays].tolist())
        rest, left = (CoarseSubmap(self.config, self.grid_config, self._store) for _ in range(2))
        for part, members in ((rest, staying), (left, set(self._keyframes) - staying)):
            part._keyframes = [k for k in self._keyframes if k in members]
            part._chosen = [k for k in self._chosen if k in members]
        few, many = sorted((rest, left), key=lambda part: len(part._chosen))
        few._count()
        many._grid, many._counted = self._grid.without(few._grid), len(many._chosen)
        return rest, left

    def joined(self, other: CoarseSubmap) -> CoarseSubmap:
        """Another submap: the keyframes of this one, and those of `other` after them."""
        both = CoarseSubmap(self.config, self.grid_config, self._store)
        for part in (self, other):
            part._count()
            both._keyframes += part._keyframes
            both._chosen += part._chosen
            both._grid.include(part._grid)
        both._counted = len(both._chosen)
        return both

    def near(self, other: CoarseSubmap) -> bool:
        """Whether nodes of both can be the same: their bands overlap, if nodes lie only there."""
        reach = 2.0 * self.config.path_band_m or np.inf
        tree = cKDTree(self.poses[:, :2])
        away, _ = tree.query(other.poses[:, :2], distance_upper_bound=reach)
        return bool((away <= reach).any())

    def apart(self, reached: BoolArray) -> BoolArray:
        """Those of the keyframes (p,) whose stretch of way lies apart from all that is `reached`.

        What free space does not join with the robot, and has no node in common with what it does,
        stays alone wherever the robot goes on from there. A stretch is driven without a gap.
        """
        near, poses = reached.copy(), self.poses
        reach = 2.0 * self.config.path_band_m or np.inf
        tree = cKDTree(poses[reached, :2])
        away, _ = tree.query(poses[~reached, :2], distance_upper_bound=reach)
        near[~reached] = away <= reach
        stretch = np.cumsum(np.diff(self._keyframes, prepend=self._keyframes[0]) > 1)
        return np.asarray((np.bincount(stretch, near) == 0)[stretch])

    def _count(self) -> None:
        """Add to the grid what was chosen for it since the last time."""
        waiting = self._chosen[self._counted :]
        add_keyframes(self._grid, self._store, waiting, self._store.poses_of(waiting))
        self._counted = len(self._chosen)


def way_driven(store: KeyframeStore, keyframes: Sequence[int]) -> float:
    """Metres driven from keyframe to keyframe, where these follow each other in the log."""
    if len(keyframes) < 2:
        return 0.0
    steps = step_lengths(store.poses_of(keyframes))
    return float(steps[np.diff(keyframes) == 1].sum())
