"""What a submap is by its shape: a corridor, a hall, or a room.

The measure is the mean width: the distance to the nearest border is measured at every point of the
submap, and the mean width is four times the mean of these distances. For a long strip, straight or
bent, it is the width of the strip; for a square it is two thirds of its side.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.topology.topological_map import SubmapKind

_CELL_M, _MOST_CELLS = 0.1, 1000  # along the longer side; larger shapes are drawn in larger cells
# Gaps narrower than a door lie between pieces of furniture: they are filled, from both sides.
_GAP_M = 0.8
# A hall is wider than a corridor is made, and larger than a room for thirty people.
_HALL_WIDTH_M, _HALL_M2 = 4.0, 60.0
# Area by squared mean width of a rectangle four times as long as it is wide: 4 / (1 - 1/12) ** 2.
_LONG = 576.0 / 121.0


def kind_of(polygon: FloatArray) -> SubmapKind | None:
    """The kind of a region with this border (N, 2), metres; None for one without any width.

    A hall has 60 square metres and a mean width of 4 m, or more. Of other shapes, those are
    corridors that are long for their width, as a rectangle of 4 by 1 is.
    """
    if len(polygon) < 3:
        return None
    area, width = _area_and_width(polygon)
    if not width:
        return None
    if area >= _HALL_M2 and width >= _HALL_WIDTH_M:
        return "hall"
    return "corridor" if area >= _LONG * width**2 else "room"


def _area_and_width(polygon: FloatArray) -> tuple[float, float]:
    """Square metres, and the mean width in metres."""
    cell, shape = _drawn(polygon)
    away = cv2.distanceTransform(shape, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[shape > 0]
    away = away.astype(np.float64) - 1.0  # the border runs through the outermost cells
    cells = len(away) - 0.5 * np.count_nonzero(away <= 0.0)  # which lie half outside
    return cells * cell**2, 4.0 * cell * float(away.sum()) / cells


def _drawn(polygon: FloatArray) -> tuple[float, NDArray[np.uint8]]:
    """The side of a cell, and the region in cells, its narrow gaps filled."""
    low, sides = polygon.min(axis=0), np.ptp(polygon, axis=0)
    cell = max(_CELL_M, float(sides.max()) / _MOST_CELLS)
    reach = round(_GAP_M / 2.0 / cell)
    margin = reach + 1
    width, height = (np.ceil(sides / cell).astype(int) + 2 * margin + 1).tolist()
    shape = np.zeros((height, width), dtype=np.uint8)
    corners = np.round((polygon - low) / cell).astype(np.int32) + margin
    cv2.fillPoly(shape, [corners], (1,))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    return cell, np.asarray(cv2.morphologyEx(shape, cv2.MORPH_CLOSE, disc), dtype=np.uint8)
