"""Score fields: how near the closest obstacle is, everywhere on a grid.

A cell's value is exp(-d^2 / 2 sigma^2) of its distance d to the nearest obstacle, so that the mean
value under the points of a scan says in [0, 1] how well the scan fits where it was put.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.thinning import first_in_cells
from specmap_cli.grids.gridmap import GridMap

FieldArray = NDArray[np.float32]

CELL_M = 0.05  # of a field of points: half a sigma, so that the field is smooth in its cells
SIGMA_M = 0.1  # two walls this far apart are told from one: the noise of a laser and of its pose
LARGEST_SIDE_M = 100.0  # of a field of points: 16 MB
_REACH_SIGMAS = 3.5  # past this distance the score is below 0.003, and outside the field it is 0
_LARGEST_EXPONENT = np.float32(20.0)  # exp(-20) is below single precision beside 1


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
        if not len(points):
            return cls(np.zeros((1, 1), dtype=np.float32), resolution, (0.0, 0.0))
        x, y = np.ascontiguousarray(points.T)
        middles = middle or (None, None)
        left, right = _extent(x, max_side, middles[0])
        below, above = _extent(y, max_side, middles[1])
        margin = math.ceil(_REACH_SIGMAS * sigma / resolution)
        corner = (math.floor(left / resolution) - margin, math.floor(below / resolution) - margin)
        columns = np.floor(x / resolution).astype(np.intp) - corner[0]
        rows = np.floor(y / resolution).astype(np.intp) - corner[1]
        width = math.floor(right / resolution) - corner[0] + 1 + margin
        height = math.floor(above / resolution) - corner[1] + 1 + margin
        inside = (columns >= 0) & (columns < width) & (rows >= 0) & (rows < height)
        empty = np.ones((height, width), dtype=np.uint8)
        empty[rows[inside], columns[inside]] = 0
        origin = (float(corner[0] * resolution), float(corner[1] * resolution))
        left_out = int(np.count_nonzero(~inside))
        return cls(_field_values(empty, resolution, sigma), resolution, origin, left_out)

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
        blocks = padded.reshape(padded.shape[0] // factor, factor, -1, factor)
        return replace(self, values=blocks.max(axis=(1, 3)), resolution=self.resolution * factor)


def thinned(points: FloatArray, cell_m: float) -> FloatArray:
    """The first point (of (N, 2) or (N, 3)) in each cell of a grid of side `cell_m`, in order."""
    return points[first_in_cells(points, cell_m)]


def _extent(values: FloatArray, longest: float, middle: float | None) -> tuple[float, float]:
    """Smallest and largest value, cut to half of `longest` on either side of a middle.

    None stands for the median of the values.
    """
    low, high = float(values.min()), float(values.max())
    if high - low <= longest:
        return low, high
    if middle is None:
        middle = float(np.median(values))
    return max(low, middle - longest / 2), min(high, middle + longest / 2)


def _field_values(empty: NDArray[np.uint8], resolution: float, sigma: float) -> FieldArray:
    """exp(-d^2 / 2 sigma^2) of the distance d from each cell to the nearest zero cell."""
    if empty.all():
        return np.zeros(empty.shape, dtype=np.float32)
    cells = cv2.distanceTransform(empty, cv2.DIST_L2, cv2.DIST_MASK_5)
    squares = np.square(cells * np.float32(resolution / (sigma * math.sqrt(2.0))))
    return np.asarray(np.exp(-np.minimum(squares, _LARGEST_EXPONENT)), dtype=np.float32)
