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
from specmap_cli.core.records import BoolArray, PlanarScan
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
        if not self._is_even(bearings):
            bearings = self._known.get(len(bearings), _evened(scan))
            ranges = _nearest(scan, bearings)
        step = _step(bearings)
        if not scan.full_circle and covers_circle(len(bearings), step):
            bearings, ranges = _looked_at(bearings, ranges)
        return EvenBeams(float(np.float32(bearings[0])), float(np.float32(step)), ranges)

    def _is_even(self, bearings: FloatArray) -> bool:
        known = self._known.get(len(bearings))
        if known is not None and np.array_equal(known, bearings):
            return True
        if not _near(bearings, _spread(float(bearings[0]), _step(bearings), len(bearings))):
            return False
        self._known[len(bearings)] = bearings
        return True


def _step(bearings: FloatArray) -> float:
    """The angle from beam to beam; 0 for a single one."""
    return float(bearings[-1] - bearings[0]) / max(len(bearings) - 1, 1)


def _spread(first: float, step: float, count: int) -> FloatArray:
    return first + step * np.arange(count, dtype=np.float64)


def _near(bearings: FloatArray, others: FloatArray) -> bool:
    return bool(np.abs(bearings - others).max() <= _EVEN_RAD)


def _evened(scan: PlanarScan) -> FloatArray:
    """Evenly spaced bearings over the field of view of a scan."""
    count = len(scan.bearings)
    step = _FULL_CIRCLE / count if scan.full_circle else _step(scan.bearings)
    return _spread(float(scan.bearings[0]), step, count)


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
    """A circle of beams without the longest run of those that saw nothing, two at the least."""
    start, length = _longest_run(np.isnan(ranges))
    kept = max(len(ranges) - max(length, 2), 1)
    order = np.roll(np.arange(len(ranges)), -(start + length))[:kept]
    turned = np.where(order < order[0], bearings[order] + _FULL_CIRCLE, bearings[order])
    return turned, ranges[order]


def _longest_run(marked: BoolArray) -> tuple[int, int]:
    """Where the longest run of a circle's marked places begins, the first of equals; its length."""
    unmarked = np.flatnonzero(~marked)
    if not len(unmarked):
        return 0, len(marked)
    lengths = np.diff(unmarked, append=unmarked[0] + len(marked)) - 1
    longest = int(np.argmax(lengths))
    return int(unmarked[longest] + 1) % len(marked), int(lengths[longest])
