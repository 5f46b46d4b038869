"""Features of the ranges as a function of the bearing: what tells near-by places apart.

They describe one view closely, so they help most where the robot has been before. As in `table1`,
all are finite, and unchanged when the robot turns on the spot.
"""

from __future__ import annotations

import numpy as np

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import IntArray
from specmap_cli.recognition.features.group import BatchGroup
from specmap_cli.recognition.features.returns import ReturnsBatch

# These define features: classifiers on disk hold thresholds on what comes of them.
QUANTILES = (0.05, 0.15, 0.25, 0.35, 0.5, 0.65, 0.75, 0.85, 0.95)
RING_EDGES_M = (0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 8.0, 12.0)
HARMONICS = 16
_SAMPLES = 128
_FARTHEST_M = 12.0


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
    some = batch.counts >= 2
    values = np.zeros((len(batch), HARMONICS))
    spectrum = np.fft.rfft(_resampled(batch, np.flatnonzero(some)), axis=1)
    values[some] = np.abs(spectrum)[:, 1 : HARMONICS + 1] / _SAMPLES
    return values


def _resampled(batch: ReturnsBatch, scans: IntArray) -> FloatArray:
    """(m, 128) ranges of some scans at even bearings, cut at 12 m, around where they are circles.

    Each has two returns at the least.
    """
    bearings = _unwrapped(batch)
    ranges = np.minimum(batch.ranges, _FARTHEST_M)
    rows = np.zeros((len(scans), _SAMPLES))
    for row, scan in zip(rows, scans.tolist(), strict=True):
        start, end = batch.segments.starts[scan : scan + 2].tolist()
        b, r = bearings[start:end], ranges[start:end]
        if batch.closed[scan]:
            places = b[0] + 2.0 * np.pi / _SAMPLES * np.arange(_SAMPLES)
            b, r = np.append(b, b[0] + 2.0 * np.pi), np.append(r, r[0])
        else:
            places = np.linspace(b[0], b[-1], _SAMPLES)
        row[:] = np.interp(places, b, r)
    return rows


def _unwrapped(batch: ReturnsBatch) -> FloatArray:
    """(N,) bearings without leaps of more than half a turn within a scan."""
    segments, b = batch.segments, batch.bearings
    change = np.concatenate([np.zeros(min(1, len(b))), np.diff(b)])
    leaps = (np.abs(change) >= np.pi) & (segments.place > 0)
    if not leaps.any():
        return b
    turns = np.zeros(len(b))
    turns[leaps] = np.mod(change[leaps] + np.pi, 2.0 * np.pi) - np.pi - change[leaps]
    return b + segments.cumsum(turns)


# the rings are a histogram of one view, not of the place: it is not the one to know places by
GROUPS: tuple[BatchGroup, ...] = (
    BatchGroup(range_quantiles, tuple(f"range_quantile_{q:g}" for q in QUANTILES)),
    BatchGroup(ring_histogram, tuple(f"ring_{low:g}m" for low in (0.0, *RING_EDGES_M))),
    BatchGroup(harmonics, tuple(f"harmonic_{k}" for k in range(1, HARMONICS + 1))),
)
