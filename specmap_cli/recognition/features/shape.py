"""Features of one scan beyond Table I that tell rooms apart on a new path.

A finer distance histogram, the smooth pieces of what was seen, and the ranges cut at several
lengths. As in `table1`, all are finite, and unchanged when the robot turns on the spot.
"""

from __future__ import annotations

import math

import numpy as np

from specmap_cli.core.geometry import FloatArray
from specmap_cli.recognition.features.group import FeatureGroup
from specmap_cli.recognition.features.returns import Returns
from specmap_cli.recognition.features.table1 import pair_histogram

# These define features: classifiers on disk hold thresholds on what comes of them.
FINE_EDGES_M = tuple(round(0.2 * k, 1) for k in range(1, 30))
CLIPS_M = (1.0, 2.0, 3.0, 5.0, 8.0)
_BREAK_M, _BREAK_PER_M = 0.25, 0.03  # neighbouring beams lie this far apart on a slanted wall
_LONG_PIECES_M = (0.5, 1.0, 2.0)


def breaks_of(returns: Returns) -> FloatArray:
    """Numbers k of the steps, from return k to k + 1, that leap from one surface to another.

    A step leaps when it is longer than 0.25 m and 3 % of the nearer range together.
    """
    nearer = np.minimum(returns.ranges[1:], returns.ranges[:-1])
    return np.asarray(np.flatnonzero(returns.steps > _BREAK_M + _BREAK_PER_M * nearer))


def fine_distance_histogram(returns: Returns) -> list[float]:
    """Distribution of the distance between two returns in bins of 0.2 m, the last one open."""
    if len(returns) < 2:
        return [0.0] * (len(FINE_EDGES_M) + 1)
    return list(pair_histogram(returns, FINE_EDGES_M).tolist())


def pieces(returns: Returns) -> list[float]:
    """Smooth pieces between leaps: how many there are, how many are longer than each of 0.5, 1 and
    2 m, the longest one's length and the mean length.
    """
    if len(returns) < 2:
        return [0.0] * (len(_LONG_PIECES_M) + 3)
    travelled = np.concatenate([[0.0], np.cumsum(returns.steps)])
    cuts = breaks_of(returns).astype(np.intp)
    starts = np.concatenate([[0], cuts + 1])
    ends = np.concatenate([cuts, [len(returns) - 1]])
    lengths = travelled[ends] - travelled[starts]
    longer = [float(np.count_nonzero(lengths > limit)) for limit in _LONG_PIECES_M]
    return [float(len(lengths)), *longer, float(lengths.max()), float(lengths.mean())]


def clipped_ranges(returns: Returns) -> list[float]:
    """For each of `CLIPS_M`: the share of beams below it, mean and deviation of the cut ranges."""
    if not len(returns):
        return [0.0] * (3 * len(CLIPS_M))
    values: list[float] = []
    for clip in CLIPS_M:
        cut = np.minimum(returns.ranges, clip)
        mean = float(cut.mean())
        variance = max(0.0, float((cut * cut).mean()) - mean * mean)
        below = float(np.count_nonzero(returns.ranges < clip)) / len(cut)
        values += [below, mean, math.sqrt(variance)]
    return values


_FINE_COLUMNS = tuple(f"fine_distance_{low:g}m" for low in (0.0, *FINE_EDGES_M))

GROUPS: tuple[FeatureGroup, ...] = (
    FeatureGroup(fine_distance_histogram, _FINE_COLUMNS, histogram=_FINE_COLUMNS),
    FeatureGroup(
        pieces,
        ("pieces", *(f"pieces_over_{t:g}m" for t in _LONG_PIECES_M), "piece_max", "piece_mean"),
    ),
    FeatureGroup(
        clipped_ranges,
        tuple(
            f"{kind}_{clip:g}m"
            for clip in CLIPS_M
            for kind in ("share_below", "clipped_mean", "clipped_std")
        ),
    ),
)
