"""What a laser would have seen from beside where it was: the outlines of scans, seen anew."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import PlanarScan
from specmap_cli.recognition.features.shape import leaps

_RANGE_DECIMALS = 6  # of metres: far below the noise of a laser, far above that of a sum
_TURN = 2.0 * math.pi
_NEAREST_M = 0.05  # a surface this near to the laser has no bearing to speak of


def outline(scan: PlanarScan, map_from_laser: Pose2, reach_m: float) -> FloatArray:
    """(k, 4) the lines x, y, x, y in the map between neighbouring returns of one surface.

    Returns farther than `reach_m` are left out.
    """
    ranges, bearings = scan.ranges, scan.bearings
    near = np.isfinite(ranges) & (ranges <= reach_m)
    r = np.where(near, ranges, 0.0)
    points = np.column_stack([r * np.cos(bearings), r * np.sin(bearings)])
    steps = np.hypot(*np.diff(points, axis=0).T)
    joined = near[1:] & near[:-1] & ~leaps(steps, r[1:], r[:-1])
    placed = map_from_laser.apply(points)
    return np.hstack([placed[:-1][joined], placed[1:][joined]])


def seen_from(
    lines: NDArray[Any], map_from_laser: Pose2, bearings: NDArray[Any], reach_m: float
) -> FloatArray:
    """(B,) ranges at bearings (B,), ascending, of the nearest of the lines (k, 4) in the map.

    +inf where there is none within `reach_m`.
    """
    laser = map_from_laser.inverse()
    starts, ends = laser.apply(lines[:, :2]), laser.apply(lines[:, 2:])
    begun, ended = _spans(starts, ends)
    first, last = np.searchsorted(bearings, begun), np.searchsorted(bearings, ended, side="right")
    beams = np.maximum(last - first, 0)
    line = np.repeat(np.arange(len(beams)), beams)
    beam = np.arange(len(line)) - np.repeat(np.cumsum(beams) - beams, beams) + first[line]
    line %= len(lines)
    ranges = np.full(len(bearings), np.inf)
    hits = _hits(starts[line], ends[line], bearings[beam])
    seen = (hits > _NEAREST_M) & (hits < reach_m)
    np.minimum.at(ranges, beam[seen], hits[seen])
    return np.round(ranges, _RANGE_DECIMALS)


def _spans(starts: FloatArray, ends: FloatArray) -> tuple[FloatArray, FloatArray]:
    """From and to which bearing lines (k,) are seen, three times (3 k,): a turn apart.

    So a line behind the laser is found on either side of where its bearings begin.
    """
    a = np.arctan2(starts[:, 1], starts[:, 0])
    turn = np.arctan2(ends[:, 1], ends[:, 0]) - a
    b = a + turn - _TURN * np.round(turn / _TURN)
    shifts = np.array([0.0, _TURN, -_TURN])[:, None]
    return (np.minimum(a, b) + shifts).ravel(), (np.maximum(a, b) + shifts).ravel()


def _hits(starts: FloatArray, ends: FloatArray, bearings: FloatArray) -> FloatArray:
    """(n,) how far along each bearing its line is crossed."""
    along = ends - starts
    crossed = starts[:, 0] * along[:, 1] - starts[:, 1] * along[:, 0]
    facing = np.cos(bearings) * along[:, 1] - np.sin(bearings) * along[:, 0]
    ranges = np.full(len(bearings), np.inf)
    np.divide(crossed, facing, out=ranges, where=facing != 0.0)
    return ranges
