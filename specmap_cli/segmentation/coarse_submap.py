"""The current submap while the robot drives: its keyframes, and a coarse grid to test splits on."""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Sequence

import numpy as np
from scipy.spatial import cKDTree

from specmap_cli.core.geometry import FloatArray, moved, step_lengths
from specmap_cli.core.records import BoolArray
from specmap_cli.core.settings import GridConfig, SegmentationConfig
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.grids.keyframes import KeyframeStore, add_keyframes
from specmap_cli.grids.occupancy import OccupancyGrid

SPLIT_CELL_M = 0.1  # cells of the working grid in a test; finer ones are only slower
_SPLIT_STEP_M = 0.15  # motion between scans in a test's map
_SPLIT_STEP_RAD = 0.2  # turn between scans in a test's map
PATH_MARGIN_M = 1.0  # map kept round the band of the path: obstacles at its edge are seen whole


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
        self.grid_config = grid_config.model_copy(update={"resolution_m": coarse})
        self._store = store
        self._keyframes: list[int] = []
        self._places = array("d")  # x, y and theta of each
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
        return np.array(self._places).reshape(-1, 3)

    def add(self, keyframe: int) -> float:
        """Append a keyframe; the metres driven since the one before it."""
        driven = way_driven(self._store, [*self._keyframes[-1:], keyframe])
        pose = self._store.pose(keyframe)
        self._keyframes.append(keyframe)
        self._places.extend(pose)
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
        staying = {k for k, stay in zip(self._keyframes, stays.tolist(), strict=True) if stay}
        rest, left = self._part(staying), self._part(set(self._keyframes) - staying)
        few, many = sorted((rest, left), key=lambda part: len(part._chosen))
        few._count()
        many._grid, many._counted = self._grid.without(few._grid), len(many._chosen)
        return rest, left

    def joined(self, other: CoarseSubmap) -> CoarseSubmap:
        """Another submap: the keyframes of this one, and those of `other` after them."""
        both = CoarseSubmap(self.config, self.grid_config, self._store)
        for part in (self, other):
            part._count()
            both._append(part._keyframes, part._chosen)
            both._grid.include(part._grid)
        both._counted = len(both._chosen)
        return both

    def near(self, other: CoarseSubmap) -> bool:
        """Whether nodes of both can be the same: their bands overlap, if nodes lie only there."""
        return bool(self._bands_meet(self.poses, other.poses).any())

    def apart(self, reached: BoolArray) -> BoolArray:
        """Those of the keyframes (p,) whose stretch of way lies apart from all that is `reached`.

        What free space does not join with the robot, and has no node in common with what it does,
        stays alone wherever the robot goes on from there. A stretch is driven without a gap.
        """
        near, poses = reached.copy(), self.poses
        near[~reached] = self._bands_meet(poses[reached], poses[~reached])
        stretch = np.cumsum(np.diff(self._keyframes, prepend=self._keyframes[0]) > 1)
        return np.asarray((np.bincount(stretch, near) == 0)[stretch])

    def _bands_meet(self, some: FloatArray, others: FloatArray) -> BoolArray:
        """(m,) whether the band of each of the `others` (m, 3) overlaps that of `some` (n, 3)."""
        reach = 2.0 * self.config.path_band_m or np.inf
        away, _ = cKDTree(some[:, :2]).query(others[:, :2], distance_upper_bound=reach)
        return np.asarray(away <= reach)

    def _part(self, members: set[int]) -> CoarseSubmap:
        """The submap of some of the keyframes, nothing of it in its grid."""
        part = CoarseSubmap(self.config, self.grid_config, self._store)
        part._append(
            *([k for k in some if k in members] for some in (self._keyframes, self._chosen))
        )
        return part

    def _append(self, keyframes: Iterable[int], chosen: Iterable[int]) -> None:
        """Take over keyframes of another submap and which of them it chose for its grid."""
        for keyframe in keyframes:
            self._keyframes.append(keyframe)
            self._places.extend(self._store.pose(keyframe))
        self._chosen.extend(chosen)

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
