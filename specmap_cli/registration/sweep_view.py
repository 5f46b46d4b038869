"""What one sweep offers to registration: its points, de-skewed, cut to range and thinned."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from specmap_cli.core.arrays import first_in_cells
from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2
from specmap_cli.core.records import PlanarScan, Sweep
from specmap_cli.core.settings import RegistrationConfig
from specmap_cli.grids.score_field import thinned
from specmap_cli.registration.deskew import deskewed, moved_returns, usable_times
from specmap_cli.registration.expected_motion import ExpectedMotion
from specmap_cli.registration.seen_space import outline_of

_MAX_POINTS = 600  # a denser planar scan is thinned to this
_MAX_CLOUD_POINTS = 2000  # a denser 3D cloud is thinned to this: alignments take most time
_BELOW_RANGE_MAX = 0.999  # some drivers report no return as the largest range, rounded
_GROWTH = 1.4  # of the cell from one try to the next at thinning: about half the points


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepView:
    """The points of a sweep, in the base frame.

    `cloud` (N, 3) is registered; `sparse` (K, 3) is enough for coarse alignments. `walls` (M, 2) go
    into the score field and `probe` (L, 2) is scored on it. `dense` (D, 3) goes into the local map,
    None for `cloud` itself: thinned alike, two clouds of one street fit best where they stand
    alike to the lidar, as if it had not moved. `planar` is the scan to hand on.
    Its laser stood at `base_from_laser`, and walls beyond `reach_m` of it are not looked at.
    """

    planar: PlanarScan
    cloud: FloatArray
    sparse: FloatArray
    walls: FloatArray
    probe: FloatArray
    dense: FloatArray | None = None
    base_from_laser: Pose2 = IDENTITY
    reach_m: float = np.inf

    def outline(self) -> FloatArray:
        """Corners (K, 2) of the space that the sweep looked through."""
        return outline_of(self.planar, self.base_from_laser, self.reach_m)


def view_of(sweep: Sweep, expected: ExpectedMotion, config: RegistrationConfig) -> SweepView:
    """The points of a sweep, de-skewed with the motion expected during it."""
    scan = deskewed(sweep.planar, sweep.base_from_laser, expected.during, expected.interval_s)
    reach_m = min(config.max_range_m, _BELOW_RANGE_MAX * sweep.planar.range_max)
    near = np.where(scan.ranges > config.min_range_m, scan.ranges, np.nan)
    hit = np.isfinite(near) & (near <= reach_m)
    r, b = near[hit], scan.bearings[hit]
    hits = sweep.base_from_laser.apply(np.column_stack([r * np.cos(b), r * np.sin(b)]))
    walls = _thinned_to(hits, config.voxel_m / 2, _MAX_POINTS)
    probe = thinned(walls, config.voxel_m)
    if sweep.cloud is None:
        cloud, sparse = _in_space(walls), _in_space(probe)
        dense = cloud
    else:
        dense = _cloud_of(sweep.cloud, sweep.cloud_times_s, expected, config)
        cloud = _thinned_to(dense, config.cloud_voxel_m, _MAX_CLOUD_POINTS)
        sparse = _thinned_to(cloud, 2 * config.cloud_voxel_m, _MAX_CLOUD_POINTS // 2)
    return SweepView(
        planar=scan,
        cloud=cloud,
        sparse=sparse,
        walls=walls,
        probe=probe,
        dense=dense,
        base_from_laser=sweep.base_from_laser,
        reach_m=reach_m,
    )


def _cloud_of(
    cloud: FloatArray,
    times_s: FloatArray | None,
    expected: ExpectedMotion,
    config: RegistrationConfig,
) -> FloatArray:
    """The points of a cloud (N, 3) to be registered: cut to range, thinned, and then de-skewed.

    Points nearer than `min_range_m` over ground are the robot itself.
    """
    x, y = cloud[:, 0], cloud[:, 1]
    distance = np.sqrt(x * x + y * y)
    kept = np.flatnonzero((distance > config.min_range_m) & (distance <= config.cloud_range_m))
    kept = kept[first_in_cells(cloud[kept], config.cloud_voxel_m / 2)]
    usable = times_s is not None and usable_times(times_s, len(cloud))
    times = times_s[kept] if times_s is not None and usable else None
    return moved_returns(cloud[kept], times, expected.during, expected.interval_s)


def _in_space(points: FloatArray) -> FloatArray:
    """Points (N, 2) of the plane as (N, 3) with z = 0."""
    return np.column_stack([points, np.zeros(len(points))])


def _thinned_to(points: FloatArray, cell_m: float, most: int) -> FloatArray:
    """Points thinned at `cell_m`, or at the first larger cell that leaves at most `most`."""
    kept = thinned(points, cell_m)
    while len(kept) > most:
        cell_m *= _GROWTH
        kept = thinned(points, cell_m)
    return kept
