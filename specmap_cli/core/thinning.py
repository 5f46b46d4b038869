"""Points thinned to one in each cell of a grid."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray

_EXACT_BITS = 53  # of whole numbers in float64
_SORTED_BITS = 63  # of whole numbers in int64


def first_in_cells(points: FloatArray, cell_m: float) -> NDArray[np.intp]:
    """Which of points (N, 2) or (N, 3) is the first in its cell of side `cell_m`, in order."""
    count = len(points)
    if count < 2:
        return np.arange(count)
    columns = [np.floor(points[:, axis] / cell_m) for axis in range(points.shape[1])]
    lowest = [float(column.min()) for column in columns]
    widths = [int(column.max() - low) + 1 for column, low in zip(columns, lowest, strict=True)]
    size, bits = math.prod(widths).bit_length(), count.bit_length()
    if size > _EXACT_BITS or size + bits > _SORTED_BITS:  # kilometres away, in tiny cells
        _, first = np.unique(np.column_stack(columns), axis=0, return_index=True)
        return np.sort(first)
    cells = np.zeros(count)
    for column, low, width in zip(columns, lowest, widths, strict=True):
        cells *= width
        cells += column - low
    # number of cell and of point in one: sorting them is much quicker than sorting an index
    both = (cells.astype(np.int64) << bits) | np.arange(count)
    both.sort()
    cell = both >> bits
    new = np.concatenate([[True], cell[1:] != cell[:-1]])
    return np.sort(both[new] & ((1 << bits) - 1))
