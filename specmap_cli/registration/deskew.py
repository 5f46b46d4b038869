"""De-skewing: returns of one sweep brought to where the robot stood at the sweep's stamp.

A rotating laser measures while the robot moves. With the motion from one sweep to the next as the
estimate of the motion during the sweep, a return measured t seconds after the stamp is moved by the
share t / period of it. Times that are missing, equal, not finite or of another count than the
returns change nothing: such times come from drivers that do not know them.
"""

from __future__ import annotations

import math

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import PlanarScan

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
    return PlanarScan(
        stamp_ns=scan.stamp_ns,
        bearings=bearings[order],
        ranges=ranges[order],
        range_max=scan.range_max,
        full_circle=scan.full_circle,
    )


def _is_still(motion: Pose2) -> bool:
    """Whether the robot stood still, as far as a sweep can tell."""
    return motion.distance < _STILL_M and abs(motion.theta) < _STILL_RAD


def _period_s(times_s: FloatArray, interval_s: float) -> float:
    """The seconds in which the robot moved from sweep to sweep: no fewer than a sweep lasts."""
    return max(interval_s, float(np.ptp(times_s)))
