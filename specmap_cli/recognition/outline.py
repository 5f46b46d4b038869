"""The outline of one scan: its returns in order, the raw material of every feature.

The outline of a full circle starts after its widest jump, so that a turn of the robot, which only
shifts the beams, leaves it as it is up to a rotation of the plane.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from specmap_cli.geometry import FloatArray
from specmap_cli.records import PlanarScan


@dataclass(frozen=True, slots=True)
class Outline:
    """Returns of one scan in the order of their bearings.

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


def outline_of(scan: PlanarScan) -> Outline:
    """The outline of a scan. Readings that are invalid, and those without a return, are left out;
    beyond `range_max`, or infinite, there is no return.
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
    return Outline(r, b, points, steps, scan.full_circle, len(ranges), no_return)


def _lengths(vectors: FloatArray) -> FloatArray:
    """(N,) lengths of vectors (N, 2)."""
    return np.asarray(np.sqrt(vectors[:, 0] ** 2 + vectors[:, 1] ** 2))
