"""A histogram of oriented point pairs of the boundary: the feature that recognises a room best.

The boundary is resampled by arc length, so that near and far walls count alike, each point gets
the normal that points to the robot, and all pairs are counted by their distance and by how their
normals stand to each other. In the spirit of the point-pair features of Drost et al. (2010).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import IntArray
from specmap_cli.recognition.features.group import BatchGroup
from specmap_cli.recognition.features.returns import ReturnsBatch, Segments, pair_shares
from specmap_cli.recognition.features.shape import breaks_of, pieces_between, travelled_along

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
_BIN_OF_STEP: NDArray[np.uint8] = np.asarray(
    len(ORIENTATIONS)
    * np.searchsorted(
        np.round(np.square(DISTANCE_EDGES_M) * _STEPS_PER_M2),
        np.arange(_LAST_STEP + 1),
        side="right",
    ),
    dtype=np.uint8,
)
_PARALLEL, _CORNER_IN, _CORNER_OUT, _OPPOSED = range(len(ORIENTATIONS))
_OF_NONE = int(_BIN_OF_STEP[-1]) + _CORNER_OUT  # where pairs with a point that is none are counted


def point_pair_histogram(batch: ReturnsBatch) -> FloatArray:
    """(n, 66) shares of pairs by distance and orientation, boundary length in metres, point count.

    Orientations: normals within 45 degrees of each other (`parallel`), across each other in a
    concave or convex corner (`corner_in`, `corner_out`), against each other (`opposed`).
    """
    segments, points, lengths = boundary(batch)
    shares = pair_shares(segments, points, _bins, len(PAIR_COLUMNS), _OF_NONE)
    return np.column_stack([shares, lengths, segments.counts])


def boundary(batch: ReturnsBatch) -> tuple[Segments, FloatArray, FloatArray]:
    """The boundaries of n scans by arc length, K points in all: whose they are, and lengths (n,).

    Of each point (4, K) x, y and its normal, of length 1 and to the robot. Leaps from one surface
    to another are not boundary. Points lie 0.08 m apart, or farther so that there are at most 110
    of a scan.
    """
    breaks = breaks_of(batch)
    travelled = travelled_along(batch, breaks)
    lengths = batch.segments.max(travelled)
    spacing = np.maximum(_SPACING_M, lengths / _MOST_POINTS)
    counts = np.minimum(_MOST_POINTS, np.ceil((lengths - 0.5 * spacing) / spacing))
    segments = Segments.of_counts(np.maximum(0, counts))
    along = segments.spread(0.5 * spacing) + segments.place * segments.spread(spacing)
    # where each point lies along the arc, and the ends of its tangent, on the same smooth piece
    places = along + np.array([[0.0], [-_NORMAL_REACH_M], [_NORMAL_REACH_M]])
    left = np.zeros(places.shape, dtype=np.intp)
    for scan in np.flatnonzero(segments.counts).tolist():
        start, end = batch.segments.starts[scan : scan + 2].tolist()
        own = slice(*segments.starts[scan : scan + 2].tolist())
        left[:, own] = np.searchsorted(travelled[start:end], places[:, own], side="right")
        left[:, own] += start - 1
    starts, ends = pieces_between(batch.segments, breaks)
    is_end = breaks | batch.segments.last
    piece: IntArray = np.cumsum(is_end) - is_end
    low, high = starts[piece[left[0]]], ends[piece[left[0]]]
    left = np.clip(left, low, np.maximum(high - 1, low))
    right = np.minimum(left + 1, high)
    span = travelled[right] - travelled[left]
    share = np.clip(places, travelled[low], travelled[high]) - travelled[left]
    share = np.divide(share, span, out=np.zeros_like(share), where=span > 0.0)
    from_ = batch.points[:, left]
    at, before, after = (from_ + share * (batch.points[:, right] - from_)).swapaxes(0, 1)
    along_x, along_y = after - before
    size = np.sqrt(along_x * along_x + along_y * along_y)
    good = size > _NO_LENGTH_M
    points, normals = at[:, good], np.stack([-along_y, along_x])[:, good] / size[good]
    away = points[0] * normals[0] + points[1] * normals[1] > 0.0
    normals[:, away] *= -1.0
    return segments.kept(good), np.concatenate([points, normals]), lengths


def _bins(first: FloatArray, second: FloatArray) -> NDArray[np.uint8]:
    """The bins of pairs of points by distance and orientation; x, y and normal (4, ...) of each.

    NaN stands for no point; its pairs are in the bin `_OF_NONE`.
    """
    (x1, y1, u1, v1), (x2, y2, u2, v2) = first, second
    dx, dy = x2 - x1, y2 - y1
    squared = dx * dx
    squared += dy * dy
    squared *= _STEPS_PER_M2
    np.fmin(squared, _LAST_STEP, out=squared)
    bins = _BIN_OF_STEP.take(squared.astype(np.intp))
    # (p_j - p_i) . (n_i - n_j) > 0: the two surfaces face each other
    dx *= u1 - u2
    dy *= v1 - v2
    dx += dy
    cosine = u1 * u2
    cosine += v1 * v2
    kind = _CORNER_OUT - (dx > 0.0).view(np.uint8)
    kind *= ~(cosine > _ALIGNED)  # which leaves parallel ones, whose number is nought
    kind |= _OPPOSED * (cosine < -_ALIGNED).view(np.uint8)  # and this has all bits of a corner's
    bins += kind
    return np.asarray(bins)


GROUPS: tuple[BatchGroup, ...] = (
    BatchGroup(point_pair_histogram, (*PAIR_COLUMNS, "boundary_length", "boundary_points")),
)
