"""The current submap while the robot drives: its keyframes, and a coarse grid to test splits on."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.settings import GridConfig, SegmentationConfig
from specmap_cli.core.tracks import moved, step_lengths
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.grids.occupancy import OccupancyGrid


class CoarseSubmap:
    """Keyframes of a submap in order, and a grid of them that is just good enough to find doors.

    Its cells are no finer than `cell_m`, the working grid's. A keyframe enters the grid when the
    robot moved `split_step_m` or turned `split_step_rad` since the last that did.
    """

    def __init__(
        self, config: SegmentationConfig, grid_config: GridConfig, store: KeyframeStore
    ) -> None:
        self.config = config
        self.grid_config = grid_config
        self._store = store
        self._keyframes: list[int] = []
        coarse = max(config.cell_m, grid_config.resolution_m)
        self._grid = OccupancyGrid(grid_config.model_copy(update={"resolution_m": coarse}))
        self._mapped: Pose2 | None = None

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
        self._keyframes.append(keyframe)
        self._map(keyframe)
        return driven

    def rebuilt(self, keyframes: Sequence[int], mapped: int | None = None) -> CoarseSubmap:
        """Another submap: `keyframes` in the order given, its grid from about `mapped` of them."""
        other = CoarseSubmap(self.config, self.grid_config, self._store)
        other._keyframes = list(keyframes)
        every = 1 if mapped is None else max(1, len(keyframes) // mapped)
        for keyframe in keyframes[::every]:
            other._map(keyframe)
        return other

    def grid(self) -> GridMap:
        """The map of the keyframes so far."""
        return self._grid.snapshot()

    def _map(self, keyframe: int) -> None:
        """Add a keyframe's scan to the grid if the robot moved since the last."""
        pose = self._store.pose(keyframe)
        if moved(self._mapped, pose, self.config.split_step_m, self.config.split_step_rad):
            self._mapped = pose
            laser = pose @ self._store.base_from_laser(keyframe)
            self._grid.integrate(self._store.scan(keyframe), laser)
            self._grid.mark_free_disc(pose.x, pose.y, self.grid_config.footprint_m)


def way_driven(store: KeyframeStore, keyframes: Sequence[int]) -> float:
    """Metres driven from keyframe to keyframe, where these follow each other in the log."""
    if len(keyframes) < 2:
        return 0.0
    steps = step_lengths(store.poses_of(keyframes))
    return float(steps[np.diff(keyframes) == 1].sum())
