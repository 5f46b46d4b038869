"""Features of one scan beyond Table I that tell rooms apart on a new path.

A finer distance histogram, the smooth pieces of the outline, and the ranges cut at several
lengths. As in `features_table1`, all are finite, and unchanged when the robot turns on the spot.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from specmap_cli.core.geometry import FloatArray
from specmap_cli.recognition.features.returns import Outline
from specmap_cli.recognition.features.table1 import pair_histogram

FINE_EDGES_M = tuple(round(0.2 * k, 1) for k in range(1, 30))
CLIPS_M = (1.0, 2.0, 3.0, 5.0, 8.0)
_BREAK_M, _BREAK_PER_M = 0.25, 0.03
_LONG_PIECES_M = (0.5, 1.0, 2.0)


def breaks_of(outline: Outline) -> FloatArray:
    """Numbers k of the steps, from return k to k + 1, that leap from one surface to another.

    A step leaps when it is longer than 0.25 m and 3 % of the nearer range together.
    """
    nearer = np.minimum(outline.ranges[1:], outline.ranges[:-1])
    return np.asarray(np.flatnonzero(outline.steps > _BREAK_M + _BREAK_PER_M * nearer))


def fine_distance_histogram(outline: Outline) -> list[float]:
    """Distribution of the distance between two returns in bins of 0.2 m, the last one open."""
    if len(outline) < 2:
        return [0.0] * (len(FINE_EDGES_M) + 1)
    return list(pair_histogram(outline, FINE_EDGES_M).tolist())


def pieces(outline: Outline) -> list[float]:
    """Smooth pieces of the outline: how many, how many longer than each of 0.5, 1 and 2 m, the
    longest one's length and the mean length.
    """
    if len(outline) < 2:
        return [0.0] * (len(_LONG_PIECES_M) + 3)
    travelled = np.concatenate([[0.0], np.cumsum(outline.steps)])
    cuts = breaks_of(outline).astype(np.intp)
    starts = np.concatenate([[0], cuts + 1])
    ends = np.concatenate([cuts, [len(outline) - 1]])
    lengths = travelled[ends] - travelled[starts]
    longer = [float(np.count_nonzero(lengths > limit)) for limit in _LONG_PIECES_M]
    return [float(len(lengths)), *longer, float(lengths.max()), float(lengths.mean())]


def clipped_ranges(outline: Outline) -> list[float]:
    """For each of `CLIPS_M`: the share of beams below it, mean and deviation of the cut ranges."""
    if not len(outline):
        return [0.0] * (3 * len(CLIPS_M))
    values: list[float] = []
    for clip in CLIPS_M:
        cut = np.minimum(outline.ranges, clip)
        mean = float(cut.mean())
        variance = max(0.0, float(cut @ cut) / len(cut) - mean * mean)
        below = float(np.count_nonzero(outline.ranges < clip)) / len(cut)
        values += [below, mean, math.sqrt(variance)]
    return values


GROUPS: tuple[tuple[Callable[[Outline], list[float]], tuple[str, ...]], ...] = (
    (
        fine_distance_histogram,
        tuple(f"fine_distance_{low:g}m" for low in (0.0, *FINE_EDGES_M)),
    ),
    (
        pieces,
        ("pieces", *(f"pieces_over_{t:g}m" for t in _LONG_PIECES_M), "piece_max", "piece_mean"),
    ),
    (
        clipped_ranges,
        tuple(
            f"{kind}_{clip:g}m"
            for clip in CLIPS_M
            for kind in ("share_below", "clipped_mean", "clipped_std")
        ),
    ),
)
