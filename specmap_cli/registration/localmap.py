"""The local map: what the last keyframes saw, to register the next sweep against.

KISS-ICP's voxel map of a window of keyframes, rebuilt every few keyframes so that old passes and
bad scans leave it again: met after some drift they would bend the trajectory. Beside it the score
field of the same walls in the plane, for the matcher.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from kiss_icp.mapping import VoxelHashMap

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.grids.matching import ScoreField

_POINTS_PER_VOXEL = 20
_CELL, _SIGMA = 1.5, 2.0  # of the score field, in spacings of the walls' points
_REBUILD_EVERY = 4  # keyframes; in between they are added to what is there


class LocalMap:
    """The points of the last `size` keyframes, in the map frame.

    `voxel_m` and `max_range_m` are KISS-ICP's; walls have a point every `spacing_m`.
    """

    def __init__(self, size: int, voxel_m: float, max_range_m: float, spacing_m: float) -> None:
        self.size, self.voxel_m, self.max_range_m = size, voxel_m, max_range_m
        self.spacing_m = spacing_m
        self._clouds: deque[FloatArray] = deque(maxlen=size)
        self._walls: deque[FloatArray] = deque(maxlen=size)
        self._field: ScoreField | None = None
        self._inserted = 0
        self.voxels = VoxelHashMap(voxel_m, 2.0 * max_range_m, _POINTS_PER_VOXEL)

    def __len__(self) -> int:
        return len(self._clouds)

    def clear(self) -> None:
        """Forget everything."""
        self._clouds.clear()
        self._walls.clear()
        self._field = None
        self._inserted = 0
        self.voxels.clear()

    def insert(self, cloud: FloatArray, walls: FloatArray, map_from_base: FloatArray) -> None:
        """Add a keyframe: `cloud` (N, 3) and `walls` (M, 2), base frame, at a (4, 4) pose."""
        placed = cloud @ map_from_base[:3, :3].T + map_from_base[:3, 3]
        self._clouds.appendleft(placed)
        self._walls.appendleft(Pose2.from_matrix(map_from_base).apply(walls))
        self._field = None
        if self._inserted % _REBUILD_EVERY == 0:
            self.voxels.clear()
            placed = np.concatenate(self._clouds)  # the newest first: a full voxel takes no more
        self.voxels.add_points(placed)
        self._inserted += 1

    @property
    def field(self) -> ScoreField:
        """The score field of the walls, built when first asked for."""
        if self._field is None:
            walls = np.concatenate(self._walls)
            cell_m, sigma_m = _CELL * self.spacing_m, _SIGMA * self.spacing_m
            side_m = 2.0 * self.max_range_m
            self._field = ScoreField.from_points(walls, cell_m, sigma_m, side_m)
        return self._field
