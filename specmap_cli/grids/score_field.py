"""Score fields: how near the closest obstacle is, everywhere on a grid, and the way to a match.

What a field is `grids.matching` says. The way to a match, and its last centimetres, are damped
Gauss-Newton steps on the interpolated field (Kohlbrecher et al., "A Flexible and Scalable SLAM
System with Full 3D Motion Estimation", SSRR 2011), which are halved where they make it worse.
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
from specmap_cli.core.geometry import FloatArray, Pose2, product, wrap_angle
from specmap_cli.grids.gridmap import GridMap

FieldArray = NDArray[np.float32]
Step = tuple[float, float, float]  # metres, metres, radians

CELL_M = 0.05  # of a field of points: half a sigma, so that the field is smooth in its cells
SIGMA_M = 0.1  # two walls this far apart are told from one: the noise of a laser and of its pose
LARGEST_SIDE_M = 100.0  # of a field of points: 16 MB
_REACH_SIGMAS = 3.5  # past this distance the score is below 0.003, and outside the field it is 0
_LARGEST_EXPONENT = np.float32(20.0)  # exp(-20) is below single precision beside 1

_FEWEST_POINTS = 3  # as many as unknowns
_DAMPING = 1e-6  # a point, added to the normal matrix: along a single wall it is singular
_LONGEST_STEP = 0.1  # metres and radians: about a sigma, as far as the field is nearly linear
_HALVINGS = 4  # of a step that makes it worse, before giving up
_SHORTEST_STEP = 1e-4  # metres and radians: it ends here, far below a cell
_TINY = 1e-12  # keeps a step of nothing from dividing by zero
# Of the way to a match. A point on a slope adds some 20 a square metre to the normal matrix: so one
# that is damped by 0.2 a point stays where it is guessed along what a hundredth of the points fix.
_WAY_DAMPING = 0.2
_WAY_STEPS = 6
_NEAR_STEP = 1e-3  # metres and radians: what follows mends as much


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
    ) -> ScoreField:
        """The field of obstacle points (N, 2), metres.

        The grid covers all points if they spread over no more than `max_side` metres in x and in y,
        else those within half of that from their median. So a stray point
        kilometres away costs neither time nor memory. But walls beyond do not count either: what
        is matched there scores 0. `left_out` of the result says how many points that were.
        """
        points = np.asarray(points, dtype=np.float64).reshape(-1, 2)
        cells = PointCells.of(points, resolution)
        spread = max(high - low for low, high in zip(cells.low, cells.high, strict=True))
        x, y = np.median(points, axis=0).tolist() if spread > max_side else (0.0, 0.0)
        return cls.from_cells([cells], sigma, max_side, (x, y))

    @classmethod
    def from_cells(
        cls, parts: Sequence[PointCells], sigma: float, max_side: float, middle: tuple[float, float]
    ) -> ScoreField:
        """As `from_points`, of points whose cells, all of one resolution, are known already."""
        resolution = parts[0].resolution
        seen = [part for part in parts if part.cells.size]
        if not seen:
            return cls(np.zeros((1, 1), dtype=np.float32), resolution, (0.0, 0.0))
        margin = math.ceil(_REACH_SIGMAS * sigma / resolution)
        bounds = []
        for axis, centre in enumerate(middle):
            low, high = min(part.low[axis] for part in seen), max(part.high[axis] for part in seen)
            if high - low > max_side:
                low, high = max(low, centre - max_side / 2), min(high, centre + max_side / 2)
            ends = math.floor(low / resolution), math.floor(high / resolution)
            bounds.append((ends[0] - margin, ends[1] + margin))
        (left, right), (below, above) = bounds
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
        x, y = self.origin
        height, width = self.values.shape
        columns = np.floor((points[:, 0] - x) / self.resolution)
        rows = np.floor((points[:, 1] - y) / self.resolution)
        inside = (columns >= 0.0) & (rows >= 0.0) & (columns < width) & (rows < height)
        cells = (rows * width + columns).astype(np.intp)
        return np.asarray(self.values.ravel().take(cells, mode="clip") * inside, dtype=np.float32)

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


def _field_values(empty: NDArray[np.uint8], resolution: float, sigma: float) -> FieldArray:
    """exp(-d^2 / 2 sigma^2) of the distance d from each cell to the nearest zero cell."""
    if empty.all():
        return np.zeros(empty.shape, dtype=np.float32)
    values = np.asarray(cv2.distanceTransform(empty, cv2.DIST_L2, cv2.DIST_MASK_5), np.float32)
    values *= np.float32(resolution / (sigma * math.sqrt(2.0)))  # in place: it is large
    np.square(values, out=values)
    np.minimum(values, _LARGEST_EXPONENT, out=values)
    np.negative(values, out=values)
    return np.exp(values, out=values)


def descend(
    field: ScoreField, points: NDArray[Any], guess: Pose2, iterations: int, max_shift_m: float
) -> Pose2:
    """The pose near `guess` at which sum (1 - M(p))^2 over points (N, 2) is least.

    M(p) is the interpolated field under a point. No more than `iterations` steps are made, none of
    which leads farther than `max_shift_m` from the guess or makes the sum larger.
    """
    if len(points) < _FEWEST_POINTS:
        return guess
    columns = np.ascontiguousarray(points.T)
    pose, here = guess, Sample.of(field, columns, guess)
    missing = 1.0 - here.values
    cost = float((missing * missing).sum())
    for _ in range(iterations):
        step = _step(here, _DAMPING)
        for _ in range(_HALVINGS):
            trial = Pose2(pose.x + step[0], pose.y + step[1], pose.theta + step[2])
            there = Sample.of(field, columns, trial)
            missing = 1.0 - there.values
            trial_cost = float((missing * missing).sum())
            if trial_cost < cost:
                break
            step = (step[0] / 2, step[1] / 2, step[2] / 2)
        else:
            break
        if math.hypot(trial.x - guess.x, trial.y - guess.y) > max_shift_m:
            break
        pose, cost, here = trial, trial_cost, there
        if _size(step) < _SHORTEST_STEP:
            break
    return Pose2(pose.x, pose.y, wrap_angle(pose.theta))


def approach(field: ScoreField, points: NDArray[Any], guess: Pose2, sigma_m: float) -> Pose2:
    """A pose some millimetres from where points (N, 2) fit a field of `sigma_m`, from a near guess.

    A few quick steps, of which nothing is promised: look at the score where they end. The field
    counts with half its sigma once the steps are shorter than that.
    """
    if len(points) < _FEWEST_POINTS:
        return guess
    columns = np.ascontiguousarray(points.T)
    pose, sharp = guess, False
    for _ in range(_WAY_STEPS):
        here = Sample.of(field, columns, pose)
        step = _step(here.sharper() if sharp else here, _WAY_DAMPING)
        pose = Pose2(pose.x + step[0], pose.y + step[1], pose.theta + step[2])
        if sharp and _size(step) < _NEAR_STEP:
            break
        sharp = sharp or _size(step) < sigma_m / 2
    return Pose2(pose.x, pose.y, wrap_angle(pose.theta))


def _size(step: Step) -> float:
    """The largest part of a step, metres or radians."""
    return max(abs(step[0]), abs(step[1]), abs(step[2]))


def _step(here: Sample, damping: float) -> Step:
    """The Gauss-Newton step, cut, by L D L^T: LAPACK rounds otherwise on another processor."""
    equations = here.equations()
    # the lower half of the normal matrix, and the right side
    (a, *_), (b, c, *_), (d, e, f, _), (x, y, z, _) = product(equations, equations.T).tolist()
    damping *= equations.shape[1]
    a, c, f = a + damping, c + damping, f + damping
    low, last = b / a, d / a
    middle = c - low * b
    side = (e - last * b) / middle
    y -= low * x
    z = (z - last * x - side * y) / (f - last * d - side * side * middle)
    y = y / middle - side * z
    step = x / a - low * y - last * z, y, z
    share = min(1.0, _LONGEST_STEP / max(_size(step), _TINY))
    return step[0] * share, step[1] * share, step[2] * share


@dataclass(frozen=True, slots=True, kw_only=True)
class Sample:
    """A field under N points at a pose; all is 0 outside the outermost cell centres.

    `values` (N,), their `slopes` (2, N) a metre in x and y, and `turned` (2, N), the points about
    the pose.
    """

    values: FloatArray
    slopes: FloatArray
    turned: FloatArray

    @classmethod
    def of(cls, field: ScoreField, points: NDArray[Any], pose: Pose2) -> Sample:
        """Looked up at points (2, N), their x above their y: by rows it is twice as quick."""
        cell_m, (x, y) = field.resolution, field.origin
        height, width = field.values.shape
        turned = product(pose.rotation(), points)
        u, v = turned / cell_m
        u += (pose.x - x) / cell_m - 0.5
        v += (pose.y - y) / cell_m - 0.5
        left, below = np.floor(u), np.floor(v)
        # nothing is, where nothing lies between the centres of cells
        inside = (left >= 0.0) & (left < width - 1.0) & (below >= 0.0) & (below < height - 1.0)
        fx, fy = u - left, v - below
        start = (below * width + left).astype(np.intp)
        corners = field.values.ravel().take(start + _cell_corners(width), mode="clip")
        rise = corners[2:] - corners[:2]
        low, high = corners[:2] + rise * fx
        slopes = np.empty((2, len(u)))
        np.add(rise[0], (rise[1] - rise[0]) * fy, out=slopes[0])
        np.subtract(high, low, out=slopes[1])
        values = (low + slopes[1] * fy) * inside
        slopes *= inside / cell_m
        return cls(values=values, slopes=slopes, turned=turned)

    def sharper(self) -> Sample:
        """The same in the field with half its sigma: the fourth power of its values."""
        cube = self.values * self.values * self.values
        return Sample(
            values=cube * self.values, slopes=4.0 * cube * self.slopes, turned=self.turned
        )

    def equations(self) -> FloatArray:
        """(4, N) derivatives of the values by x, y and turn, and what the values miss to one."""
        (dx, dy), (x, y) = self.slopes, self.turned
        rows = np.empty((4, len(x)))
        rows[:2] = self.slopes
        np.subtract(dy * x, dx * y, out=rows[2])
        np.subtract(1.0, self.values, out=rows[3])
        return rows


@cache
def _cell_corners(width: int) -> NDArray[np.intp]:
    """(4, 1) places of the cells around a point from the lower left one: left ones, right ones."""
    return np.array([[0], [width], [1], [width + 1]])
