"""Features of one scan beyond Table I, of the shape of what was seen and of the ranges.

A finer distance histogram, the smooth pieces of what was seen, and the ranges cut at several
lengths tell rooms apart on a new path (`GROUPS`). Quantiles, rings and harmonics of the ranges
describe one view closely, so they help most where the robot has been before (`PROFILE_GROUPS`). As
in `table1`, all are finite, and unchanged when the robot turns on the spot.

A histogram of oriented point pairs of the boundary recognises a room best (`PAIR_GROUPS`), in the
spirit of the features of Drost et al. (2010). The boundary is resampled by arc length, so that near
and far walls count alike, and each point gets the normal that points to the robot.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import BoolArray, IntArray
from specmap_cli.recognition.features.group import BatchGroup
from specmap_cli.recognition.features.returns import ReturnsBatch, Segments, pair_shares
from specmap_cli.recognition.features.table1 import distance_histogram

# These define features: classifiers on disk hold thresholds on what comes of them.
FINE_EDGES_M = tuple(round(0.2 * k, 1) for k in range(1, 30))
CLIPS_M = (1.0, 2.0, 3.0, 5.0, 8.0)
_BREAK_M, _BREAK_PER_M = 0.25, 0.03  # neighbouring beams lie this far apart on a slanted wall
_LONG_PIECES_M = (0.5, 1.0, 2.0)
QUANTILES = (0.05, 0.15, 0.25, 0.35, 0.5, 0.65, 0.75, 0.85, 0.95)
RING_EDGES_M = (0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 8.0, 12.0)
HARMONICS = 16
_SAMPLES = 128
_FARTHEST_M = 12.0


def breaks_of(batch: ReturnsBatch) -> BoolArray:
    """(N,) whether the step from a return to the next one leaps from one surface to another.

    The last return of a scan has no step.
    """
    following = batch.ranges[batch.segments.following]
    return leaps(batch.onward, batch.ranges, following) & ~batch.segments.last


def leaps(steps: FloatArray, here: FloatArray, there: FloatArray) -> BoolArray:
    """(N,) whether steps (N,) between returns at ranges `here` and `there` (N,) leave a surface.

    Those do that are longer than 0.25 m and 3 % of the nearer range together.
    """
    return np.asarray(steps > _BREAK_M + _BREAK_PER_M * np.minimum(here, there))


def travelled_along(batch: ReturnsBatch, left_out: BoolArray) -> FloatArray:
    """(N,) metres from the first return of each scan on, along the steps but those `left_out`."""
    steps = np.where(batch.segments.last | left_out, 0.0, batch.onward)
    before = np.concatenate([np.zeros(min(1, len(steps))), steps[:-1]])
    return batch.segments.cumsum(before)


def pieces_between(segments: Segments, breaks: BoolArray) -> tuple[IntArray, IntArray]:
    """The first and the last return (p,) of every smooth piece between breaks (N,), in order."""
    ends = breaks | segments.last
    starts = np.concatenate([np.ones(min(1, len(ends)), dtype=np.bool_), ends[:-1]])
    return np.flatnonzero(starts), np.flatnonzero(ends)


def pieces(batch: ReturnsBatch) -> FloatArray:
    """Smooth pieces between leaps: how many there are, how many are longer than each of 0.5, 1 and
    2 m, the longest one's length and the mean length.
    """
    segments, breaks = batch.segments, breaks_of(batch)
    travelled = travelled_along(batch, np.zeros_like(breaks))
    starts, ends = pieces_between(segments, breaks)
    lengths = travelled[ends] - travelled[starts]
    own = Segments.of_counts(np.bincount(segments.owner[starts], minlength=len(batch)))
    longer = own.sum(lengths > np.array(_LONG_PIECES_M)[:, None])
    values = np.column_stack([own.counts, *longer, own.max(lengths), own.mean(lengths)])
    return np.where(batch.counts[:, None] >= 2, values, 0.0)


def clipped_ranges(batch: ReturnsBatch) -> FloatArray:
    """For each of `CLIPS_M`: the share of beams below it, mean and deviation of the cut ranges."""
    segments = batch.segments
    clips = np.array(CLIPS_M)[:, None]
    cut = np.minimum(batch.ranges, clips)
    mean = segments.mean(cut)
    variance = np.maximum(0.0, segments.mean(cut * cut) - mean * mean)
    values = np.stack([segments.mean(batch.ranges < clips), mean, np.sqrt(variance)])
    return np.asarray(values.transpose(2, 1, 0).reshape(len(batch), -1))


fine_distance_histogram = partial(distance_histogram, edges_m=FINE_EDGES_M)
_FINE_COLUMNS = tuple(f"fine_distance_{low:g}m" for low in (0.0, *FINE_EDGES_M))

GROUPS: tuple[BatchGroup, ...] = (
    BatchGroup(fine_distance_histogram, _FINE_COLUMNS, histogram=_FINE_COLUMNS),
    BatchGroup(
        pieces,
        ("pieces", *(f"pieces_over_{t:g}m" for t in _LONG_PIECES_M), "piece_max", "piece_mean"),
    ),
    BatchGroup(
        clipped_ranges,
        tuple(
            f"{kind}_{clip:g}m"
            for clip in CLIPS_M
            for kind in ("share_below", "clipped_mean", "clipped_std")
        ),
    ),
)


def range_quantiles(batch: ReturnsBatch) -> FloatArray:
    """Quantiles of the ranges."""
    ordered = np.sort(batch.segments.padded(batch.ranges, np.inf, width=1), axis=1)
    ordered[batch.counts == 0] = 0.0
    last = np.maximum(batch.counts - 1, 0)[:, None]
    at = np.asarray(QUANTILES) * last
    below = at.astype(np.intp)
    low = np.take_along_axis(ordered, below, axis=1)
    high = np.take_along_axis(ordered, np.minimum(below + 1, last), axis=1)
    return np.asarray((high - low) * (at - below) + low)


def ring_histogram(batch: ReturnsBatch) -> FloatArray:
    """Shares of the returns in rings about the robot, the last one open."""
    rings = len(RING_EDGES_M) + 1
    ring = np.searchsorted(RING_EDGES_M, batch.ranges, side="right") + rings * batch.segments.owner
    counts = np.bincount(ring, minlength=rings * len(batch)).reshape(len(batch), rings)
    return counts / np.maximum(1, batch.counts)[:, None]


def harmonics(batch: ReturnsBatch) -> FloatArray:
    """Magnitudes of the harmonics of the ranges, cut at 12 m, over the returns' bearings.

    A turn of a full circle shifts the signal, which the magnitudes do not see.
    """
    segments, bearings = batch.segments, batch.bearings
    # without leaps of more than half a turn within a scan
    change = np.concatenate([np.zeros(min(1, len(bearings))), np.diff(bearings)])
    leap = (np.abs(change) >= np.pi) & (segments.place > 0)
    if leap.any():
        turns = np.zeros(len(bearings))
        turns[leap] = np.mod(change[leap] + np.pi, 2.0 * np.pi) - np.pi - change[leap]
        bearings = bearings + segments.cumsum(turns)
    ranges = np.minimum(batch.ranges, _FARTHEST_M)
    values = np.zeros((len(batch), HARMONICS))
    scans = np.flatnonzero(batch.counts >= 2)
    rows = np.zeros((len(scans), _SAMPLES))  # ranges at even bearings
    for row, scan in zip(rows, scans.tolist(), strict=True):
        start, end = segments.starts[scan : scan + 2].tolist()
        b, r = bearings[start:end], ranges[start:end]
        if batch.closed[scan]:
            places = b[0] + 2.0 * np.pi / _SAMPLES * np.arange(_SAMPLES)
            b, r = np.append(b, b[0] + 2.0 * np.pi), np.append(r, r[0])
        else:
            places = np.linspace(b[0], b[-1], _SAMPLES)
        row[:] = np.interp(places, b, r)
    values[scans] = np.abs(np.fft.rfft(rows, axis=1))[:, 1 : HARMONICS + 1] / _SAMPLES
    return values


# the rings are a histogram of one view, not of the place: it is not the one to know places by
PROFILE_GROUPS: tuple[BatchGroup, ...] = (
    BatchGroup(range_quantiles, tuple(f"range_quantile_{q:g}" for q in QUANTILES)),
    BatchGroup(ring_histogram, tuple(f"ring_{low:g}m" for low in (0.0, *RING_EDGES_M))),
    BatchGroup(harmonics, tuple(f"harmonic_{k}" for k in range(1, HARMONICS + 1))),
)


# These define features, too.
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
    """The bins of pairs of points with x, y and normal (4, ...) each; `_OF_NONE` for NaN."""
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


PAIR_GROUPS: tuple[BatchGroup, ...] = (
    BatchGroup(
        point_pair_histogram,
        (*PAIR_COLUMNS, "boundary_length", "boundary_points"),
        histogram=PAIR_COLUMNS,
    ),
)
