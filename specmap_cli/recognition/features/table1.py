"""The twelve groups of features of Table I of the paper, each a function of scans' returns.

Every function gives a fixed number of finite values of each scan, (n, columns) of n scans. They do
not change when the robot turns on the spot. With too few returns for a value to mean anything it is
zero. Lengths are in metres, angles in radians. `GROUPS` lists the functions in the order of the
table with the names of their columns.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from specmap_cli.core.geometry import FloatArray
from specmap_cli.recognition.features.group import BatchGroup
from specmap_cli.recognition.features.returns import PAIR_STEP_M, ReturnsBatch, ratio

# These define features: classifiers on disk hold thresholds on what comes of them.
GAP_THRESHOLDS_M = (0.3, 0.6, 1.2)
DISTANCE_EDGES_M = tuple(0.5 * k for k in range(1, 24))
_LARGEST_RATIO = 1e6  # of a straight line, whose second eigenvalue is nought
_FLAT = 1e-12  # a variance below this share of the squared mean is rounding
_POINT_M2 = 1e-12  # keeps a circle about a single point from having no area
_NO_AREA_M2 = 1e-9  # an area below this is that of a line


def consecutive_differences(batch: ReturnsBatch) -> FloatArray:
    """Group 1: mean and standard deviation of the change from one range to the next."""
    segments, change = batch.range_changes
    mean = segments.mean(change)
    off = change - segments.spread(mean)
    return np.column_stack([mean, np.sqrt(segments.mean(off * off))])


def gaps(batch: ReturnsBatch) -> FloatArray:
    """Group 2: how many changes from one range to the next pass each of `GAP_THRESHOLDS_M`."""
    segments, change = batch.range_changes
    limits = np.array(GAP_THRESHOLDS_M)[:, None]
    return segments.sum(change > limits).T.astype(np.float64)


def range_moments(batch: ReturnsBatch) -> FloatArray:
    """Group 3: mean, standard deviation, skew and kurtosis of the ranges."""
    segments = batch.segments
    mean = segments.mean(batch.ranges)
    centred = batch.ranges - segments.spread(mean)
    squares = centred * centred
    variance = segments.mean(squares)
    variance[variance <= _FLAT * mean * mean] = 0.0
    deviation = np.sqrt(variance)
    third, fourth = segments.mean(squares * np.stack([centred, squares]))
    skew, kurtosis = ratio(third, variance * deviation), ratio(fourth, variance * variance)
    return np.column_stack([mean, deviation, skew, kurtosis])


def range_extent(batch: ReturnsBatch) -> FloatArray:
    """Group 4: longest minus shortest range, and the angle between the two beams."""
    values = np.zeros((len(batch), 2))
    some = batch.counts > 0
    far = batch.segments.argmax(batch.ranges)[some]
    near = batch.segments.argmax(-batch.ranges)[some]
    values[some, 0] = batch.ranges[far] - batch.ranges[near]
    angle = np.abs(batch.bearings[far] - batch.bearings[near]) % (2.0 * math.pi)
    values[some, 1] = np.minimum(angle, 2.0 * math.pi - angle)
    return values


def area_and_convexity(batch: ReturnsBatch) -> FloatArray:
    """Group 5: area and perimeter of the polygon seen, and both convexities.

    Area convexity is the area over that of the convex hull; perimeter convexity the hull's
    perimeter over that of the polygon.
    """
    areas, perimeters = batch.areas_and_perimeters
    segments, vertices = batch.polygons
    # a corner that single precision cannot tell from -0 is 0: of points that differ in that sign
    # alone, OpenCV makes no hull
    corners = vertices.T.astype(np.float32, order="C") + np.float32(0.0)
    values = np.zeros((len(batch), 4))
    for k in np.flatnonzero(perimeters > 0.0).tolist():
        hull = cv2.convexHull(corners[segments.starts[k] : segments.starts[k + 1]])
        hull_area, hull_perimeter = cv2.contourArea(hull), cv2.arcLength(hull, True)
        area, perimeter = float(areas[k]), float(perimeters[k])
        convexity = min(area / hull_area, 1.0) if hull_area > _NO_AREA_M2 else 0.0
        values[k] = area, perimeter, convexity, min(hull_perimeter / perimeter, 1.0)
    return values


def circularity(batch: ReturnsBatch) -> FloatArray:
    """Group 6: circularity 4 pi A / P^2, and compactness, the area over its enclosing circle's."""
    area, perimeter = batch.areas_and_perimeters
    reach = batch.segments.max(batch.centroid_distances)
    compactness = area / (math.pi * reach * reach + _POINT_M2)
    return np.column_stack([ratio(4.0 * math.pi * area, perimeter * perimeter), compactness])


def moment_invariants(batch: ReturnsBatch) -> FloatArray:
    """Group 7: the seven moment invariants of Hu (1962) of the area seen.

    By complex moments c_pq of the polygon (Flusser and Suk, 2006), z = x + iy about its centroid.
    """
    segments, (x, y) = batch.polygons
    z = x + 1j * y
    z -= segments.spread(segments.mean(z))
    following = z[segments.following]
    cross = (z.conj() * following).imag  # twice the signed area of each triangle from the origin
    area = 0.5 * segments.sum(cross)
    some = (batch.counts >= 3) & (np.abs(area) >= _NO_AREA_M2)
    area = np.where(some, area, 1.0)
    centroid = segments.spread(segments.sum(cross * (z + following)) / (6.0 * area))
    a, b = z - centroid, following - centroid
    cross = (a.conj() * b).imag / segments.spread(area)
    aa, ab, bb = a * a, a * b, b * b
    squared = (a * a.conj() + b * b.conj() + a * b.conj()).real
    cubic = aa * a + aa * b + ab * b + bb * b
    mixed = (3 * aa + 2 * ab + bb) * a.conj() + (aa + 2 * ab + 3 * bb) * b.conj()
    sums = segments.sum(cross * np.stack([squared, aa + ab + bb, cubic, mixed]))
    scale = np.abs(area) * np.sqrt(np.abs(area))
    c11, c20 = sums[0].real / (12.0 * np.abs(area)), sums[1] / (12.0 * np.abs(area))
    c30, c21 = sums[2] / (20.0 * scale), sums[3] / (60.0 * scale)
    c12 = c21.conj()
    third = c30 * (c12 * (c12 * c12))
    values = [
        c11,
        np.abs(c20) ** 2,
        np.abs(c30) ** 2,
        np.abs(c21) ** 2,
        third.real,
        (c20 * (c12 * c12)).real,
        third.imag,
    ]
    return np.where(some[:, None], np.column_stack(values), 0.0)


def readings_at_max_range(batch: ReturnsBatch) -> FloatArray:
    """Group 8: the share of beams without a return; every other feature leaves them out."""
    return ratio(batch.no_return, batch.beams)[:, None]


def aspect_ratio(batch: ReturnsBatch) -> FloatArray:
    """Group 9: lambda_1 / lambda_2 of the principal components of the points, at most 1e6."""
    x, y = batch.centred
    xx, xy, yy = batch.segments.sum(np.stack([x * x, x * y, y * y]))
    half, root = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    larger, smaller = half + root, half - root
    bounded = smaller > larger / _LARGEST_RATIO
    values = np.full(len(batch), _LARGEST_RATIO)
    np.divide(larger, smaller, out=values, where=bounded)
    return np.where(batch.counts >= 2, values, 0.0)[:, None]


def mean_distance_to_centroid(batch: ReturnsBatch) -> FloatArray:
    """Group 10: mean distance of the points to their centroid."""
    return batch.segments.mean(batch.centroid_distances)[:, None]


def second_derivative_flips(batch: ReturnsBatch) -> FloatArray:
    """Group 11: how often the second derivative of the ranges changes its sign (bumpiness)."""
    segments = batch.segments
    after = segments.following
    change = batch.ranges[after] - batch.ranges
    positive = change[after] - change > 0.0
    around = segments.spread(batch.closed & (batch.counts > 2))
    told = around | (segments.place + 3 < segments.spread(batch.counts))
    return segments.sum((positive[after] != positive) & told)[:, None].astype(np.float64)


def distance_histogram(
    batch: ReturnsBatch, edges_m: tuple[float, ...] = DISTANCE_EDGES_M
) -> FloatArray:
    """Group 12: distribution of the distance between two points of the boundary.

    The paper draws pairs at random; here all pairs of every k-th return count, so that the same
    scan always gives the same values. Bins between edges of tenths of a metre, the last one open.
    """
    starts = [0, *(round(edge / PAIR_STEP_M) for edge in edges_m)]
    return np.add.reduceat(batch.pair_shares, starts, axis=1)


_DISTANCE_COLUMNS = tuple(f"distance_{low:g}m" for low in (0.0, *DISTANCE_EDGES_M))

GROUPS: tuple[BatchGroup, ...] = (
    BatchGroup(consecutive_differences, ("difference_mean", "difference_std")),
    BatchGroup(gaps, tuple(f"gaps_over_{t:g}m" for t in GAP_THRESHOLDS_M)),
    BatchGroup(range_moments, ("range_mean", "range_std", "range_skew", "range_kurtosis")),
    BatchGroup(range_extent, ("range_extent", "range_extent_angle")),
    BatchGroup(area_and_convexity, ("area", "perimeter", "area_convexity", "perimeter_convexity")),
    BatchGroup(circularity, ("circularity", "compactness")),
    BatchGroup(moment_invariants, tuple(f"hu_{k}" for k in range(1, 8))),
    BatchGroup(readings_at_max_range, ("no_return_share",)),
    BatchGroup(aspect_ratio, ("aspect_ratio",)),
    BatchGroup(mean_distance_to_centroid, ("centroid_distance_mean",)),
    BatchGroup(second_derivative_flips, ("second_derivative_flips",)),
    BatchGroup(distance_histogram, _DISTANCE_COLUMNS),
)
