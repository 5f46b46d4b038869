"""Points thinned to one in each cell of a grid."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray


def first_in_cells(points: FloatArray, cell_m: float) -> NDArray[np.intp]:
    """Which of points (N, 2) or (N, 3) is the first in its cell of side `cell_m`, in order."""
    if len(points) < 2:
        return np.arange(len(points))
    columns, *others = np.floor(points.T / cell_m).astype(np.int64)
    key = columns - int(columns.min())
    for cells in others:
        low, high = int(cells.min()), int(cells.max())
        key = key * (high - low + 1) + (cells - low)
    order = key.argsort(kind="stable")
    ordered, fresh = key[order], np.ones(len(key), dtype=bool)
    np.not_equal(ordered[1:], ordered[:-1], out=fresh[1:])
    return np.sort(order[fresh])
