"""The twelve groups of features of Table I of the paper, each a function of one scan's returns.

Every function gives a fixed number of finite values. They do not change when the robot turns on the
spot. With too few returns for a value to mean anything it is zero. Lengths are in metres, angles in
radians. `GROUPS` lists the functions in the order of the table with the names of their columns.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from specmap_cli.core.geometry import FloatArray
from specmap_cli.recognition.features.group import FeatureGroup
from specmap_cli.recognition.features.returns import PAIR_STEP_M, Returns

# These define features: classifiers on disk hold thresholds on what comes of them.
GAP_THRESHOLDS_M = (0.3, 0.6, 1.2)
DISTANCE_EDGES_M = tuple(0.5 * k for k in range(1, 24))
_LARGEST_RATIO = 1e6  # of a straight line, whose second eigenvalue is nought
_FLAT = 1e-12  # a variance below this share of the squared mean is rounding
_POINT_M2 = 1e-12  # keeps a circle about a single point from having no area
_NO_AREA_M2 = 1e-9  # an area below this is that of a line


def consecutive_differences(returns: Returns) -> list[float]:
    """Group 1: mean and standard deviation of the change from one range to the next."""
    change = np.abs(_range_changes(returns))
    return [float(change.mean()), float(change.std())] if len(change) else [0.0, 0.0]


def gaps(returns: Returns) -> list[float]:
    """Group 2: how many changes from one range to the next pass each of `GAP_THRESHOLDS_M`."""
    change = np.abs(_range_changes(returns))
    return [float(np.count_nonzero(change > threshold)) for threshold in GAP_THRESHOLDS_M]


def range_moments(returns: Returns) -> list[float]:
    """Group 3: mean, standard deviation, skew and kurtosis of the ranges."""
    if not len(returns):
        return [0.0] * 4
    mean = float(returns.ranges.mean())
    centred = returns.ranges - mean
    squares = centred * centred
    variance = float(squares.mean())
    if variance <= _FLAT * mean * mean:
        return [mean, 0.0, 0.0, 0.0]
    skew = float((squares * centred).mean()) / variance**1.5
    kurtosis = float((squares * squares).mean()) / variance**2
    return [mean, math.sqrt(variance), skew, kurtosis]


def range_extent(returns: Returns) -> list[float]:
    """Group 4: longest minus shortest range, and the angle between the two beams."""
    if not len(returns):
        return [0.0, 0.0]
    far, near = int(returns.ranges.argmax()), int(returns.ranges.argmin())
    angle = abs(float(returns.bearings[far] - returns.bearings[near])) % (2.0 * math.pi)
    extent = float(returns.ranges[far] - returns.ranges[near])
    return [extent, min(angle, 2.0 * math.pi - angle)]


def area_and_convexity(returns: Returns) -> list[float]:
    """Group 5: area and perimeter of the polygon seen, and both convexities.

    Area convexity is the area over that of the convex hull; perimeter convexity the hull's
    perimeter over that of the polygon.
    """
    area, perimeter = returns.area_and_perimeter
    if perimeter <= 0.0:
        return [0.0] * 4
    hull = cv2.convexHull(returns.polygon.astype(np.float32))
    hull_area, hull_perimeter = cv2.contourArea(hull), cv2.arcLength(hull, True)
    convexity = min(area / hull_area, 1.0) if hull_area > _NO_AREA_M2 else 0.0
    return [area, perimeter, convexity, min(hull_perimeter / perimeter, 1.0)]


def circularity(returns: Returns) -> list[float]:
    """Group 6: circularity 4 pi A / P^2, and compactness, the area over its enclosing circle's."""
    area, perimeter = returns.area_and_perimeter
    if area <= 0.0 or perimeter <= 0.0:
        return [0.0, 0.0]
    reach = float(returns.centroid_distances.max())
    return [4.0 * math.pi * area / perimeter**2, area / (math.pi * reach**2 + _POINT_M2)]


def moment_invariants(returns: Returns) -> list[float]:
    """Group 7: the seven moment invariants of Hu (1962) of the area seen.

    By complex moments c_pq of the polygon (Flusser and Suk, 2006), z = x + iy about its centroid.
    """
    if len(returns) < 3:
        return [0.0] * 7
    polygon = returns.polygon
    z = polygon[:, 0] + 1j * polygon[:, 1]
    z = z - z.mean()
    following = np.concatenate([z[1:], z[:1]])
    cross = (z.conj() * following).imag  # twice the signed area of each triangle from the origin
    area = 0.5 * float(cross.sum())
    if abs(area) < _NO_AREA_M2:
        return [0.0] * 7
    centroid = complex((cross * (z + following)).sum() / (6.0 * area))
    a, b = z - centroid, following - centroid
    cross = (a.conj() * b).imag / area
    a_, b_ = a.conj(), b.conj()
    scale = abs(area)
    c11 = float((cross * (a * a_ + b * b_ + (a * b_).real)).real.sum()) / (12.0 * scale)
    c20 = complex((cross * (a * a + a * b + b * b)).sum()) / (12.0 * scale)
    cubic = a * a * a + a * a * b + a * b * b + b * b * b
    c30 = complex((cross * cubic).sum()) / (20.0 * scale**1.5)
    mixed = (3 * a * a + 2 * a * b + b * b) * a_ + (a * a + 2 * a * b + 3 * b * b) * b_
    c21 = complex((cross * mixed).sum()) / (60.0 * scale**1.5)
    c12 = c21.conjugate()
    return [
        c11,
        abs(c20) ** 2,
        abs(c30) ** 2,
        abs(c21) ** 2,
        (c30 * c12**3).real,
        (c20 * c12**2).real,
        (c30 * c12**3).imag,
    ]


def readings_at_max_range(returns: Returns) -> list[float]:
    """Group 8: the share of beams without a return; every other feature leaves them out."""
    return [returns.no_return / returns.beams if returns.beams else 0.0]


def aspect_ratio(returns: Returns) -> list[float]:
    """Group 9: lambda_1 / lambda_2 of the principal components of the points, at most 1e6."""
    if len(returns) < 2:
        return [0.0]
    x, y = (returns.points - returns.points.mean(axis=0)).T
    xx, xy, yy = float((x * x).sum()), float((x * y).sum()), float((y * y).sum())
    half, root = 0.5 * (xx + yy), math.hypot(0.5 * (xx - yy), xy)
    larger, smaller = half + root, half - root
    return [larger / smaller if smaller > larger / _LARGEST_RATIO else _LARGEST_RATIO]


def mean_distance_to_centroid(returns: Returns) -> list[float]:
    """Group 10: mean distance of the points to their centroid."""
    return [float(returns.centroid_distances.mean()) if len(returns) else 0.0]


def second_derivative_flips(returns: Returns) -> list[float]:
    """Group 11: how often the second derivative of the ranges changes its sign (bumpiness)."""
    change = _range_changes(returns)
    if returns.closed and len(change) > 2:
        bend = np.diff(np.concatenate([change, change[:1]]))
        positive = np.concatenate([bend > 0.0, bend[:1] > 0.0])
    else:
        positive = np.diff(change) > 0.0
    return [float(np.count_nonzero(positive[1:] != positive[:-1]))]


def distance_histogram(returns: Returns) -> list[float]:
    """Group 12: distribution of the distance between two points of the boundary.

    The paper draws pairs at random; here all pairs of every k-th return count, so that the same
    scan always gives the same values. Bins of 0.5 m, the last one open.
    """
    if len(returns) < 2:
        return [0.0] * (len(DISTANCE_EDGES_M) + 1)
    return list(pair_histogram(returns, DISTANCE_EDGES_M).tolist())


def pair_histogram(returns: Returns, edges_m: tuple[float, ...]) -> FloatArray:
    """(len(edges) + 1,) shares of pairs of returns by distance; edges are tenths of a metre."""
    starts = [0, *(round(edge / PAIR_STEP_M) for edge in edges_m)]
    return np.add.reduceat(returns.pair_shares, starts)


def _range_changes(returns: Returns) -> FloatArray:
    """Change from each range to the next, around the circle when it is one."""
    r = returns.ranges
    change = r[1:] - r[:-1]
    if returns.closed and len(r) > 2:
        change = np.concatenate([change, r[:1] - r[-1:]])
    return change


_DISTANCE_COLUMNS = tuple(f"distance_{low:g}m" for low in (0.0, *DISTANCE_EDGES_M))

GROUPS: tuple[FeatureGroup, ...] = (
    FeatureGroup(consecutive_differences, ("difference_mean", "difference_std")),
    FeatureGroup(gaps, tuple(f"gaps_over_{t:g}m" for t in GAP_THRESHOLDS_M)),
    FeatureGroup(range_moments, ("range_mean", "range_std", "range_skew", "range_kurtosis")),
    FeatureGroup(range_extent, ("range_extent", "range_extent_angle")),
    FeatureGroup(
        area_and_convexity, ("area", "perimeter", "area_convexity", "perimeter_convexity")
    ),
    FeatureGroup(circularity, ("circularity", "compactness")),
    FeatureGroup(moment_invariants, tuple(f"hu_{k}" for k in range(1, 8))),
    FeatureGroup(readings_at_max_range, ("no_return_share",)),
    FeatureGroup(aspect_ratio, ("aspect_ratio",)),
    FeatureGroup(mean_distance_to_centroid, ("centroid_distance_mean",)),
    FeatureGroup(second_derivative_flips, ("second_derivative_flips",)),
    FeatureGroup(distance_histogram, _DISTANCE_COLUMNS, histogram=_DISTANCE_COLUMNS),
)
