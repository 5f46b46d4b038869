"""Features of the ranges as a function of the bearing: what tells near-by places apart.

They describe one view closely, so they help most where the robot has been before. As in
`features_table1`, all are finite, and unchanged when the robot turns on the spot.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from specmap_cli.core.geometry import FloatArray
from specmap_cli.recognition.features.returns import Outline

QUANTILES = (0.05, 0.15, 0.25, 0.35, 0.5, 0.65, 0.75, 0.85, 0.95)
RING_EDGES_M = (0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 8.0, 12.0)
HARMONICS = 16
_SAMPLES = 128
_FARTHEST_M = 12.0


def range_quantiles(outline: Outline) -> list[float]:
    """Quantiles of the ranges."""
    if not len(outline):
        return [0.0] * len(QUANTILES)
    ordered = np.sort(outline.ranges)
    at = np.asarray(QUANTILES) * (len(ordered) - 1)
    return list(np.interp(at, np.arange(len(ordered)), ordered).tolist())


def ring_histogram(outline: Outline) -> list[float]:
    """Shares of the returns in rings about the robot, the last one open."""
    if not len(outline):
        return [0.0] * (len(RING_EDGES_M) + 1)
    counts = np.bincount(
        np.searchsorted(RING_EDGES_M, outline.ranges, side="right"),
        minlength=len(RING_EDGES_M) + 1,
    )
    return list((counts / len(outline)).tolist())


def harmonics(outline: Outline) -> list[float]:
    """Magnitudes of the harmonics of the ranges, cut at 12 m, over the returns' bearings.

    A turn of a full circle shifts the signal, which the magnitudes do not see.
    """
    if len(outline) < 2:
        return [0.0] * HARMONICS
    signal = _resampled(outline)
    return list((np.abs(np.fft.rfft(signal))[1 : HARMONICS + 1] / _SAMPLES).tolist())


def _resampled(outline: Outline) -> FloatArray:
    """(128,) ranges at even bearings, cut at 12 m, around the circle when it is one."""
    bearings = np.unwrap(outline.bearings)
    ranges = np.minimum(outline.ranges, _FARTHEST_M)
    if outline.closed:
        places = bearings[0] + 2.0 * np.pi / _SAMPLES * np.arange(_SAMPLES)
        bearings = np.append(bearings, bearings[0] + 2.0 * np.pi)
        ranges = np.append(ranges, ranges[0])
    else:
        places = np.linspace(bearings[0], bearings[-1], _SAMPLES)
    return np.asarray(np.interp(places, bearings, ranges), dtype=np.float64)


GROUPS: tuple[tuple[Callable[[Outline], list[float]], tuple[str, ...]], ...] = (
    (range_quantiles, tuple(f"range_quantile_{q:g}" for q in QUANTILES)),
    (ring_histogram, tuple(f"ring_{low:g}m" for low in (0.0, *RING_EDGES_M))),
    (harmonics, tuple(f"harmonic_{k}" for k in range(1, HARMONICS + 1))),
)
