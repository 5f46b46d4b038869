"""The returns of one scan in order: the raw material of every feature.

Those of a full circle start after the widest jump. A turn of the robot, which only shifts the
beams, then leaves them as they are, up to a rotation of the plane.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import PlanarScan

# These define features: classifiers on disk hold thresholds on what comes of them.
PAIR_STEP_M = 0.1
PAIR_STEPS = 120  # distances of pairs are told apart up to 12 m
_PAIR_POINTS = 90  # 4,005 pairs: the shares are good to a percent, and cheap


@dataclass(frozen=True, kw_only=True)  # without slots: some properties are computed once
class Returns:
    """The returns of one scan in the order of their bearings.

    `ranges` (N,) and `bearings` (N,); `points` (N, 2) in the laser frame; `steps` (N - 1,) metres
    from each point to the next; `closed` when the sweep is a full circle, whose last point then
    comes before its first; `beams` readings in all, `no_return` of them without a return.
    """

    ranges: FloatArray
    bearings: FloatArray
    points: FloatArray
    steps: FloatArray
    closed: bool
    beams: int
    no_return: int

    def __len__(self) -> int:
        return len(self.ranges)

    @property
    def polygon(self) -> FloatArray:
        """(M, 2) vertices of the area that was seen: with the laser itself unless a circle."""
        if self.closed:
            return self.points
        return np.vstack([np.zeros((1, 2)), self.points])

    @cached_property
    def area_and_perimeter(self) -> tuple[float, float]:
        """Square metres and metres of the polygon, zero with fewer than two returns."""
        if len(self) < 2:
            return 0.0, 0.0
        x, y = self.points[:, 0], self.points[:, 1]
        twice = float((x[:-1] * y[1:] - x[1:] * y[:-1]).sum())
        perimeter = float(self.steps.sum())
        if self.closed:
            twice += float(x[-1] * y[0] - x[0] * y[-1])
            perimeter += math.hypot(x[-1] - x[0], y[-1] - y[0])
        else:
            perimeter += float(self.ranges[0] + self.ranges[-1])
        return 0.5 * abs(twice), perimeter

    @cached_property
    def centroid_distances(self) -> FloatArray:
        """(N,) metres from each return to the mean of all returns."""
        return _lengths(self.points - self.points.mean(axis=0))

    @cached_property
    def pair_shares(self) -> FloatArray:
        """(121,) share of pairs of returns by distance in steps of 0.1 m, the last one open.

        All pairs of every k-th return, at most 90 of them, so that a scan has one histogram.
        """
        points = self.points[:: max(1, -(-len(self) // _PAIR_POINTS))]
        n = len(points)
        first, second = pairs_of(n)
        x, y = points[:, 0], points[:, 1]
        dx, dy = x.take(first) - x.take(second), y.take(first) - y.take(second)
        steps = (np.sqrt(dx * dx + dy * dy) * (1.0 / PAIR_STEP_M)).astype(np.intp)
        np.minimum(steps, PAIR_STEPS, out=steps)
        counts = np.bincount(steps, minlength=PAIR_STEPS + 1)
        return np.asarray(counts / max(1, len(steps)), dtype=np.float64)


@lru_cache(maxsize=256)
def pairs_of(count: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Both numbers (k,) of every pair of `count` items."""
    first, second = np.triu_indices(count, 1)
    return first, second


def returns_of(scan: PlanarScan) -> Returns:
    """The returns of a scan. A reading of `range_max` or more, or infinite, is no return.

    Invalid readings, which are NaN or nought, are neither.
    """
    ranges = scan.ranges
    valid = ranges > 0.0
    hit = valid & (ranges < scan.range_max)
    no_return = int(np.count_nonzero(valid) - np.count_nonzero(hit))
    r, b = ranges[hit], scan.bearings[hit]
    points = np.empty((len(r), 2))
    points[:, 0], points[:, 1] = r * np.cos(b), r * np.sin(b)
    steps = _lengths(points[1:] - points[:-1])
    if scan.full_circle and len(r) > 2:
        closing = float(np.hypot(*(points[0] - points[-1])))
        widest = int(np.argmax(steps))
        if steps[widest] > closing:
            r, b, points = (np.roll(a, -widest - 1, axis=0) for a in (r, b, points))
            steps = np.concatenate([steps[widest + 1 :], [closing], steps[:widest]])
    return Returns(
        ranges=r,
        bearings=b,
        points=points,
        steps=steps,
        closed=scan.full_circle,
        beams=len(ranges),
        no_return=no_return,
    )


def _lengths(vectors: FloatArray) -> FloatArray:
    """(N,) lengths of vectors (N, 2)."""
    return np.asarray(np.sqrt(vectors[:, 0] ** 2 + vectors[:, 1] ** 2))
