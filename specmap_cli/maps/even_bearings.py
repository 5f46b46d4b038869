"""Scans as messages of evenly spaced beams: what a LaserScan can carry.

A laser's own scans are evenly spaced already. Those taken in motion are not once they are
de-skewed: each beam of the message then takes the reading nearest to its bearing. A scan that has
all bearings of a circle, but whose sensor does not look all around, goes without those it never
looked at.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import PlanarScan
from specmap_cli.logs.planar import covers_circle

_FULL_CIRCLE = 2.0 * math.pi
_EVEN_RAD = 1e-5  # a fifth of a millimetre at 20 m; single precision alone takes a thirtieth of it


@dataclass(frozen=True, slots=True)
class EvenBeams:
    """Beams from `angle_min` on, `increment` apart, radians, and what each met, `ranges` (B,).

    The angles are of single precision, as in a message.
    """

    angle_min: float
    increment: float
    ranges: FloatArray


class EvenSpacing:
    """Evenly spaced beams for the scans of one laser, one after the other.

    A scan that is not evenly spaced is put on the bearings of the last one with as many beams that
    was, so that the laser's field of view stays what it is while the robot turns.
    """

    def __init__(self) -> None:
        self._known: dict[int, FloatArray] = {}  # evenly spaced bearings by their number

    def beams(self, scan: PlanarScan) -> EvenBeams:
        """The scan with evenly spaced beams."""
        bearings, ranges = scan.bearings, scan.ranges
        count, step = len(bearings), _step(bearings)
        known = self._known.get(count)
        if known is None or not np.array_equal(known, bearings):
            first, numbers = float(bearings[0]), np.arange(count, dtype=np.float64)
            if np.abs(bearings - (first + step * numbers)).max() <= _EVEN_RAD:
                self._known[count] = bearings
            else:
                over_view = _FULL_CIRCLE / count if scan.full_circle else step
                bearings = first + over_view * numbers if known is None else known
                ranges, step = _nearest(scan, bearings), _step(bearings)
        if not scan.full_circle and covers_circle(count, step):
            bearings, ranges = _looked_at(bearings, ranges)
        return EvenBeams(float(np.float32(bearings[0])), float(np.float32(step)), ranges)


def _step(bearings: FloatArray) -> float:
    """The angle from beam to beam; 0 for a single one."""
    return float(bearings[-1] - bearings[0]) / max(len(bearings) - 1, 1)


def _nearest(scan: PlanarScan, bearings: FloatArray) -> FloatArray:
    """The reading nearest to each of evenly spaced bearings, NaN where none is within a beam."""
    known, ranges = scan.bearings, scan.ranges
    if scan.full_circle:
        known = np.concatenate([known[-1:] - _FULL_CIRCLE, known, known[:1] + _FULL_CIRCLE])
        ranges = np.concatenate([ranges[-1:], ranges, ranges[:1]])
    after = np.clip(np.searchsorted(known, bearings), 1, max(len(known) - 1, 1))
    after -= np.abs(known[after - 1] - bearings) <= np.abs(known[after] - bearings)
    within = np.abs(known[after] - bearings) <= _step(bearings)
    return np.where(within, ranges[after], np.nan)


def _looked_at(bearings: FloatArray, ranges: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A circle of beams without the longest run of those that saw nothing, the first of equals.

    Two beams go at the least.
    """
    count, seen = len(ranges), np.flatnonzero(~np.isnan(ranges))
    start, length = 0, count
    if len(seen):
        lengths = np.diff(seen, append=seen[0] + count) - 1
        longest = int(np.argmax(lengths))
        start, length = int(seen[longest] + 1) % count, int(lengths[longest])
    kept = max(count - max(length, 2), 1)
    order = np.roll(np.arange(count), -(start + length))[:kept]
    turned = np.where(order < order[0], bearings[order] + _FULL_CIRCLE, bearings[order])
    return turned, ranges[order]
