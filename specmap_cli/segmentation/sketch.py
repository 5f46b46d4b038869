"""The coarse grid of the current submap, on which splits are tested."""

from __future__ import annotations

import numpy as np

from specmap_cli.core.config import GridConfig
from specmap_cli.core.geometry import FloatArray, Pose2, wrap_angle
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.grids.occupancy import OccupancyGrid

_STEP_M, _STEP_RAD = 0.15, 0.2  # keyframes nearer to the last mapped one add nothing that matters


class Sketch:
    """Keyframes of a submap in order, and a grid of them that is just good enough to find doors."""

    def __init__(self, grid: GridConfig, store: KeyframeStore) -> None:
        self.keyframes: list[int] = []
        self._store = store
        self._config = grid
        self._grid = OccupancyGrid(grid)
        self._mapped: Pose2 | None = None

    def add(self, keyframe: int) -> None:
        """Append a keyframe; it enters the grid if the robot moved since the last that did."""
        self.keyframes.append(keyframe)
        pose = self._store.pose(keyframe)
        if self._mapped is not None:
            step = self._mapped.inverse() @ pose
            if step.distance < _STEP_M and abs(wrap_angle(step.theta)) < _STEP_RAD:
                return
        self._mapped = pose
        laser = pose @ self._store.base_from_laser(keyframe)
        self._grid.integrate(self._store.scan(keyframe), laser)
        self._grid.mark_free_disc(pose.x, pose.y, self._config.footprint_m)

    def rebuilt(self, keyframes: list[int], mapped: int | None = None) -> Sketch:
        """A new sketch of `keyframes`, in the order given, its grid from about `mapped` of them."""
        sketch = Sketch(self._config, self._store)
        every = 1 if mapped is None else max(1, len(keyframes) // mapped)
        for keyframe in keyframes[::every]:
            sketch.add(keyframe)
        sketch.keyframes = list(keyframes)
        return sketch

    def grid(self) -> GridMap:
        """The map of the keyframes so far."""
        return self._grid.snapshot()

    @property
    def poses(self) -> FloatArray:
        """(p, 3) poses of the keyframes."""
        return poses_of(self._store, self.keyframes)


def poses_of(store: KeyframeStore, keyframes: list[int]) -> FloatArray:
    """(p, 3) poses of some keyframes as registered."""
    return np.array([store.pose(number) for number in keyframes], dtype=np.float64).reshape(-1, 3)


def path_length(store: KeyframeStore, keyframes: list[int]) -> float:
    """Metres between keyframes that follow each other in the log."""
    numbers = np.asarray(keyframes, dtype=np.int64)
    if len(numbers) < 2:
        return 0.0
    steps = np.hypot(*np.diff(poses_of(store, keyframes)[:, :2], axis=0).T)
    return float(steps[np.diff(numbers) == 1].sum())
