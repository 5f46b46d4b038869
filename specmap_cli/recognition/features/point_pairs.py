"""A histogram of oriented point pairs of the boundary: the feature that recognises a room best.

The boundary is resampled by arc length, so that near and far walls count alike, each point gets
the normal that points to the robot, and all pairs are counted by their distance and by how their
normals stand to each other. In the spirit of the point-pair features of Drost et al. (2010).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.recognition.features.group import FeatureGroup
from specmap_cli.recognition.features.returns import Returns, pairs_of
from specmap_cli.recognition.features.shape import breaks_of

# These define features: classifiers on disk hold thresholds on what comes of them.
DISTANCE_EDGES_M = (0.4, 0.8, 1.2, 1.6, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 7.0, 8.0, 10.0, 14.0)
ORIENTATIONS = ("parallel", "corner_in", "corner_out", "opposed")
PAIR_COLUMNS = tuple(
    f"pairs_{o}_{low:g}m" for low in (0.0, *DISTANCE_EDGES_M) for o in ORIENTATIONS
)
_SPACING_M = 0.08  # finer than a door post
_MOST_POINTS = 110  # 5,995 pairs: the cost of a scan
_NORMAL_REACH_M = 0.2  # the normal is that of 0.4 m of wall: noise of 1 cm turns it by 2 degrees
_ALIGNED = np.cos(np.pi / 4)
_NO_LENGTH_M = 1e-9  # of the tangent at a point that is a piece of its own: it has no normal

# distance bin by squared distance in steps of 0.01 m^2: all edges squared are whole steps
_STEPS_PER_M2 = 100.0
_LAST_STEP = int(DISTANCE_EDGES_M[-1] ** 2 * _STEPS_PER_M2)
_BIN_OF_STEP: NDArray[np.intp] = len(ORIENTATIONS) * np.searchsorted(
    np.round(np.square(DISTANCE_EDGES_M) * _STEPS_PER_M2), np.arange(_LAST_STEP + 1), side="right"
)


def point_pair_histogram(returns: Returns) -> list[float]:
    """(66,) shares of pairs by distance and orientation, boundary length in metres, point count.

    Orientations: normals within 45 degrees of each other (`parallel`), across each other in a
    concave or convex corner (`corner_in`, `corner_out`), against each other (`opposed`).
    """
    points, normals, length = boundary(returns)
    n = len(points)
    if n < 2:
        return [0.0] * len(PAIR_COLUMNS) + [length, float(n)]
    first, second = pairs_of(n)
    x, y = points[:, 0], points[:, 1]
    u, v = normals[:, 0], normals[:, 1]
    dx, dy = x.take(second) - x.take(first), y.take(second) - y.take(first)
    u1, v1, u2, v2 = u.take(first), v.take(first), u.take(second), v.take(second)
    cosine = u1 * u2 + v1 * v2
    # (p_j - p_i) . (n_i - n_j) > 0: the two surfaces face each other
    facing = dx * (u1 - u2) + dy * (v1 - v2) > 0.0
    orientation = 2 - facing
    orientation[cosine > _ALIGNED] = 0
    orientation[cosine < -_ALIGNED] = 3
    step = ((dx * dx + dy * dy) * _STEPS_PER_M2).astype(np.intp)
    np.minimum(step, _LAST_STEP, out=step)
    counts = np.bincount(_BIN_OF_STEP.take(step) + orientation, minlength=len(PAIR_COLUMNS))
    return [*(counts / len(step)).tolist(), length, float(n)]


def boundary(returns: Returns) -> tuple[FloatArray, FloatArray, float]:
    """The boundary by arc length: points (K, 2), unit normals (K, 2) to the robot, its length.

    Leaps from one surface to another are not boundary. Points lie 0.08 m apart, or farther so that
    there are at most 110.
    """
    if len(returns) < 2:
        return np.zeros((0, 2)), np.zeros((0, 2)), 0.0
    steps = returns.steps.copy()
    cuts = breaks_of(returns).astype(np.intp)
    steps[cuts] = 0.0
    travelled = np.concatenate([[0.0], np.cumsum(steps)])
    length = float(travelled[-1])
    if length <= 0.0:
        return np.zeros((0, 2)), np.zeros((0, 2)), 0.0
    spacing = max(_SPACING_M, length / _MOST_POINTS)
    places = np.arange(0.5 * spacing, length, spacing)[:_MOST_POINTS]
    # cut at each leap: piece k holds the arc from starts[k] to ends[k]
    starts = np.concatenate([[0], cuts + 1])
    ends = np.concatenate([cuts, [len(returns) - 1]])
    piece = np.searchsorted(travelled[starts], places, side="right") - 1
    low, high = starts[piece], ends[piece]
    points = _interpolate(returns.points, travelled, places, low, high)
    before = _interpolate(returns.points, travelled, places - _NORMAL_REACH_M, low, high)
    after = _interpolate(returns.points, travelled, places + _NORMAL_REACH_M, low, high)
    tangent = after - before
    normals = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    size = np.sqrt(normals[:, 0] ** 2 + normals[:, 1] ** 2)
    good = size > _NO_LENGTH_M
    points, normals = points[good], normals[good] / size[good, None]
    away = (points * normals).sum(axis=1) > 0.0
    normals[away] *= -1.0
    return points, normals, length


def _interpolate(
    points: FloatArray,
    travelled: FloatArray,
    places: FloatArray,
    low: NDArray[np.intp],
    high: NDArray[np.intp],
) -> FloatArray:
    """(K, 2) points at `places` along the arc, kept between the vertices low[k] and high[k]."""
    places = np.clip(places, travelled[low], travelled[high])
    left = np.searchsorted(travelled, places, side="right") - 1
    left = np.clip(left, low, np.maximum(high - 1, low))
    right = np.minimum(left + 1, high)
    span = travelled[right] - travelled[left]
    share = np.where(span > 0.0, (places - travelled[left]) / np.where(span > 0.0, span, 1.0), 0.0)
    return np.asarray(points[left] + share[:, None] * (points[right] - points[left]))


GROUPS: tuple[FeatureGroup, ...] = (
    FeatureGroup(
        point_pair_histogram,
        (*PAIR_COLUMNS, "boundary_length", "boundary_points"),
        histogram=PAIR_COLUMNS,
    ),
)
