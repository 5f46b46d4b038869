"""Thinning dense scans to a bounded number of points."""

from __future__ import annotations

from specmap_cli.core.geometry import FloatArray
from specmap_cli.grids.matching import thinned


def thinned_to(points: FloatArray, cell_m: float, count: int) -> FloatArray:
    """Thinned at `cell_m`, and at twice the cell again and again until `count` are enough."""
    kept = thinned(points, cell_m)
    while len(kept) > count:
        cell_m *= 1.4
        kept = thinned(points, cell_m)
    return kept
