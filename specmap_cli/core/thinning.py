"""Points thinned to one in each cell of a grid."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray


def first_in_cells(points: FloatArray, cell_m: float) -> NDArray[np.intp]:
    """Which of points (N, 2) or (N, 3) is the first in its cell of side `cell_m`, in order."""
    if len(points) < 2:
        return np.arange(len(points))
    cells = np.floor(points / cell_m).astype(np.int64)
    cells -= cells.min(axis=0)
    key = np.ravel_multi_index(tuple(cells.T), tuple(cells.max(axis=0) + 1))
    _, first = np.unique(key, return_index=True)
    return np.sort(first)
