"""The twelve groups of features of Table I of the paper, each a function of one scan's outline.

Every function returns a fixed number of finite values that do not change when the robot turns on
the spot; with too few returns for a value to mean anything it is zero. Lengths are in metres,
angles in radians. `GROUPS` lists them in the order of the table with the names of their columns.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import cv2
import numpy as np

from specmap_cli.core.geometry import FloatArray
from specmap_cli.recognition.features.returns import PAIR_STEP_M, Outline

GAP_THRESHOLDS_M = (0.3, 0.6, 1.2)
DISTANCE_EDGES_M = tuple(0.5 * k for k in range(1, 24))
_LARGEST_RATIO = 1e6


def consecutive_differences(outline: Outline) -> list[float]:
    """Group 1: mean and standard deviation of the change from one range to the next."""
    change = np.abs(_range_changes(outline))
    return [float(change.mean()), float(change.std())] if len(change) else [0.0, 0.0]


def gaps(outline: Outline) -> list[float]:
    """Group 2: how many changes from one range to the next pass each of `GAP_THRESHOLDS_M`."""
    change = np.abs(_range_changes(outline))
    return [float(np.count_nonzero(change > threshold)) for threshold in GAP_THRESHOLDS_M]


def range_moments(outline: Outline) -> list[float]:
    """Group 3: mean, standard deviation, skew and kurtosis of the ranges."""
    if not len(outline):
        return [0.0] * 4
    mean = float(outline.ranges.mean())
    centred = outline.ranges - mean
    squares = centred * centred
    variance = float(squares.mean())
    if variance <= 1e-12 * mean * mean:
        return [mean, 0.0, 0.0, 0.0]
    skew = float((squares * centred).mean()) / variance**1.5
    kurtosis = float((squares * squares).mean()) / variance**2
    return [mean, math.sqrt(variance), skew, kurtosis]


def range_extent(outline: Outline) -> list[float]:
    """Group 4: longest minus shortest range, and the angle between the two beams."""
    if not len(outline):
        return [0.0, 0.0]
    far, near = int(outline.ranges.argmax()), int(outline.ranges.argmin())
    angle = abs(float(outline.bearings[far] - outline.bearings[near])) % (2.0 * math.pi)
    extent = float(outline.ranges[far] - outline.ranges[near])
    return [extent, min(angle, 2.0 * math.pi - angle)]


def area_and_convexity(outline: Outline) -> list[float]:
    """Group 5: area and perimeter of the polygon seen, and both convexities.

    Area convexity is the area over that of the convex hull; perimeter convexity the hull's
    perimeter over that of the polygon.
    """
    area, perimeter = outline.area_and_perimeter
    if perimeter <= 0.0:
        return [0.0] * 4
    hull = cv2.convexHull(outline.polygon.astype(np.float32))
    hull_area, hull_perimeter = cv2.contourArea(hull), cv2.arcLength(hull, True)
    convexity = min(area / hull_area, 1.0) if hull_area > 1e-9 else 0.0
    return [area, perimeter, convexity, min(hull_perimeter / perimeter, 1.0)]


def circularity(outline: Outline) -> list[float]:
    """Group 6: circularity 4 pi A / P^2, and compactness, the area over its enclosing circle's."""
    area, perimeter = outline.area_and_perimeter
    if area <= 0.0 or perimeter <= 0.0:
        return [0.0, 0.0]
    reach = float(outline.centroid_distances.max())
    return [4.0 * math.pi * area / perimeter**2, area / (math.pi * reach**2 + 1e-12)]


def moment_invariants(outline: Outline) -> list[float]:
    """Group 7: the seven moment invariants of Hu (1962) of the area seen.

    By complex moments c_pq of the polygon (Flusser and Suk, 2006), z = x + iy about its centroid.
    """
    if len(outline) < 3:
        return [0.0] * 7
    polygon = outline.polygon
    z = polygon[:, 0] + 1j * polygon[:, 1]
    z = z - z.mean()
    following = np.concatenate([z[1:], z[:1]])
    cross = (z.conj() * following).imag  # twice the signed area of each triangle from the origin
    area = 0.5 * float(cross.sum())
    if abs(area) < 1e-9:
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


def readings_at_max_range(outline: Outline) -> list[float]:
    """Group 8: the share of beams without a return; every other feature leaves them out."""
    return [outline.no_return / outline.beams if outline.beams else 0.0]


def aspect_ratio(outline: Outline) -> list[float]:
    """Group 9: lambda_1 / lambda_2 of the principal components of the points, at most 1e6."""
    if len(outline) < 2:
        return [0.0]
    centred = outline.points - outline.points.mean(axis=0)
    (xx, xy), (_, yy) = (centred.T @ centred).tolist()
    half, root = 0.5 * (xx + yy), math.hypot(0.5 * (xx - yy), xy)
    larger, smaller = half + root, half - root
    return [larger / smaller if smaller > larger / _LARGEST_RATIO else _LARGEST_RATIO]


def mean_distance_to_centroid(outline: Outline) -> list[float]:
    """Group 10: mean distance of the points to their centroid."""
    return [float(outline.centroid_distances.mean()) if len(outline) else 0.0]


def second_derivative_flips(outline: Outline) -> list[float]:
    """Group 11: how often the second derivative of the ranges changes its sign (bumpiness)."""
    change = _range_changes(outline)
    if outline.closed and len(change) > 2:
        bend = np.diff(np.concatenate([change, change[:1]]))
        positive = np.concatenate([bend > 0.0, bend[:1] > 0.0])
    else:
        positive = np.diff(change) > 0.0
    return [float(np.count_nonzero(positive[1:] != positive[:-1]))]


def distance_histogram(outline: Outline) -> list[float]:
    """Group 12: distribution of the distance between two points of the boundary.

    The paper draws pairs at random; here all pairs of every k-th return count, so that the same
    scan always gives the same values. Bins of 0.5 m, the last one open.
    """
    if len(outline) < 2:
        return [0.0] * (len(DISTANCE_EDGES_M) + 1)
    return list(pair_histogram(outline, DISTANCE_EDGES_M).tolist())


def pair_histogram(outline: Outline, edges_m: tuple[float, ...]) -> FloatArray:
    """(len(edges) + 1,) shares of pairs of returns by distance; edges are tenths of a metre."""
    starts = [0, *(round(edge / PAIR_STEP_M) for edge in edges_m)]
    return np.add.reduceat(outline.pair_shares, starts)


def _range_changes(outline: Outline) -> FloatArray:
    """Change from each range to the next, around the circle when it is one."""
    r = outline.ranges
    change = r[1:] - r[:-1]
    if outline.closed and len(r) > 2:
        change = np.concatenate([change, r[:1] - r[-1:]])
    return change


GROUPS: tuple[tuple[Callable[[Outline], list[float]], tuple[str, ...]], ...] = (
    (consecutive_differences, ("difference_mean", "difference_std")),
    (gaps, tuple(f"gaps_over_{t:g}m" for t in GAP_THRESHOLDS_M)),
    (range_moments, ("range_mean", "range_std", "range_skew", "range_kurtosis")),
    (range_extent, ("range_extent", "range_extent_angle")),
    (area_and_convexity, ("area", "perimeter", "area_convexity", "perimeter_convexity")),
    (circularity, ("circularity", "compactness")),
    (moment_invariants, tuple(f"hu_{k}" for k in range(1, 8))),
    (readings_at_max_range, ("no_return_share",)),
    (aspect_ratio, ("aspect_ratio",)),
    (mean_distance_to_centroid, ("centroid_distance_mean",)),
    (second_derivative_flips, ("second_derivative_flips",)),
    (
        distance_histogram,
        tuple(f"distance_{low:g}m" for low in (0.0, *DISTANCE_EDGES_M)),
    ),
)
