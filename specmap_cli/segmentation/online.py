"""Splitting the current submap as the robot moves (section II-C of the paper).

The paper splits when the second eigenvalue passes 0.8. On real maps every glimpse through a door is
a weakly tied cluster of its own, so that eigenvalue is nearly always above. The default looks for
the largest eigenvalue whose eigenvector divides the robot's own way, in a graph of the free space
near that way; with a share of 0 this is the paper's second eigenvalue.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial import cKDTree

from specmap_cli.core.geometry import FloatArray, moved, step_lengths
from specmap_cli.core.records import BoolArray
from specmap_cli.core.settings import GridConfig, SegmentationConfig
from specmap_cli.grids.gridmap import GridMap, LengthArray, clearance_of
from specmap_cli.grids.keyframes import KeyframeStore, add_keyframes
from specmap_cli.grids.occupancy import OccupancyGrid
from specmap_cli.segmentation.cells import flooded_at
from specmap_cli.segmentation.obstacles import small_obstacles
from specmap_cli.segmentation.spectral import bisect, largest_of, normalised, similarity
from specmap_cli.segmentation.visibility import (
    IndexArray,
    LabelArray,
    sample_nodes,
    visibility_graph,
)

_TEST_METRES = 1.0  # travelled between two tests

_SPLIT_NODES = 250  # most nodes in a test: the blocks grow
_SPLIT_EIGENPAIRS = 12  # looked at in a test: each room seen but not entered takes one
_FEWEST_NODES = 3  # two nodes share one sight line: nothing to divide
_STANDING_M = 1e-6  # counted at every pose, so that a robot that stands still has a way

SPLIT_CELL_M = 0.1  # cells of the working grid in a test; finer ones are only slower
_SPLIT_STEP_M = 0.15  # motion between scans in a test's map
_SPLIT_STEP_RAD = 0.2  # turn between scans in a test's map
PATH_MARGIN_M = 1.0  # map kept round the band of the path: obstacles at its edge are seen whole

Observer = Callable[["SplitTest", bool, "Occasion"], None]


@dataclass(frozen=True, slots=True)
class Region:
    """A finished region: the keyframes, ascending, that belong to the submap just left.

    `continues` is the number of the earlier region that this one is a piece of, because the robot
    came straight back to it; None for a submap of its own.
    """

    number: int
    keyframes: tuple[int, ...]
    continues: int | None


@dataclass(frozen=True, slots=True)
class Occasion:
    """When a submap was tested: its first and latest keyframe, and the time since the log began."""

    first: int
    latest: int
    seconds: float


class OnlineSegmenter:
    """Takes keyframes into the current submap and says which regions were left.

    `observer` is told every test, whether it split, and when.
    """

    def __init__(
        self,
        config: SegmentationConfig,
        grid_config: GridConfig,
        store: KeyframeStore,
        observer: Observer | None = None,
    ) -> None:
        self.config = config
        self.observer = observer
        self._store, self._grid_config = store, grid_config
        self._current = CoarseSubmap(config, grid_config, store)
        self._since_test = 0.0  # metres or keyframes, as `test_every` says
        self._way_m = 0.0  # driven in the current submap
        # the last two that were left; none from before a loss of track
        self._recent: list[tuple[Region, CoarseSubmap]] = []
        self._finished = 0

    def add(self, keyframe: int) -> list[Region]:
        """Take one keyframe into the current submap; the regions left with it, oldest first.

        What decides on a split, in this order:

        1. whether it is time for a test;
        2. which keyframes free space does not join with the robot: these go in any case;
        3. whether the eigenvector that divides the way (`examine`) has an eigenvalue above the
           threshold, and both sides of the way are long enough;
        4. whether what was left continues an earlier region (`_finish`).
        """
        driven = self._current.add(keyframe)
        if self.config.test_every == "keyframes":
            self._since_test += 1
            due: float = self.config.test_keyframes
        else:
            self._since_test += driven
            self._way_m += driven
            # A test costs what the submap has grown to. In a long one, where only a part of many
            # metres can be split off, it is made once in that many.
            due = max(_TEST_METRES, self.config.split_share * self._way_m)
        if self._since_test < due:
            return []
        self._since_test = 0.0
        test = examine(self._current.grid(), self._current.poses, self.config)
        apart = self._current.apart(test.reached)
        # Left there, what lies apart would make the map of every test as large as the way from it.
        lost = []
        if apart.any():
            self._current, left = self._current.split(~apart)
            lost = [Region(self._finished, left.keyframes, None)]
            self._finished += 1
        keyframes, stays = np.array(self._current.keyframes), test.stays[~apart]
        split = test.eigenvalue > self.config.split_eigenvalue and all(
            len(side) and way_driven(self._store, side.tolist()) >= self.config.region_min_m
            for side in (keyframes[~stays], keyframes[stays])
        )
        if self.observer is not None:
            first, latest = keyframes[[0, -1]].tolist()
            stamps_ns = self._store.stamps_ns
            seconds = float(stamps_ns[latest] - stamps_ns[0]) / 1e9
            self.observer(test, split, Occasion(first, latest, seconds))
        if split:
            self._current, left = self._current.split(stays)
            lost.append(self._finish(left))
        if lost:
            self._way_m = way_driven(self._store, self._current.keyframes)
        return lost

    def flush(self) -> list[Region]:
        """End the current submap, at the end of a log or after a loss of track."""
        last = self._current
        if not last.keyframes:
            return []
        region = self._finish(last)
        self._current = CoarseSubmap(self.config, self._grid_config, self._store)
        self._recent = []
        self._since_test = self._way_m = 0.0
        return [region]

    def _finish(self, left: CoarseSubmap) -> Region:
        """The next region, a piece of the one before the last where nothing divides the two."""
        continues = None
        if self.config.regrow and len(self._recent) == 2:
            earlier, before = self._recent[0]
            if before.near(left):
                union = before.joined(left)
                test = examine(union.grid(), union.poses, self.config)
                if test.reached.all() and test.eigenvalue <= self.config.split_eigenvalue:
                    continues = earlier.number if earlier.continues is None else earlier.continues
        region = Region(self._finished, left.keyframes, continues)
        self._finished += 1
        self._recent = [*self._recent[-1:], (region, left)]
        return region


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
    if config.path_band_m:
        grid = grid.near(poses, config.path_band_m + PATH_MARGIN_M)
    opened = grid.free | small_obstacles(grid.free, config.split_obstacle_m / grid.resolution)
    clearance, cell_m = clearance_of(opened), grid.resolution
    way = np.clip(grid.cells_of(poses[:, :2]), 0, np.array(clearance.shape) - 1)
    nodes = _nodes_along(clearance, cell_m, way, config)
    places, all_poses = grid.centres_of(nodes), np.ones(len(poses), dtype=bool)
    if len(nodes) < _FEWEST_NODES:
        return SplitTest(
            grid=grid,
            poses=poses,
            nodes=places,
            eigenvalues=np.ones(1),
            chosen=0,
            eigenvector=np.ones(len(nodes)),
            near=np.ones(len(nodes), dtype=bool),
            stays=all_poses,
            reached=all_poses,
        )
    numbers = np.arange(len(nodes), dtype=np.int16)
    home = flooded_at(clearance, nodes, numbers, way).astype(np.intp)
    lost = home < 0
    if lost.any():
        home[lost] = cKDTree(nodes).query(way[lost])[1]
    joined, values, vectors = _spectrum(clearance, cell_m, nodes, int(home[-1]), config)
    reached, home = joined[home], (np.cumsum(joined) - 1)[home]  # numbered among those joined
    weight, halves = np.zeros(len(poses)), 0.5 * step_lengths(poses)  # the way at each pose
    weight[1:] += halves
    weight[:-1] += halves
    weight += _STANDING_M
    weight = weight / weight.sum() * reached
    chosen, sides = _dividing(vectors, home, weight, config.split_share)
    near = sides == sides[home[-1]]
    return SplitTest(
        grid=grid,
        poses=poses,
        nodes=places[joined],
        eigenvalues=values,
        chosen=chosen,
        eigenvector=vectors[:, chosen],
        near=near,
        stays=near[home] | ~reached,
        reached=reached,
    )


def _nodes_along(
    clearance: LengthArray, cell_m: float, way: IndexArray, config: SegmentationConfig
) -> IndexArray:
    """Nodes near the cells `way` (p, 2); the blocks grow until there are few enough."""
    if not clearance.size:  # the way leaves a grid that may not grow any more
        return np.zeros((0, 2), dtype=np.intp)
    if config.path_band_m:
        off = np.ones(clearance.shape, dtype=np.uint8)
        off[way[:, 0], way[:, 1]] = 0
        distance = cv2.distanceTransform(off, cv2.DIST_L2, cv2.DIST_MASK_5)
        clearance = np.where(distance * cell_m <= config.path_band_m, clearance, 0.0)
    block = max(1, round(config.node_step_m / cell_m))
    while True:
        nodes = sample_nodes(clearance, block, config.split_clearance_m / cell_m, config.nodes)
        if len(nodes) <= _SPLIT_NODES:
            return nodes
        block = max(block + 1, int(block * (len(nodes) / _SPLIT_NODES) ** 0.5))


def _spectrum(
    clearance: LengthArray, cell_m: float, nodes: IndexArray, here: int, config: SegmentationConfig
) -> tuple[BoolArray, FloatArray, FloatArray]:
    """Which nodes (n,) are joined with node `here`, their eigenvalues (k,) and vectors (m, k)."""
    least, sight = config.split_clearance_m / cell_m, config.split_sight_m / cell_m
    graph = visibility_graph(clearance, nodes, sight, least)
    S = similarity(graph, config.neighbours, config.split_scale, dense=True)
    joined, newest = np.zeros(len(nodes), dtype=np.bool_), np.array([here])
    while len(newest):
        joined[newest] = True
        newest = np.flatnonzero((S[newest] > 0.0).any(axis=0) & ~joined)
    L, _ = normalised(S[np.ix_(joined, joined)])
    return joined, *largest_of(L, _SPLIT_EIGENPAIRS)


def _dividing(
    vectors: FloatArray, home: IndexArray, weight: FloatArray, share: float
) -> tuple[int, LabelArray]:
    """The first eigenvector from the second on by which each side has its share of the way.

    Also the sides of the nodes, by Algorithm 2 with k = 2; poses have a `weight` (p,). 0: none
    does.
    """
    for column in range(1, vectors.shape[1]):
        sides = bisect(vectors[:, 0], vectors[:, column])
        part = float(weight[sides[home] == 1].sum() / weight.sum())
        if share == 0.0 or share <= part <= 1.0 - share:
            return column, sides
    return 0, np.zeros(len(vectors), dtype=np.int16)


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
        coarse = {"resolution_m": max(SPLIT_CELL_M, grid_config.resolution_m)}
        self.grid_config = grid_config.model_copy(update=coarse)
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
    steps = step_lengths(store.poses_of(keyframes))
    return float(steps[np.diff(keyframes) == 1].sum())
