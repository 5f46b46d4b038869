"""The shape of a submap: its outline, and whether it is a corridor, a hall or a room.

The outline is the outer contour of the free cells. What a submap is follows from the outline: its
mean width is four times the mean distance of its points from the nearest border. For a long strip,
straight or bent, that is the width of the strip; for a square it is two thirds of its side.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.grids.gridmap import BoolArray, GridMap
from specmap_cli.topology.topological_map import SubmapKind

_TOLERANCE = 2.0  # of the simplified contour, half cells
_KEPT_AREA = 0.8  # share of its area that a simplified contour must keep


@dataclass(frozen=True, slots=True)
class Outline:
    """A region's shape in metres: `polygon` (N, 2) counter-clockwise and `centroid` (2,).

    Both are those of the largest connected part. `area_m2` is that of all free cells: what is told
    anywhere as the area of a submap, or summed as that of a map. Furniture that counts as a part of
    a region is none of it. A region without a cell has no points, None and zero.
    """

    polygon: FloatArray
    centroid: FloatArray | None
    area_m2: float


NOTHING = Outline(np.zeros((0, 2)), None, 0.0)


def outline_of(region: BoolArray, grid: GridMap) -> Outline:
    """The outline of the cells `region` (H, W) in the frame of `grid`.

    It is simplified to within a cell's side. The centroid is the centre of the region's cell
    nearest the mean of its cells, so that it lies inside a region of any shape.
    """
    if not region.any():
        return NOTHING
    # of its largest connected part, the first of equals
    _, labels, stats, _ = cv2.connectedComponentsWithStats(
        region.astype(np.uint8), connectivity=4, ltype=cv2.CV_32S
    )
    part = np.asarray(labels == 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA])))
    counts = [np.count_nonzero(part, axis=axis) for axis in (1, 0)]
    mean = np.array([np.average(np.arange(len(count)), weights=count) for count in counts])
    cell = np.round(mean).astype(np.intp)
    if not part[tuple(cell)]:
        eroded = cv2.erode(part.astype(np.uint8), np.ones((3, 3), dtype=np.uint8))
        border = np.argwhere(part & (eroded == 0))
        cell = border[np.argmin(np.sum((border - mean) ** 2, axis=1))]
    return Outline(
        _contour(part) * grid.resolution + grid.origin,
        grid.centres_of(cell[None])[0],
        float(np.count_nonzero(region & grid.free)) * grid.resolution**2,
    )


def _contour(region: BoolArray) -> FloatArray:
    """(N, 2) columns and rows of the outer contour of one connected region, counter-clockwise.

    Cell (row, column) covers [column, column + 1) x [row, row + 1). The contour has few corners, as
    far as it stays the outline of an area.
    """
    # Doubled, so that the contour runs a quarter of a cell inside the region, not along centres,
    # where a passage one cell wide would have no area.
    doubled = cv2.resize(
        region.astype(np.uint8), None, fx=2.0, fy=2.0, interpolation=cv2.INTER_NEAREST
    )
    doubled = cv2.copyMakeBorder(doubled, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=(0,))
    contours, _ = cv2.findContours(doubled, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    ring = max(contours, key=cv2.contourArea)
    area = cv2.contourArea(ring)
    for tolerance in (_TOLERANCE, _TOLERANCE / 2.0):
        simple = cv2.approxPolyDP(ring, tolerance, True)
        is_thin = cv2.contourArea(simple) < _KEPT_AREA * area  # thinner than the tolerance
        if not is_thin and not _meets_itself(simple.reshape(-1, 2).astype(np.int64)):
            ring = simple
            break
    corners = (ring.reshape(-1, 2).astype(np.float64) - 0.5) / 2.0
    x, y = corners.T
    turning = float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
    return corners if turning >= 0.0 else corners[::-1]


def _meets_itself(ring: NDArray[np.int64]) -> bool:
    """Whether two sides of a ring (N, 2), which are no neighbours, cross or touch: exactly."""
    ends = np.roll(ring, -1, axis=0)
    low, high = np.minimum(ring, ends), np.maximum(ring, ends)
    last = len(ring) - 1
    for number in range(last - 1):
        others = slice(number + 2, last if number == 0 else last + 1)
        start, end = ring[number], ends[number]
        near = ((high[others] >= low[number]) & (low[others] <= high[number])).all(axis=1)
        apart = _side(start, end, ring[others]) * _side(start, end, ends[others]) > 0
        aside = _side(ring[others], ends[others], start) * _side(ring[others], ends[others], end)
        if (near & ~apart & (aside <= 0)).any():
            return True
    return False


def _side(
    start: NDArray[np.int64], end: NDArray[np.int64], place: NDArray[np.int64]
) -> NDArray[np.int64]:
    """(N,) on which side of a line a place lies: 1, -1, or 0 on it."""
    along, to = end - start, place - start
    return np.asarray(np.sign(along[..., 0] * to[..., 1] - along[..., 1] * to[..., 0]))


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
    # drawn in cells, its narrow gaps filled
    low, sides = polygon.min(axis=0), np.ptp(polygon, axis=0)
    cell = max(_CELL_M, float(sides.max()) / _MOST_CELLS)
    reach = round(_GAP_M / 2.0 / cell)
    margin = reach + 1
    width, height = (np.ceil(sides / cell).astype(int) + 2 * margin + 1).tolist()
    shape = np.zeros((height, width), dtype=np.uint8)
    corners = np.round((polygon - low) / cell).astype(np.int32) + margin
    cv2.fillPoly(shape, [corners], (1,))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    shape = np.asarray(cv2.morphologyEx(shape, cv2.MORPH_CLOSE, disc), dtype=np.uint8)
    away = cv2.distanceTransform(shape, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[shape > 0]
    away = away.astype(np.float64) - 1.0  # the border runs through the outermost cells
    cells = len(away) - 0.5 * np.count_nonzero(away <= 0.0)  # which lie half outside
    area, width = cells * cell**2, 4.0 * cell * float(away.sum()) / cells
    if not width:
        return None
    if area >= _HALL_M2 and width >= _HALL_WIDTH_M:
        return "hall"
    return "corridor" if area >= _LONG * width**2 else "room"
