"""Fronts that spread through free cells from where they start, and fences that they do not cross.

A front crosses a wall or a fence only when nothing else is left.
"""

from __future__ import annotations

from collections.abc import Iterable

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.grids.gridmap import BoolArray, GridMap, slices_near
from specmap_cli.topology.borders import Line

_CROSS = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
_CELL = 0.7072  # of the side of a cell: from its centre to its corner, and no less


def flood(
    passable: BoolArray, markers: NDArray[np.int32], fences: BoolArray | None = None
) -> NDArray[np.int32]:
    """(H, W) the marker that reaches each cell first.

    The watershed grows all markers a ring at a time over equal cells, and crosses an edge of the
    picture only when nothing else is left. It leaves lines one cell wide where fronts meet.
    """
    entered = passable if fences is None else passable & ~fences
    picture = np.pad(np.where(entered, np.uint8(0), np.uint8(255)), 1, constant_values=255)
    flooded = cv2.watershed(cv2.merge([picture] * 3), np.pad(markers, 1))
    closed = cv2.dilate(flooded.astype(np.float32), _CROSS)  # ids are exact in single precision
    fronts = (flooded < 0) & np.pad(passable, 1)
    return np.where(fronts, closed, flooded).astype(np.int32)[1:-1, 1:-1]


def drawn(fences: Iterable[Line], grid: GridMap) -> BoolArray:
    """(H, W) the cells that fences go through: no way from cell to next cell leads between them."""
    cells = np.zeros(grid.cells.shape, dtype=np.bool_)
    reach = _CELL * grid.resolution
    for fence in fences:
        ends = np.array(fence)
        rows, columns = slices_near(ends, 2.0 * reach, grid.origin, grid.resolution, cells.shape)
        window = np.mgrid[rows, columns].reshape(2, -1).T
        along, across, length = beside(grid.centres_of(window), fence)
        on = (np.abs(across) <= reach) & (along >= -reach) & (along <= length + reach)
        cells[tuple(window[on].T)] = True
    return cells


def beside(places: FloatArray, line: Line) -> tuple[FloatArray, FloatArray, float]:
    """How far along a line each place (n, 2) is, and how far left of it; the line's length."""
    start, end = np.array(line[0]), np.array(line[1])
    length = float(np.hypot(*(end - start)))
    x, y = ((end - start) / length).tolist()
    away = places - start
    return away[:, 0] * x + away[:, 1] * y, away[:, 1] * x - away[:, 0] * y, length
