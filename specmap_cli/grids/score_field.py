"""Score fields: how near the closest obstacle is, everywhere on a grid.

A cell's value is exp(-d^2 / 2 sigma^2) of its distance d to the nearest obstacle, so that the mean
value under the points of a scan says in [0, 1] how well the scan fits where it was put.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, reduce
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.arrays import first_in_cells
from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.grids.gridmap import GridMap

FieldArray = NDArray[np.float32]

CELL_M = 0.05  # of a field of points: half a sigma, so that the field is smooth in its cells
SIGMA_M = 0.1  # two walls this far apart are told from one: the noise of a laser and of its pose
LARGEST_SIDE_M = 100.0  # of a field of points: 16 MB
_REACH_SIGMAS = 3.5  # past this distance the score is below 0.003, and outside the field it is 0
_LARGEST_EXPONENT = np.float32(20.0)  # exp(-20) is below single precision beside 1


@dataclass(frozen=True, slots=True)
class PointCells:
    """The cells `cells` (2, N), columns and rows from the origin of the frame, of N points.

    `low` and `high` are the least and greatest x and y of the points, metres.
    """

    cells: NDArray[np.int64]
    low: tuple[float, float]
    high: tuple[float, float]
    resolution: float

    @classmethod
    def of(cls, points: FloatArray, resolution: float) -> PointCells:
        """The cells of points (N, 2)."""
        cells = np.floor(points.T / resolution).astype(np.int64)
        if not len(points):
            return cls(cells, (0.0, 0.0), (0.0, 0.0), resolution)
        (left, below), (right, above) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
        return cls(cells, (left, below), (right, above), resolution)

    @property
    def spread(self) -> float:
        """How far the points spread in x or y, whichever is more, metres."""
        return max(self.high[0] - self.low[0], self.high[1] - self.low[1])


@dataclass(frozen=True, slots=True)
class ScoreField:
    """`values` (H, W) in [0, 1] on a grid whose lower left corner is `origin` (x, y).

    `left_out` counts the points that the field does not show, for lying too far from the others.
    """

    values: FieldArray
    resolution: float
    origin: tuple[float, float]
    left_out: int = 0

    @classmethod
    def from_points(
        cls,
        points: NDArray[Any],
        resolution: float = CELL_M,
        sigma: float = SIGMA_M,
        max_side: float = LARGEST_SIDE_M,
        middle: tuple[float, float] | None = None,
    ) -> ScoreField:
        """The field of obstacle points (N, 2), metres.

        The grid covers all points if they spread over no more than `max_side` metres in x and in y,
        else those within half of that from `middle`, or from their median. So a stray point
        kilometres away costs neither time nor memory. But walls beyond do not count either: what
        is matched there scores 0. `left_out` of the result says how many points that were.
        """
        points = np.asarray(points, dtype=np.float64).reshape(-1, 2)
        cells = PointCells.of(points, resolution)
        if middle is None:
            x, y = np.median(points, axis=0).tolist() if cells.spread > max_side else (0.0, 0.0)
            middle = (x, y)
        return cls.from_cells([cells], sigma, max_side, middle)

    @classmethod
    def from_cells(
        cls,
        parts: Sequence[PointCells],
        sigma: float,
        max_side: float,
        middle: tuple[float, float],
    ) -> ScoreField:
        """As `from_points`, of points whose cells, all of one resolution, are known already."""
        resolution = parts[0].resolution
        seen = [part for part in parts if part.cells.size]
        if not seen:
            return cls(np.zeros((1, 1), dtype=np.float32), resolution, (0.0, 0.0))
        margin = math.ceil(_REACH_SIGMAS * sigma / resolution)
        ends = [_extent(seen, axis, max_side, middle[axis]) for axis in (0, 1)]
        (left, right), (below, above) = (
            (math.floor(low / resolution) - margin, math.floor(high / resolution) + margin)
            for low, high in ends
        )
        width, height = right - left + 1, above - below + 1
        columns, rows = np.concatenate([part.cells for part in seen], axis=1)
        columns, rows = columns - left, rows - below
        inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
        empty = np.ones((height, width), dtype=np.uint8)
        empty.ravel()[(rows * width + columns)[inside]] = 0
        origin = (float(left * resolution), float(below * resolution))
        left_out = int(np.count_nonzero(~inside))
        return cls(_field_values(empty, resolution, sigma), resolution, origin, left_out)

    def with_cells(self, part: PointCells, sigma: float) -> ScoreField | None:
        """The same field with more points, whose cells are of its resolution; sigma is its own.

        Where the new points are far from, past the reach of sigma, it stays as it was. None if one
        of them is too near the edge: then the field must be made anew.
        """
        stamp = _stamp(self.resolution, sigma)
        reach, (height, width) = len(stamp) // 2, self.values.shape
        corner = [round(place / self.resolution) for place in self.origin]
        columns, rows = part.cells[0] - corner[0], part.cells[1] - corner[1]
        if not columns.size:
            return self
        low, high = min(columns.min(), rows.min()), max(columns.max() - width, rows.max() - height)
        if low < reach or high >= -reach:
            return None
        values = self.values.copy()
        flat = values.ravel()
        new = rows * width + columns
        new = np.unique(new[flat[new] < 1.0])
        down, across = np.nonzero(stamp)
        around = (down - reach) * width + (across - reach)
        near = (new[:, None] + around).ravel()
        # values of the same shape: broadcast ones, numpy 2.4 reads beyond their end
        np.maximum.at(flat, near, np.tile(stamp[down, across], len(new)))
        return replace(self, values=values)

    @classmethod
    def from_grid(cls, grid: GridMap, sigma: float = SIGMA_M) -> ScoreField:
        """The field of the occupied cells of an occupancy grid, in the grid's frame."""
        margin = math.ceil(_REACH_SIGMAS * sigma / grid.resolution)
        empty = np.pad((~grid.occupied).astype(np.uint8), margin, constant_values=1)
        shift = margin * grid.resolution
        origin = (grid.origin[0] - shift, grid.origin[1] - shift)
        return cls(_field_values(empty, grid.resolution, sigma), grid.resolution, origin)

    def at(self, points: NDArray[Any]) -> FieldArray:
        """(N,) values under points (N, 2) of the field's frame; 0 outside."""
        cells = np.floor((points - np.asarray(self.origin)) / self.resolution).astype(np.intp)
        columns, rows = cells[:, 0], cells[:, 1]
        height, width = self.values.shape
        inside = (columns >= 0) & (rows >= 0) & (columns < width) & (rows < height)
        values = np.zeros(len(cells), dtype=np.float32)
        values[inside] = self.values[rows[inside], columns[inside]]
        return values

    def score(self, points: NDArray[Any], pose: Pose2) -> float:
        """Mean value in [0, 1] of points (N, 2) placed at `pose`; 0 without points."""
        return float(self.at(pose.apply(points)).mean()) if len(points) else 0.0

    def sharper(self) -> ScoreField:
        """The field with half its sigma, for the last refinement: walls drawn half as wide."""
        return replace(self, values=np.square(np.square(self.values)))

    def coarser(self, factor: int) -> ScoreField:
        """The maximum over blocks of `factor` x `factor` cells: never below the fine field."""
        height, width = self.values.shape
        padded = np.pad(self.values, ((0, -height % factor), (0, -width % factor)))
        rows = reduce(np.maximum, (padded[k::factor] for k in range(factor)))
        values = reduce(np.maximum, (rows[:, k::factor] for k in range(factor)))
        return replace(self, values=values, resolution=self.resolution * factor)


def thinned(points: FloatArray, cell_m: float) -> FloatArray:
    """The first point (of (N, 2) or (N, 3)) in each cell of a grid of side `cell_m`, in order."""
    return points[first_in_cells(points, cell_m)]


@cache
def _stamp(resolution: float, sigma: float) -> FieldArray:
    """(2 r + 1, 2 r + 1) the field of one point, in the middle, as far as it reaches; 0 beyond."""
    reach = math.ceil(_REACH_SIGMAS * sigma / resolution)
    empty = np.ones((2 * reach + 1, 2 * reach + 1), dtype=np.uint8)
    empty[reach, reach] = 0
    values = _field_values(empty, resolution, sigma)
    values[values < math.exp(-(_REACH_SIGMAS**2) / 2)] = 0.0
    values.setflags(write=False)
    return values


def _extent(
    parts: Sequence[PointCells], axis: int, longest: float, middle: float
) -> tuple[float, float]:
    """Least and greatest x (axis 0) or y, cut to half of `longest` on either side of a middle."""
    low, high = min(part.low[axis] for part in parts), max(part.high[axis] for part in parts)
    if high - low <= longest:
        return low, high
    return max(low, middle - longest / 2), min(high, middle + longest / 2)


def _field_values(empty: NDArray[np.uint8], resolution: float, sigma: float) -> FieldArray:
    """exp(-d^2 / 2 sigma^2) of the distance d from each cell to the nearest zero cell."""
    if empty.all():
        return np.zeros(empty.shape, dtype=np.float32)
    cells = cv2.distanceTransform(empty, cv2.DIST_L2, cv2.DIST_MASK_5)
    squares = np.square(cells * np.float32(resolution / (sigma * math.sqrt(2.0))))
    return np.asarray(np.exp(-np.minimum(squares, _LARGEST_EXPONENT)), dtype=np.float32)
