"""What a scan sees behind the walls of a map: rays that a place would have stopped.

Few walls of a narrow scan fit many corners of many buildings. But where a return lies farther away
than a wall that the map has on the way to it, that wall is not there: the scan is of another place.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from specmap_cli.core.arrays import evenly
from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import PosedScan
from specmap_cli.grids.gridmap import GridMap, cast_rays

_MOST_RAYS = 120  # of a scan, one every three degrees all round: what is cast costs grows with them
# What the pose of a match and the cells of a grid leave open, in heading and sideways. Along a wall
# that moves the end of a ray by metres: so a ray may reach as far as any that passes so near.
_SLANT_RAD, _SIDE_M = math.radians(3.0), 0.15
_BEHIND_M = 0.3  # farther than a match is off, and than a wall is thick in a grid


class Sightlines:
    """Casts rays in the grids of submaps, in their frames, as far as `reach_m`."""

    def __init__(self, grids: Mapping[int, GridMap], reach_m: float) -> None:
        self.grids = grids
        self.reach_m = reach_m
        self._distances: dict[int, FloatArray] = {}

    def behind(self, submap: int, posed: PosedScan, submap_from_base: Pose2) -> float:
        """Share of a scan's returns that lie behind walls within reach; 0 without returns.

        A wall counts when the rays beside it meet walls, too: one that ends there may be passed.
        """
        planar = posed.planar
        returned = np.isfinite(planar.ranges)
        bearings = evenly(planar.bearings[returned], _MOST_RAYS)
        if not len(bearings):
            return 0.0
        laser = submap_from_base @ posed.base_from_laser
        walls = self._walls(submap, laser, bearings)
        farther = evenly(planar.ranges[returned], _MOST_RAYS) > walls + _BEHIND_M
        return float(np.mean(farther))

    def _walls(self, submap: int, laser: Pose2, bearings: FloatArray) -> FloatArray:
        """(N,) the farthest range that a ray near each bearing (N,) may have, inf past reach."""
        if submap not in self._distances:
            self._distances[submap] = self.grids[submap].obstacle_distance()
        origins = np.tile([laser.x, laser.y], (len(bearings), 1))
        grid, angles = self.grids[submap], bearings + laser.theta
        ranges = cast_rays(self._distances[submap], grid, origins, angles, self.reach_m)
        around = np.maximum(_SLANT_RAD, _SIDE_M / np.maximum(ranges, grid.resolution))
        first = np.searchsorted(bearings, bearings - around)
        last = np.searchsorted(bearings, bearings + around, side="right")
        return np.array([ranges[a:b].max() for a, b in zip(first, last, strict=True)])
