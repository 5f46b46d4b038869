"""The shape of a submap: its outline, and whether it is a corridor, a hall or a room.

The outline is the outer contour of the free cells. What a submap is follows from the outline: its
mean width is four times the mean distance of its points from the nearest border. For a long strip,
straight or bent, that is the width of the strip; for a square it is two thirds of its side.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.grids.gridmap import BoolArray, GridMap, cell_distances
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
    doubled = np.zeros((2 * region.shape[0] + 2, 2 * region.shape[1] + 2), dtype=np.uint8)
    for row, column in ((1, 1), (1, 2), (2, 1), (2, 2)):
        doubled[row:-1:2, column:-1:2] = region
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


# Of a shape, and along its longer side; larger shapes have larger cells. Borders run along cells of
# a map, of which no multiple is half of one of these: none runs through a row of their centres.
_CELL_M, _MOST_CELLS = 0.05 / math.sqrt(2.0), 1000.5
# Gaps narrower than a door lie between pieces of furniture: they are filled, from both sides.
_GAP_M = 0.8
# A hall is wider than a corridor is made, and larger than a room for thirty people.
_HALL_WIDTH_M, _HALL_M2 = 4.0, 60.0
# Area by squared mean width of a rectangle four times as long as it is wide: 4 / (1 - 1/12) ** 2.
_LONG = 576.0 / 121.0


def kind_of(polygon: FloatArray) -> SubmapKind | None:
    """The kind of a region with this border (N, 2), metres; None for one without any area.

    A hall has 60 square metres and a mean width of 4 m, or more. Of other shapes, those are
    corridors that are long for their width, as a rectangle of 4 by 1 is. They are measured along
    their own walls: a shape that is turned, moved or mirrored has the same kind, unless half a
    percent of its length would change it.
    """
    if not len(polygon):
        return None
    shape, cell = _along_walls(polygon)
    if not shape.any():
        return None
    # a gap is filled where no disc fits into it; its radius is half a cell less than the reach
    reach = int(_GAP_M / 2.0 / cell) + 1
    away = cell_distances(np.pad(~shape, reach + 1, constant_values=True).astype(np.uint8))
    away = cell_distances((away < reach).astype(np.uint8))
    depths = away[away >= reach] - (reach - 0.5)
    area, width = len(depths) * cell**2, 4.0 * cell * float(depths.mean())
    if area >= _HALL_M2 and width >= _HALL_WIDTH_M:
        return "hall"
    return "corridor" if area >= _LONG * width**2 else "room"


def _along_walls(polygon: FloatArray) -> tuple[BoolArray, float]:
    """The cells (H, W) with their centres in a polygon (N, 2), and their side, metres.

    Their rows run along the walls, the longest of which count most, and one of them has its centre
    in the middle of the shape.
    """
    corners = polygon @ (1.0, 1.0j)
    steps = np.roll(corners, -1) - corners
    # a right angle, times four, is a whole turn: all sides of a rectangle point one way
    corners = corners * np.exp(-0.25j * np.angle(np.sum(steps**4)))
    x, y = (part - (part.max() + part.min()) / 2.0 for part in (corners.real, corners.imag))
    cell = max(_CELL_M, 2.0 * max(x.max(), y.max()) / _MOST_CELLS)
    width, height = (int(part.max() / cell) for part in (x, y))  # on each side of the middle
    x, y = x / cell + width, y / cell + height
    end_x, end_y = np.roll(x, -1), np.roll(y, -1)
    low, high = (np.ceil(ends).astype(np.intp) for ends in (np.fmin(y, end_y), np.fmax(y, end_y)))
    side = np.repeat(np.arange(len(x)), high - low)
    row = low[side] + np.arange(len(side)) - (np.cumsum(high - low) - (high - low))[side]
    share = (row - y[side]) / (end_y - y)[side]
    first = np.ceil(x[side] + share * (end_x - x)[side]).astype(np.intp)  # beyond the side
    crossed = np.zeros((2 * height + 1, 2 * width + 2), dtype=np.intp)
    np.add.at(crossed, (row, first), 1)
    return np.cumsum(crossed, axis=1)[:, :-1] % 2 == 1, cell
