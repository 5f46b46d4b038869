"""How well the walls in sight fix the place of a scan: along a bare corridor, not at all."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from specmap_cli.core.geometry import FloatArray, product
from specmap_cli.grids.evidence import SURFACE_GAP_M

_DISTINCT_M = 1e-6  # between points of which the direction of a surface can be had
# Of smoothed surfaces: pieces so long that 3 cm of noise turn their normals by less than 0.1 rad,
# which makes a hundredth of the information; whoever stands in a room has ten times that.
_PIECE_M, _SMOOTHED_GAP_M, _NOISE_SHARE = 0.25, 0.5, 0.02
_FEWEST_SURFACES = 3  # as many as unknowns


def observability(points: FloatArray, range_noise_m: float) -> FloatArray:
    """Fisher information (3, 3) of a scan's own pose, from points (N, 2) in order of bearing.

    Sum of J^T J / sigma^2 with J = (n, p x n) for the surface normal n at p and the error sigma of
    a range (Censi, "On achievable accuracy for range-finder localization", ICRA 2007). Points
    without a neighbour on either side within reach of one surface say nothing.
    """
    if len(points) < 3:
        return np.zeros((3, 3))
    tangent = points[2:] - points[:-2]
    length = np.hypot(tangent[:, 0], tangent[:, 1])
    good = (length > _DISTINCT_M) & (length < 2 * SURFACE_GAP_M)
    tangent, p = tangent[good] / length[good, None], points[1:-1][good]
    normal = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    rows = np.column_stack([normal, p[:, 0] * normal[:, 1] - p[:, 1] * normal[:, 0]])
    return product(rows.T, rows) / range_noise_m**2


@dataclass(frozen=True, slots=True)
class WeakestDirection:
    """The direction in which the walls in sight fix a place least.

    `share` of what they fix in all directions together is fixed in this one: 0 along a bare
    corridor, 0.5 where all are alike. `heading` in radians, in the frame of the points.
    """

    share: float
    heading: float

    @property
    def open(self) -> bool:
        """Whether nothing but noise fixes the place in this direction."""
        return self.share < _NOISE_SHARE


def weakest_direction(points: FloatArray) -> WeakestDirection:
    """Of points (N, 2) in order of bearing.

    As `observability`, but of walls smoothed over some decimetres: the noise of single readings
    turns the normals of dense points so much that a bare corridor would seem to have ends.
    """
    places, normals, counts = _smoothed_surfaces(points)
    if len(places) < _FEWEST_SURFACES:
        return WeakestDirection(0.0, 0.0)
    turns = places[:, 0] * normals[:, 1] - places[:, 1] * normals[:, 0]
    rows = np.column_stack([normals, turns])
    fisher = np.einsum("na,n,nb->ab", rows, counts, rows)
    arm, moment = fisher[:2, 2], float(fisher[2, 2])
    place = fisher[:2, :2] - np.outer(arm, arm) / moment if moment > 0.0 else fisher[:2, :2]
    (xx, xy), (_, yy) = place.tolist()
    middle, half = 0.5 * (xx + yy), math.hypot(0.5 * (xx - yy), xy)
    heading = 0.5 * math.atan2(2.0 * xy, xx - yy) + 0.5 * math.pi  # across the strongest one
    return WeakestDirection(max(0.0, (middle - half) / (2.0 * middle)), heading)


def _smoothed_surfaces(points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Places (k, 2), unit normals (k, 2) and numbers of points (k,) of pieces of surfaces."""
    if len(points) < _FEWEST_SURFACES:
        return np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0)
    steps = np.hypot(*np.diff(points, axis=0).T)
    apart = np.where(steps < _SMOOTHED_GAP_M, steps, 2.0 * _SMOOTHED_GAP_M)
    piece = np.floor(np.concatenate([[0.0], np.cumsum(apart)]) / _PIECE_M)
    _, start, count = np.unique(piece, return_index=True, return_counts=True)
    middle = np.add.reduceat(points, start, axis=0) / count[:, None]
    tangent = middle[2:] - middle[:-2]
    length = np.hypot(tangent[:, 0], tangent[:, 1])
    good = (length > _DISTINCT_M) & (length < 2 * _SMOOTHED_GAP_M)
    tangent = tangent[good] / length[good, None]
    normal = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    return middle[1:-1][good], normal, count[1:-1][good].astype(np.float64)
