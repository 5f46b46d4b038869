"""Features of the ranges as a function of the bearing: what tells near-by places apart.

They describe one view closely, so they help most where the robot has been before. As in `table1`,
all are finite, and unchanged when the robot turns on the spot.
"""

from __future__ import annotations

import numpy as np

from specmap_cli.core.geometry import FloatArray
from specmap_cli.recognition.features.group import FeatureGroup
from specmap_cli.recognition.features.returns import Returns

# These define features: classifiers on disk hold thresholds on what comes of them.
QUANTILES = (0.05, 0.15, 0.25, 0.35, 0.5, 0.65, 0.75, 0.85, 0.95)
RING_EDGES_M = (0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 8.0, 12.0)
HARMONICS = 16
_SAMPLES = 128
_FARTHEST_M = 12.0


def range_quantiles(returns: Returns) -> list[float]:
    """Quantiles of the ranges."""
    if not len(returns):
        return [0.0] * len(QUANTILES)
    ordered = np.sort(returns.ranges)
    at = np.asarray(QUANTILES) * (len(ordered) - 1)
    return list(np.interp(at, np.arange(len(ordered)), ordered).tolist())


def ring_histogram(returns: Returns) -> list[float]:
    """Shares of the returns in rings about the robot, the last one open."""
    if not len(returns):
        return [0.0] * (len(RING_EDGES_M) + 1)
    counts = np.bincount(
        np.searchsorted(RING_EDGES_M, returns.ranges, side="right"),
        minlength=len(RING_EDGES_M) + 1,
    )
    return list((counts / len(returns)).tolist())


def harmonics(returns: Returns) -> list[float]:
    """Magnitudes of the harmonics of the ranges, cut at 12 m, over the returns' bearings.

    A turn of a full circle shifts the signal, which the magnitudes do not see.
    """
    if len(returns) < 2:
        return [0.0] * HARMONICS
    signal = _resampled(returns)
    return list((np.abs(np.fft.rfft(signal))[1 : HARMONICS + 1] / _SAMPLES).tolist())


def _resampled(returns: Returns) -> FloatArray:
    """(128,) ranges at even bearings, cut at 12 m, around the circle when it is one."""
    bearings = np.unwrap(returns.bearings)
    ranges = np.minimum(returns.ranges, _FARTHEST_M)
    if returns.closed:
        places = bearings[0] + 2.0 * np.pi / _SAMPLES * np.arange(_SAMPLES)
        bearings = np.append(bearings, bearings[0] + 2.0 * np.pi)
        ranges = np.append(ranges, ranges[0])
    else:
        places = np.linspace(bearings[0], bearings[-1], _SAMPLES)
    return np.asarray(np.interp(places, bearings, ranges), dtype=np.float64)


# the rings are a histogram of one view, not of the place: it is not the one to know places by
GROUPS: tuple[FeatureGroup, ...] = (
    FeatureGroup(range_quantiles, tuple(f"range_quantile_{q:g}" for q in QUANTILES)),
    FeatureGroup(ring_histogram, tuple(f"ring_{low:g}m" for low in (0.0, *RING_EDGES_M))),
    FeatureGroup(harmonics, tuple(f"harmonic_{k}" for k in range(1, HARMONICS + 1))),
)
