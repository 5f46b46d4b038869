"""Cells of a grid as outlines: what a picture of a map is made of."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import BoolArray, IntArray
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.report.frame import Frame

_TOLERANCE = 1.2  # of a simplified outline, half cells: the stairs of a slanted wall are gone


def traced(cells: BoolArray, grid: GridMap, frame: Frame) -> list[IntArray]:
    """`outlines` in the drawing, centimetres."""
    return [frame.places(ring) for ring in outlines(cells, grid)]


def outlines(cells: BoolArray, grid: GridMap) -> list[FloatArray]:
    """Outlines and holes of `cells` (H, W) of a grid as rings (n, 2), metres.

    They run a quarter of a cell inside: drawn with a pen half a cell wide they have their size.
    """
    if not cells.any():
        return []
    rows, columns = (np.flatnonzero(cells.any(axis=axis)) for axis in (1, 0))
    low, left = int(rows[0]), int(columns[0])
    part = cells[low : rows[-1] + 1, left : columns[-1] + 1]
    doubled = cv2.resize(
        part.astype(np.uint8), None, fx=2.0, fy=2.0, interpolation=cv2.INTER_NEAREST
    )
    rings, _ = cv2.findContours(doubled, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    halves = [_simplified(np.asarray(ring)) + 0.5 for ring in rings]
    return [(ring / 2.0 + (left, low)) * grid.resolution + grid.origin for ring in halves]


def _simplified(ring: NDArray[Any]) -> FloatArray:
    """A contour of OpenCV with fewer points (n, 2); one thinner than the tolerance as it is."""
    simple = cv2.approxPolyDP(ring, _TOLERANCE, True) if len(ring) > 4 else ring
    kept = simple if len(simple) > 2 else ring
    return np.asarray(kept.reshape(-1, 2), dtype=np.float64)


def simplified(line: IntArray, tolerance: float) -> IntArray:
    """A polyline (n, 2) in the drawing without the points that stray less than the tolerance."""
    if len(line) < 3:
        return line
    kept = cv2.approxPolyDP(line.astype(np.int32)[:, None], tolerance, False)
    return np.asarray(kept.reshape(-1, 2), dtype=np.int64)
