"""Every pair of many points at once, without a list of pairs."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

_FEWEST = 3  # places that have one to follow


def pair_windows(values: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """First (..., 1, w) and second (..., (w - 1) / 2, w) of all pairs in values (..., n).

    Around a circle of an odd number w of places each pair has one that comes at most (w - 1) / 2
    places after the other. What `values` lack to that are NaN. Both are views.
    """
    width = max(_FEWEST, values.shape[-1] | 1)
    half = width // 2
    around = np.full((*values.shape[:-1], width + half), np.nan)
    around[..., : values.shape[-1]] = values
    around[..., width:] = around[..., :half]
    return around[..., None, :width], sliding_window_view(around[..., 1:], width, axis=-1)
