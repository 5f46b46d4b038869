"""Thinning point sets to one point a cell."""

from __future__ import annotations

import numpy as np

from specmap_cli.geometry import FloatArray


def thinned(points: FloatArray, cell_m: float) -> FloatArray:
    """The first point (of (N, 2) or (N, 3)) in each cell of a grid of side `cell_m`, in order."""
    if len(points) < 2:
        return points
    cells = np.floor(points / cell_m).astype(np.int64)
    cells -= cells.min(axis=0)
    key = np.ravel_multi_index(tuple(cells.T), tuple(cells.max(axis=0) + 1))
    _, first = np.unique(key, return_index=True)
    return points[np.sort(first)]


def thinned_to(points: FloatArray, cell_m: float, count: int) -> FloatArray:
    """Thinned at `cell_m`, and at twice the cell again and again until `count` are enough."""
    kept = thinned(points, cell_m)
    while len(kept) > count:
        cell_m *= 1.4
        kept = thinned(points, cell_m)
    return kept
