"""The pieces of a trajectory that are drawn as one line."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.arrays import runs
from specmap_cli.core.geometry import FloatArray, step_lengths
from specmap_cli.core.records import IntArray

# A longer step from scan to scan is no way driven: the robot was lost and turned up elsewhere.
# Logs with few scans have long steps throughout, so a jump is longer than nearly all of them, too.
_JUMP_M = 1.5
_USUAL_STEPS, _USUAL_PERCENTILE = 3.0, 90.0


class Stroke(NamedTuple):
    """Scans first..end - 1 share one label; their line is drawn up to scan drawn_to - 1."""

    first: int
    end: int
    drawn_to: int


def strokes(places: FloatArray, labels: NDArray[Any] | None = None) -> list[Stroke]:
    """Runs of one of the `labels` (n,) along `places` (n, 2), broken where the robot jumps.

    The line of a stroke reaches the first place of the next one, unless the robot jumped there.
    Without labels only jumps break the line.
    """
    values = np.zeros(len(places), dtype=np.int64) if labels is None else np.asarray(labels)
    return [
        Stroke(first + start, first + stop, min(first + stop + 1, end))
        for first, end in runs(_passages(places))
        for start, stop in runs(values[first:end])
    ]


def _passages(places: FloatArray) -> IntArray:
    """(n,) the number 0, 1, ... of the way without a jump that each place lies on."""
    steps = step_lengths(places)
    if not len(steps):
        return np.zeros(len(places), dtype=np.int64)
    usual = float(np.percentile(steps, _USUAL_PERCENTILE))
    jumps = steps > max(_JUMP_M, _USUAL_STEPS * usual)
    return np.concatenate([[0], np.cumsum(jumps)]).astype(np.int64)
