"""Features of one scan beyond Table I, of the shape of what was seen and of the ranges.

A finer distance histogram, the smooth pieces of what was seen, and the ranges cut at several
lengths tell rooms apart on a new path (`GROUPS`). Quantiles, rings and harmonics of the ranges
describe one view closely, so they help most where the robot has been before (`PROFILE_GROUPS`). As
in `table1`, all are finite, and unchanged when the robot turns on the spot.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import BoolArray, IntArray
from specmap_cli.recognition.features.group import BatchGroup
from specmap_cli.recognition.features.returns import ReturnsBatch, Segments
from specmap_cli.recognition.features.table1 import distance_histogram

# These define features: classifiers on disk hold thresholds on what comes of them.
FINE_EDGES_M = tuple(round(0.2 * k, 1) for k in range(1, 30))
CLIPS_M = (1.0, 2.0, 3.0, 5.0, 8.0)
_BREAK_M, _BREAK_PER_M = 0.25, 0.03  # neighbouring beams lie this far apart on a slanted wall
_LONG_PIECES_M = (0.5, 1.0, 2.0)
# These define features: classifiers on disk hold thresholds on what comes of them.
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
    BatchGroup(fine_distance_histogram, _FINE_COLUMNS),
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


PROFILE_GROUPS: tuple[BatchGroup, ...] = (
    BatchGroup(range_quantiles, tuple(f"range_quantile_{q:g}" for q in QUANTILES)),
    BatchGroup(ring_histogram, tuple(f"ring_{low:g}m" for low in (0.0, *RING_EDGES_M))),
    BatchGroup(harmonics, tuple(f"harmonic_{k}" for k in range(1, HARMONICS + 1))),
)
