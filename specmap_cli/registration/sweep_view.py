"""What one sweep offers to registration: its points, de-skewed, cut to range and thinned.

A rotating laser measures while the robot moves: returns are brought to where the robot stood at the
sweep's stamp. With the motion from one sweep to the next as the estimate of the motion during the
sweep, a return measured t seconds after the stamp is moved by the share t / period of it. Times
that are missing, equal, not finite or of another count than the returns change nothing: such times
come from drivers that do not know them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from specmap_cli.core.arrays import first_in_cells
from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import PlanarScan, Sweep
from specmap_cli.core.settings import RegistrationConfig
from specmap_cli.grids.score_field import thinned

_MAX_POINTS = 600  # a denser planar scan is thinned to this
# A denser 3D cloud is thinned to this: alignments take most time. Half is enough near a guess by
# odometry; without one a fast vehicle in a street is lost then.
_MAX_CLOUD_POINTS = 2000
_BELOW_RANGE_MAX = 0.999  # some drivers report no return as the largest range, rounded
_MOST_BEAMS = 360  # of an outline: a degree each, 0.2 m apart at 12 m
_GROWTH = 1.4  # of the cell from one try to the next at thinning: about half the points


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepView:
    """The points of a sweep, in the base frame.

    `cloud` (N, 3) is registered; `sparse` (K, 3) is enough for coarse alignments. `walls` (M, 2) go
    into the score field and `probe` (L, 2) is scored on it. `dense` (D, 3) goes into the local map:
    thinned alike, two clouds of one street fit best where they stand alike to the lidar, as if it
    had not moved. `planar` is the scan to hand on.
    Its laser stood at `base_from_laser`, and walls beyond `reach_m` of it are not looked at.
    """

    planar: PlanarScan
    cloud: FloatArray
    sparse: FloatArray
    walls: FloatArray
    probe: FloatArray
    dense: FloatArray
    base_from_laser: Pose2
    reach_m: float


def view_of(
    sweep: Sweep,
    during: Pose2,
    interval_s: float,
    config: RegistrationConfig,
) -> SweepView:
    """The points of a sweep, de-skewed with the motion expected during it, and its seconds."""
    scan = deskewed(sweep.planar, sweep.base_from_laser, during, interval_s)
    reach_m = min(config.max_range_m, _BELOW_RANGE_MAX * sweep.planar.range_max)
    near = np.where(scan.ranges > config.min_range_m, scan.ranges, np.nan)
    hit = np.isfinite(near) & (near <= reach_m)
    r, b = near[hit], scan.bearings[hit]
    hits = sweep.base_from_laser.apply(np.column_stack([r * np.cos(b), r * np.sin(b)]))
    walls = _thinned_to(hits, config.voxel_m / 2, _MAX_POINTS)
    probe = thinned(walls, config.voxel_m)
    if sweep.cloud is None:
        cloud, sparse = (np.column_stack([at, np.zeros(len(at))]) for at in (walls, probe))
        dense = cloud
    else:
        # cut to range, thinned, and then de-skewed; what is too near over ground is the robot
        points, times_s = sweep.cloud, sweep.cloud_times_s
        x, y = points[:, 0], points[:, 1]
        away = np.sqrt(x * x + y * y)
        kept = np.flatnonzero((away > config.min_range_m) & (away <= config.cloud_range_m))
        kept = kept[first_in_cells(points[kept], config.cloud_voxel_m / 2)]
        usable = usable_times(times_s, len(points))
        times_s = times_s[kept] if times_s is not None and usable else None
        dense = moved_returns(points[kept], times_s, during, interval_s)
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


def outline_of(scan: PlanarScan, base_from_laser: Pose2, reach_m: float) -> FloatArray:
    """Corners (N, 2), base frame, of the space that a scan looked through, the laser first.

    A beam without a return says nothing about the space along it: it ends at the laser.
    """
    stride = max(1, math.ceil(len(scan.ranges) / _MOST_BEAMS))
    ranges, bearings = scan.ranges[::stride], scan.bearings[::stride]
    r = np.where(np.isfinite(ranges), np.minimum(ranges, reach_m), 0.0)
    ends = np.column_stack([r * np.cos(bearings), r * np.sin(bearings)])
    laser = np.zeros((1, 2))
    return base_from_laser.apply(
        np.concatenate([laser, ends, ends[:1] if scan.full_circle else laser])
    )


def _thinned_to(points: FloatArray, cell_m: float, most: int) -> FloatArray:
    """Points thinned at `cell_m`, or at the first larger cell that leaves at most `most`."""
    kept = thinned(points, cell_m)
    while len(kept) > most:
        cell_m *= _GROWTH
        kept = thinned(points, cell_m)
    return kept


_STILL_M, _STILL_RAD = 1e-3, 1e-4  # a motion in one sweep below what range readings resolve
_STRAIGHT_RAD = 1e-9  # below it sin(x) / x is 1 to the last bit


def usable_times(times_s: FloatArray | None, count: int) -> bool:
    """Whether per-return times can be used: finite, as many as returns, not all the same."""
    if times_s is None or len(times_s) != count or count < 2:
        return False
    return bool(np.isfinite(times_s).all()) and float(np.ptp(times_s)) > 0.0


def moved_returns(
    points: FloatArray, times_s: FloatArray | None, motion: Pose2, interval_s: float
) -> FloatArray:
    """Points (N, 2) or (N, 3) of a moving base, in the base frame of the sweep's stamp.

    `motion` is the base's motion over `interval_s` seconds. Stamps may come in bursts, so that the
    interval counts at least as long as the sweep itself lasted.
    """
    if times_s is None or _is_still(motion) or not usable_times(times_s, len(points)):
        return points
    share = times_s / _period_s(times_s, interval_s)
    turn, half = share * motion.theta, motion.theta / 2
    # a constant turn and forward speed: the chord of the arc, shortened and turned with its share
    full = math.sin(half) / half if abs(half) > _STRAIGHT_RAD else 1.0
    chord = share * np.sinc(turn / (2 * np.pi)) / full
    back = turn / 2 - half
    dx = chord * (np.cos(back) * motion.x - np.sin(back) * motion.y)
    dy = chord * (np.sin(back) * motion.x + np.cos(back) * motion.y)
    c, s = np.cos(turn), np.sin(turn)
    moved = np.array(points, dtype=np.float64)
    moved[:, 0] = dx + c * points[:, 0] - s * points[:, 1]
    moved[:, 1] = dy + s * points[:, 0] + c * points[:, 1]
    return moved


def deskewed(
    scan: PlanarScan, base_from_laser: Pose2, motion: Pose2, interval_s: float
) -> PlanarScan:
    """The scan as it would have been taken at once at its stamp; the same object if it was.

    Bearings come back ascending, within one turn; beams without a return keep none.
    """
    times = scan.beam_times_s
    if times is None or _is_still(motion) or not usable_times(times, len(scan.bearings)):
        return scan
    hit = np.isfinite(scan.ranges)
    reach = np.where(hit, scan.ranges, 1.0)
    ends = np.column_stack([reach * np.cos(scan.bearings), reach * np.sin(scan.bearings)])
    moved = moved_returns(base_from_laser.apply(ends), times, motion, interval_s)
    seen = base_from_laser.inverse().apply(moved)
    turning = motion.theta / _period_s(times, interval_s)
    bearings = scan.bearings + times * turning
    bearings[hit] = np.arctan2(seen[hit, 1], seen[hit, 0])
    first = float(scan.bearings[0])
    if scan.full_circle:
        bearings = first + np.mod(bearings - first, 2 * np.pi)
    else:
        bearings = scan.bearings + np.mod(bearings - scan.bearings + np.pi, 2 * np.pi) - np.pi
    ranges = np.where(hit, np.hypot(seen[:, 0], seen[:, 1]), scan.ranges)
    order = np.argsort(bearings, kind="stable")
    return replace(scan, bearings=bearings[order], ranges=ranges[order], beam_times_s=None)


def _is_still(motion: Pose2) -> bool:
    """Whether the robot stood still, as far as a sweep can tell."""
    return motion.distance < _STILL_M and abs(motion.theta) < _STILL_RAD


def _period_s(times_s: FloatArray, interval_s: float) -> float:
    """The seconds in which the robot moved from sweep to sweep: no fewer than a sweep lasts."""
    return max(interval_s, float(np.ptp(times_s)))
