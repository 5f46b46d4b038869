"""Do two grids show the same place? Walls and free space prepared, transforms tried, a judgement.

The search needs no prior pose: rotations come from the directions of the walls, translations from
the search everywhere of `grids`. The judgement counts the wall points of each grid that the other
one confirms, less twice those that stand where the other saw free space: a right transform
contradicts nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial

import cv2
import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.arrays import evenly
from specmap_cli.core.geometry import FloatArray, Pose2, wrap_angle
from specmap_cli.core.records import BoolArray
from specmap_cli.grids.gridmap import NO_OBSTACLE_M, UNKNOWN, GridMap
from specmap_cli.grids.matching import refine, search_everywhere
from specmap_cli.grids.score_field import ScoreField

_MATCH_SIGMA_M = 0.15  # how near matched walls pull each other
_INLIER_M = 0.15  # a wall point this near a wall agrees
LEAST_WALL_M = 0.5  # less of it says nothing about where a grid belongs
_MOST_POINTS = 1200  # of walls that are compared: 60 m of them on cells of 5 cm
_WALL_BLUR_CELLS = 2.0  # the picture of walls is smoothed by this to tell their direction
_FLAT = 1e-9  # keeps the direction of a picture without a gradient from dividing by nought
_HARMONICS = 16  # of the directions of walls: two that are 11 degrees apart are told apart
_TURNS = 720  # of which the best is chosen, in a half turn
# The direction of walls is good to a few degrees. Stairs of coarse cells bend it: by 22 degrees on
# simulated rooms in cells of 0.25 m.
_SLACK_RAD = math.radians(3.0)
_FINE_CELL_M, _CELL_M_PER_SLACK = 0.05, 0.025
COARSE_M, _PLACES = 0.3, 8  # of the search everywhere
RIVAL_M, RIVAL_RAD = 1.0, math.radians(10.0)  # transforms farther apart are rivals when both fit

CANDIDATES = 3  # best ranked old submaps whose grids are matched
_HOPELESS_SCORE = 0.3  # a match below this is given up
_CONTRADICTION_M = 0.3  # a wall point farther than this from walls, and in free space, contradicts
_CONTRADICTION_DEPTH_M = 0.25  # free space counts this far from its edge, which noise blurs
MIN_LEAD = 0.1  # score over the next best match, or it is ambiguous
MIN_WALL_M = 5.0  # metres of wall that agree, cell by cell
MIN_OVERLAP = 0.4  # shared part of the walls of one of two submaps
LEAST_OVERLAP = 0.15  # shared part of the walls of the other one
CONTRADICTION_WEIGHT = 2.0  # separates right from wrong transforms of fr079 without an error
# A wall may be drawn one cell beside where it is, or two where a turned grid is laid on another.
_INLIER_CELLS, _CONTRADICTION_CELLS = 1.0, 2.5
_REFINED = 3
# Points and shift of the refinement: first from a coarse cell away, then for the last centimetres.
_ROUGH_POINTS, _ROUGH_STEPS, _ROUGH_SHIFT_M = 160, 6, 0.6
_FINE_POINTS, _FINE_STEPS, _FINE_SHIFT_M = 1000, 15, 0.2

ImageArray = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class PreparedGrid:
    """One `grid` prepared for matching, in its own frame.

    `walls` (N, 2) points of the occupied cells, each for `metres_a_point` of wall; `directions` as
    `wall_directions` has them. `known` (H, W) are the cells that were seen, or lie next to such
    ones; `at_wall` (H, W) those so near a wall that another grid's wall agrees there, `open` (H, W)
    those where one contradicts: far from walls, and deep in free space. What the older grid of a
    match alone needs is made when asked for: many a grid is only ever the newer one.
    """

    grid: GridMap
    sigma_m: float
    walls: FloatArray
    metres_a_point: float
    directions: NDArray[np.complex128]
    known: BoolArray
    at_wall: BoolArray
    open: BoolArray

    @property
    def middle(self) -> Pose2:
        """The middle of its walls, unturned: transforms differ by where they place it."""
        x, y = self.walls.mean(axis=0).tolist()
        return Pose2(x, y, 0.0)

    @property
    def direction(self) -> float:
        """The direction of the walls, modulo a right angle, radians."""
        fourfold = complex(self.directions[2])
        return math.atan2(fourfold.imag, fourfold.real) / 4.0

    @cached_property
    def wide(self) -> ScoreField:
        """How near walls are, tolerant, for ranking."""
        return ScoreField.from_grid(self.grid, 2.0 * self.sigma_m)

    @cached_property
    def field(self) -> ScoreField:
        """How near walls are, for the refinement."""
        return self.wide.sharper()


def prepared(
    grid: GridMap, directions: NDArray[np.complex128] | None = None
) -> PreparedGrid | None:
    """The grid prepared for matching; None when it shows too little of a wall.

    `directions` are those of its walls, where they are known from before.
    """
    grid = grid.cropped()
    walls, metres_a_point = walls_of(grid)
    if len(walls) * metres_a_point < LEAST_WALL_M:
        return None
    # what the grid knows ends as far past the cells that were seen as an inlier may be off
    margin = max(1, round(_INLIER_M / grid.resolution))
    seen = (grid.cells != UNKNOWN).astype(np.uint8)
    known = cv2.dilate(seen, np.ones((2 * margin + 1, 2 * margin + 1), dtype=np.uint8))
    # distances are of whole cells: no limit is finer than they can tell
    cell, from_wall = grid.resolution, _metres_within(~grid.occupied, grid.resolution)
    at_wall = from_wall <= max(_INLIER_M, _INLIER_CELLS * cell)
    open_ = from_wall > max(_CONTRADICTION_M, _CONTRADICTION_CELLS * cell)
    del from_wall
    depth = _metres_within(grid.free, cell)
    open_ &= depth > max(_CONTRADICTION_DEPTH_M, _INLIER_CELLS * cell)
    return PreparedGrid(
        grid=grid,
        sigma_m=max(_MATCH_SIGMA_M, grid.resolution),
        walls=walls,
        metres_a_point=metres_a_point,
        directions=wall_directions(grid) if directions is None else directions,
        known=known.view(np.bool_),
        at_wall=at_wall,
        open=open_,
    )


def _metres_within(inside: BoolArray, resolution: float) -> ImageArray:
    """(H, W) metres from each cell `inside` to the nearest one outside; NO_OBSTACLE_M for none."""
    if inside.all():
        return np.full(inside.shape, NO_OBSTACLE_M, dtype=np.float32)
    cells = cv2.distanceTransform(inside.view(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5)
    return np.asarray(cells * np.float32(resolution), dtype=np.float32)


def walls_of(grid: GridMap) -> tuple[FloatArray, float]:
    """Points (n, 2) of the occupied cells of a grid, and how many metres of wall each tells of."""
    occupied = np.argwhere(grid.occupied)
    points = evenly(occupied, _MOST_POINTS)
    return grid.centres_of(points), grid.resolution * len(occupied) / max(1, len(points))


def wall_directions(grid: GridMap) -> NDArray[np.complex128]:
    """(K,) Fourier series of how much wall runs in each direction, modulo a half turn, smoothed.

    From the gradient of the blurred picture of the obstacles: twice its angle is the same for a
    wall and for its back. The product of one series and the conjugate of another is that of their
    circular correlation.
    """
    picture = cv2.GaussianBlur(grid.occupied.astype(np.float32), (0, 0), _WALL_BLUR_CELLS)
    dx = cv2.Sobel(picture, cv2.CV_32F, 1, 0)
    dy = cv2.Sobel(picture, cv2.CV_32F, 0, 1)
    steep = np.flatnonzero((dx != 0.0) | (dy != 0.0))  # few cells lie near a wall
    gradient = dx.take(steep) + np.complex64(1j) * dy.take(steep)
    power = gradient * gradient
    unit = power / (np.abs(power) + _FLAT)
    series = np.zeros(_HARMONICS + 1, dtype=np.complex128)
    for k in range(1, _HARMONICS + 1):
        series[k] = power.sum(dtype=np.complex128) * math.exp(-2.0 * (k / _HARMONICS) ** 2)
        power *= unit
    return series


def headings(old: PreparedGrid, new: PreparedGrid) -> list[float]:
    """The headings old_from_new at which most wall lies along wall: the two best, and turned round.

    A correlation of directions of walls, as of Hough spectra (Carpin, "Fast and accurate map
    merging for multi-robot systems", Autonomous Robots 2008).
    """
    # the larger the cells, the more steps to either side of aligned walls are tried
    cell_m = max(old.grid.resolution, new.grid.resolution)
    steps = max(0, int((cell_m - _FINE_CELL_M) / _CELL_M_PER_SLACK))
    along = np.fft.irfft(old.directions.conj() * new.directions, _TURNS)
    peaks = np.flatnonzero((along >= np.roll(along, 1)) & (along >= np.roll(along, -1)))
    best = peaks[np.argsort(-along[peaks], kind="stable")][:2]
    return [
        (turn / _TURNS + half) * math.pi + k * _SLACK_RAD
        for turn in best.tolist()
        for half in range(2)
        for k in range(-steps, steps + 1)
    ]


def are_rivals(a: Pose2, b: Pose2) -> bool:
    """Whether two poses of the middle of a map are too different to be the same."""
    turn = abs(wrap_angle(a.theta - b.theta))
    return math.dist(a[:2], b[:2]) > RIVAL_M or turn > RIVAL_RAD


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """The best transform between two grids and how well they agree under it.

    `score` is the smaller share of inliers less twice the larger share of contradictions, at most
    1; `confirmed_m` the smaller length of wall confirmed, metres; `overlap` and `least_overlap` the
    larger and the smaller share of a grid's walls that the other one knows about. `lead` is how
    much better it is than the next best transform that is a different one.
    """

    old_from_new: Pose2
    score: float
    confirmed_m: float
    overlap: float
    least_overlap: float
    lead: float = 0.0

    @property
    def overlaps(self) -> bool:
        """Whether each grid knows enough of the walls of the other."""
        return self.overlap >= MIN_OVERLAP and self.least_overlap >= LEAST_OVERLAP


def verify(
    old: PreparedGrid,
    new: PreparedGrid,
    plausible: Callable[[Pose2], bool],
    tracked: Pose2 | None = None,
) -> Check | None:
    """The best transform between two grids and its judgement; None when nothing overlaps.

    And how much better it is than a different one. Candidates are where walls lie along walls, and
    where the new grid was `tracked`: new space and rooms without right angles hide that from the
    search. Only what tracking finds `plausible` is weighed. Where the best is ruled out itself and
    leads, all are: it is to be told.
    """
    points = evenly(new.walls, _ROUGH_POINTS)
    found = search_everywhere(old.wide, new.walls, _PLACES, COARSE_M, headings(old, new))
    places = [match.pose for match in found]
    likely = sorted(places, key=partial(old.wide.score, points), reverse=True)[:_REFINED]
    likely += [] if tracked is None else [tracked]
    poses = (refine(old.field, points, pose, _ROUGH_STEPS, _ROUGH_SHIFT_M).pose for pose in likely)
    checks = sorted((judge(old, new, pose) for pose in poses), key=_rank, reverse=True)
    if not checks:
        return None
    possible = [check for check in checks if plausible(check.old_from_new)]
    if possible and _rank(checks[0]) - _rank(possible[0]) < MIN_LEAD:
        checks = possible
    best, *others = checks
    if best.score < _HOPELESS_SCORE:
        return best
    points, about = evenly(new.walls, _FINE_POINTS), new.middle
    fine = refine(old.field, points, best.old_from_new, _FINE_STEPS, _FINE_SHIFT_M).pose
    final = judge(old, new, fine)
    rivals = [
        _rank(check)
        for check in others
        if are_rivals(check.old_from_new @ about, best.old_from_new @ about)
    ]
    lead = _rank(best) - max(rivals, default=-1.0)
    return replace(final if final.score >= best.score else best, lead=lead)


def judge(old: PreparedGrid, new: PreparedGrid, old_from_new: Pose2) -> Check:
    """How well two grids agree under a given transform."""
    there = agreement(old, old_from_new.apply(new.walls))
    back = agreement(new, old_from_new.inverse().apply(old.walls))
    contradicted = max(there.contradicted, back.contradicted)
    return Check(
        old_from_new=old_from_new,
        score=min(there.confirmed, back.confirmed) - CONTRADICTION_WEIGHT * contradicted,
        confirmed_m=min(there.inliers * new.metres_a_point, back.inliers * old.metres_a_point),
        overlap=max(there.known, back.known),
        least_overlap=min(there.known, back.known),
    )


def tracks_overlap(
    old: NDArray[np.float64], new: NDArray[np.float64], old_from_new: Pose2, reach: float
) -> float:
    """The smaller share of either track (k, 3) that passes within `reach` metres of the other."""
    if not len(old) or not len(new):
        return 0.0
    placed = old_from_new.apply(new[:, :2])
    low, high = placed.min(axis=0) - reach, placed.max(axis=0) + reach
    if (old[:, :2].max(axis=0) < low).any() or (old[:, :2].min(axis=0) > high).any():
        return 0.0  # as of most pairs of a large building
    x, y = (old[:, axis, None] - placed[:, axis] for axis in (0, 1))
    near = x * x + y * y <= reach * reach
    return float(min(near.any(axis=0).mean(), near.any(axis=1).mean()))


def _rank(check: Check) -> float:
    """What decides between transforms: agreement, and how much of the walls it covers."""
    return check.score * math.sqrt(check.overlap) if check.score > 0.0 else check.score - 1.0


@dataclass(frozen=True, slots=True)
class Agreement:
    """Of points on walls: the share in a known area, and of these the shares that it confirms and
    contradicts, and the count of those confirmed.
    """

    known: float
    confirmed: float
    contradicted: float
    inliers: int


def agreement(area: PreparedGrid, points: FloatArray) -> Agreement:
    """What a grid says to points (N, 2) on walls, in its frame."""
    cells = area.grid.cells_of(points)
    rows, columns = cells[area.grid.inside(cells)].T
    known = area.known[rows, columns]
    rows, columns = rows[known], columns[known]
    if not len(rows):
        return Agreement(0.0, 0.0, 0.0, 0)
    inliers = int(np.count_nonzero(area.at_wall[rows, columns]))
    contradicted = int(np.count_nonzero(area.open[rows, columns]))
    return Agreement(
        len(rows) / len(points), inliers / len(rows), contradicted / len(rows), inliers
    )
