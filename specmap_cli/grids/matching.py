"""The correlative matcher: how well points fit a place, and the pose at which they fit best.

One home for matching scans against scans, scans against grids and grids against grids. A
`ScoreField` holds, per cell, how near the closest obstacle is: exp(-d^2 / 2 sigma^2), so that the
score of points at a pose is in [0, 1] and needs one lookup a point. Poses are `field_from_points`.

Typical use, when the pose is known roughly (`search`) or not at all (`search_everywhere`)::

    field = ScoreField.from_grid(grid)
    window = Window(distance_m=1.0, angle_rad=0.3, step_m=0.1)
    match = refine(field, points, search(field, points, guess, window).pose)

The search is the correlative scan matching of Olson (ICRA 2009), the refinement the Gauss-Newton
step on an interpolated field of Kohlbrecher et al. (SSRR 2011). How sure a match is, its covariance
says, and how well walls fix a place at all, `weakest_direction`: along a bare corridor, not.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray, Pose2, apply_each, product, wrap_angle
from specmap_cli.core.records import BoolArray
from specmap_cli.grids.occupancy import SURFACE_GAP_M
from specmap_cli.grids.score_field import ScoreField, descend

REFINE_ITERATIONS = 20  # of Gauss-Newton, which ends by itself after some five near the truth
REFINE_SHIFT_M = 0.3  # three sigma of the usual field: it pulls from no farther

# the score surface round a match: 2 % of the score is what a change of a few points makes
SPREAD_TEMPERATURE = 0.02
SPREAD_M, SPREAD_RAD = 0.3, 0.09  # looked at: beyond the errors of a match that is right
_SPREAD_STEPS = 6  # of the lattice, from the match to either end

_SCORE_STEP = 1e-4  # of scores of single precision, whose rounding is some hundred times finer

_APART_M = 1.0  # of two places found: nearer ones lead `refine` to the same pose
_APART_RAD = 0.3  # likewise of two headings

PRIOR_SIGMAS = 3.0  # of a prior that are searched
_ANSWERS = 4  # places compared: the best one and its rivals
_LATTICE_BEST, _SOME = 500, 4  # poses that fit some of the points best are asked of them all

_FAR_PERCENTILE = 80.0  # of the ranges: the few farthest points may move by more than a step
_LEAST_TURN_RAD, _MOST_TURN_RAD = 0.01, 0.05  # between two angles that are tried
_SLACK = 1e-9  # scores and lengths this close are equal
_GATHERED = 1 << 18  # values looked up at a time: 1 MB, as caches hold

_DISTINCT_M = 1e-6  # between points of which the direction of a surface can be had
_PIECE_M, _SMOOTHED_GAP_M = 0.25, 0.5  # pieces of smoothed surfaces, and gaps that end these
# Share of the points by which noise seems to fix a place: walls are never even, and hedges do.
_LEAST_NOISE, _MOST_NOISE = 0.01, 0.02
# Median size of what pieces are off the line between their neighbours, to the angle by which errors
# of the same size turn normals, times its root of two: 1.48 sqrt(2 / 1.5) sqrt(2).
_TURNED = 2.42
_FEWEST_SURFACES = 3  # as many as unknowns


@dataclass(frozen=True, slots=True, kw_only=True)
class Window:
    """Where to search round a guess: +-`distance_m` in x and y, +-`angle_rad`.

    Shifts are tried every `step_m`, angles every `angle_step_rad` (None: the angle that moves the
    farther points by one step). `penalty_per_m2` d^2 + `penalty_per_rad2` a^2, for a pose d metres
    and a radians from the guess, decides between places that fit alike.
    """

    distance_m: float
    angle_rad: float
    step_m: float
    angle_step_rad: float | None = None
    penalty_per_m2: float = 0.0
    penalty_per_rad2: float = 0.0


@dataclass(frozen=True, slots=True)
class Match:
    """A pose `field_from_points` and its score in [0, 1], any penalty left out."""

    pose: Pose2
    score: float


def search(field: ScoreField, points: NDArray[Any], guess: Pose2, window: Window) -> Match:
    """The best pose of points (N, 2) on the steps of `window` around `guess`, exhaustively.

    Ties go to the pose nearest the guess. With N points, A angles and S shifts the cost is A S N
    lookups. Without points the guess comes back with score 0.
    """
    if not len(points):
        return Match(guess, 0.0)
    shifts, angles = _lattice(points, window, field.resolution)
    scores = _lattice_scores(field, points, guess, shifts, angles)
    penalty = window.penalty_per_m2 * (shifts**2).sum(axis=1)
    values = scores - penalty - window.penalty_per_rad2 * angles[:, None] ** 2
    best, best_value, best_score = guess, -np.inf, 0.0
    for turn, k in enumerate(values.argmax(axis=1).tolist()):
        if values[turn, k] > best_value + _SLACK:
            best_value, best_score = float(values[turn, k]), float(scores[turn, k])
            x, y = guess.x + float(shifts[k, 0]), guess.y + float(shifts[k, 1])
            best = Pose2(x, y, wrap_angle(guess.theta + float(angles[turn])))
    return Match(best, best_score)


def search_everywhere(
    field: ScoreField, points: NDArray[Any], count: int, step: float, angles: Iterable[float]
) -> list[Match]:
    """The best `count` poses of points (N, 2) anywhere on the field at these angles, best first.

    A correlation by Fourier transform per angle, on the field pooled to cells of about `step`
    metres: no guess is needed, drift of any size does not matter. The poses are good to about a
    step and are at least a metre (or 0.3 rad) from each other; follow with `search` over
    +- a step, or `refine`. Scores are upper bounds, pooled; a pose without any is not returned.
    """
    if not len(points):
        return []
    coarse = field.coarser(max(1, round(step / field.resolution)))
    cell = coarse.resolution
    middle = np.asarray(points).mean(axis=0)
    local = points - middle
    reach = math.ceil(float(np.sqrt((local**2).sum(axis=1)).max()) / cell) + 1
    # periodic, and so wide that what reaches over one end does not meet what is at the other
    shape = tuple(cv2.getOptimalDFTSize(side + 2 * reach) for side in coarse.values.shape)
    walls = np.zeros(shape, dtype=np.float32)
    walls[tuple(map(slice, coarse.values.shape))] = coarse.values
    spectrum = cv2.dft(walls)
    x, y = coarse.origin
    found: list[tuple[float, float, float, float]] = []
    for angle in angles:
        turned = Pose2(0.0, 0.0, angle).apply(local)
        # points in cells that are centred on the middle; those before it come in at the far ends
        columns, rows = np.floor(turned / cell + 0.5).astype(np.intp).T
        cells = (rows % shape[0]) * shape[1] + columns % shape[1]
        picture = np.zeros(shape, dtype=np.float32)
        np.add.at(picture.reshape(-1), cells, 1.0 / (_SCORE_STEP * len(local)))
        both = cv2.mulSpectrums(spectrum, cv2.dft(picture), 0, conjB=True)
        scores = cv2.idft(both, flags=cv2.DFT_REAL_OUTPUT | cv2.DFT_SCALE)
        np.rint(scores, out=scores)  # whole steps: rounding in single precision makes no peaks
        # peaks, which no neighbour passes, the highest first, then by row
        highest = cv2.dilate(scores, np.ones((3, 3), dtype=np.uint8))
        peaks = np.flatnonzero(scores == np.maximum(highest, 1.0))
        worse = -scores.ravel()[peaks]
        if count < len(peaks):  # most are not worth to be put in order
            least = worse <= np.partition(worse, count - 1)[count - 1]
            peaks, worse = peaks[least], worse[least]
        peaks = peaks[np.argsort(worse, kind="stable")[:count]]
        for row, column in (divmod(peak, shape[1]) for peak in peaks.tolist()):
            value = _SCORE_STEP * float(scores[row, column])
            # shifts past the field are negative ones
            row -= shape[0] if row > (shape[0] + coarse.values.shape[0]) // 2 else 0
            column -= shape[1] if column > (shape[1] + coarse.values.shape[1]) // 2 else 0
            found.append((-value, (column + 0.5) * cell + x, (row + 0.5) * cell + y, angle))
    places = (
        (min(1.0, -low), Pose2(x, y, wrap_angle(angle))) for low, x, y, angle in sorted(found)
    )
    return different_places(places, middle, count)


@dataclass(frozen=True, slots=True)
class Prior:
    """Where points may be: about `pose`, with an error of this covariance (3, 3) in the field."""

    pose: Pose2
    covariance: FloatArray

    def angles(self, step_rad: float) -> FloatArray:
        """(A,) headings within three sigmas, `step_rad` apart."""
        reach = min(np.pi, PRIOR_SIGMAS * float(np.sqrt(self.covariance[2, 2])))
        count = math.ceil(reach / step_rad)
        steps = step_rad * np.arange(-count, count + 1)
        return np.asarray(self.pose.theta + steps, dtype=np.float64)


def answers(
    field: ScoreField, points: NDArray[Any], prior: Prior, step_m: float, step_rad: float
) -> list[Match]:
    """The best poses of points (N, 2) on a field that differ, best first, at most `_ANSWERS`.

    Of those within three sigmas of the prior, on the field pooled to cells of about `step_m`: as
    for `search_everywhere`, scores are upper bounds.
    """
    angles = prior.angles(step_rad)
    cells = max(1, round(step_m / field.resolution))
    coarse, coarser = field.coarser(cells), field.coarser(2 * cells)
    reach = PRIOR_SIGMAS**2 * prior.covariance[:2, :2] + step_m**2 * np.eye(2)
    most = math.ceil(math.sqrt(float(reach.diagonal().max())) / coarser.resolution)
    steps = coarser.resolution * np.arange(-most, most + 1)
    shifts = np.column_stack([each.ravel() for each in np.meshgrid(steps, steps)])
    shifts = shifts[within_ellipse(shifts, reach)]
    middle = np.asarray(points, dtype=np.float64).mean(axis=0)
    (x, y), local = prior.pose.apply(middle[None])[0].tolist(), points - middle
    centre = Pose2(x, y, 0.0)
    rough = _lattice_scores(coarser, local[::_SOME], centre, shifts, angles)
    few = max(0, rough.size - _LATTICE_BEST)
    best = (rough >= np.partition(rough, few, axis=None)[few]) & (rough > 0.0)
    around = coarse.resolution * (np.argwhere(np.ones((3, 3))) - 1.0)
    found: list[tuple[float, Pose2]] = []
    for angle, chosen in zip(angles.tolist(), best, strict=True):
        if chosen.any():
            near = np.unique((shifts[chosen, None] + around).reshape(-1, 2), axis=0)
            placed = near[:, None] + centre._replace(theta=angle).apply(local)
            values = coarse.at(placed.reshape(-1, 2)).reshape(len(near), -1)
            scores = values.mean(axis=1, dtype=np.float64)
            found += [
                (score, Pose2(x + across, y + along, wrap_angle(angle)))
                for score, (across, along) in zip(scores.tolist(), near.tolist(), strict=True)
            ]
    places = sorted(found, key=lambda place: -place[0])[:_LATTICE_BEST]
    return different_places(places, middle, _ANSWERS)


def within_ellipse(away: FloatArray, covariance: FloatArray) -> BoolArray:
    """(N,) whether vectors (N, 2) end inside the ellipse of a covariance (2, 2)."""
    (a, b), (_, c) = covariance.tolist()
    x, y = away[:, 0], away[:, 1]
    return np.asarray(c * x * x - 2.0 * b * x * y + a * y * y <= a * c - b * b)


def different_places(
    found: Iterable[tuple[float, Pose2]], middle: FloatArray, count: int
) -> list[Match]:
    """Of scores and poses of the `middle` (2,) of some points, the first `count` that differ.

    Two are different answers from `_APART_M` or `_APART_RAD` on. A match is told of the points.
    """
    back = Pose2(-float(middle[0]), -float(middle[1]), 0.0)
    centres: list[Pose2] = []
    kept: list[Match] = []
    for score, centre in found:
        if all(
            math.hypot(centre.x - other.x, centre.y - other.y) >= _APART_M
            or abs(wrap_angle(centre.theta - other.theta)) >= _APART_RAD
            for other in centres
        ):
            centres.append(centre)
            kept.append(Match(centre @ back, score))
        if len(kept) == count:
            break
    return kept


def refine(
    field: ScoreField,
    points: NDArray[Any],
    guess: Pose2,
    iterations: int = REFINE_ITERATIONS,
    max_shift_m: float = REFINE_SHIFT_M,
) -> Match:
    """The pose near `guess` at which the interpolated field fits points (N, 2) best.

    Gauss-Newton on sum (1 - M(p))^2. Never farther than `max_shift_m` from the guess, never
    with a larger sum than there. With fewer than three points it is the guess.
    """
    pose = descend(field, points, guess, iterations, max_shift_m)
    return Match(pose, field.score(points, pose))


def covariance(field: ScoreField, points: NDArray[Any], pose: Pose2) -> FloatArray:
    """Covariance (3, 3) of a match, of the score surface around `pose` (Olson 2009, section III).

    Poses on a lattice of +-`SPREAD_M` and +-`SPREAD_RAD` are weighted by
    exp((score - best) / `SPREAD_TEMPERATURE`): a corridor comes out long along its axis.
    Coordinates are x, y and theta of the pose in the field's frame.
    """
    window = Window(
        distance_m=SPREAD_M,
        angle_rad=SPREAD_RAD,
        step_m=max(SPREAD_M / _SPREAD_STEPS, field.resolution),
        angle_step_rad=SPREAD_RAD / _SPREAD_STEPS,
    )
    shifts, angles = _lattice(points, window, field.resolution)
    poses = np.column_stack([np.tile(shifts, (len(angles), 1)), np.repeat(angles, len(shifts))])
    scores = _lattice_scores(field, points, pose, shifts, angles).ravel()
    below = ((scores - scores.max()) / SPREAD_TEMPERATURE).tolist()
    weights = np.array([math.exp(each) for each in below])  # NumPy's exp depends on the processor
    weights /= weights.sum()
    centred = poses - (weights[:, None] * poses).sum(axis=0)
    return product((centred * weights[:, None]).T, centred)


def _lattice(
    points: NDArray[Any], window: Window, resolution: float
) -> tuple[FloatArray, FloatArray]:
    """Shifts (S, 2), whole cells, and angles (A,) of a window, those nearest the guess first."""
    stride = max(1, round(window.step_m / resolution))
    n = math.ceil(window.distance_m / (stride * resolution) - _SLACK)
    x, y = np.meshgrid(np.arange(-n, n + 1), np.arange(-n, n + 1))
    cells = np.column_stack([x.ravel(), y.ravel()])
    cells = cells[np.argsort((cells**2).sum(axis=1), kind="stable")]
    shifts = np.asarray(cells * (stride * resolution), dtype=np.float64)
    turn = window.angle_step_rad
    if turn is None:  # the one that moves the point at four fifths of the ranges by a step
        far = float(np.percentile(np.sqrt((np.asarray(points) ** 2).sum(axis=1)), _FAR_PERCENTILE))
        turn = min(_MOST_TURN_RAD, max(_LEAST_TURN_RAD, window.step_m / max(far, _SLACK)))
    m = math.ceil(window.angle_rad / turn - _SLACK)
    spacing = window.angle_rad / max(m, 1)
    angles = np.array([0.0] + [s * k * spacing for k in range(1, m + 1) for s in (-1, 1)])
    return shifts, angles


def _lattice_scores(
    field: ScoreField, points: NDArray[Any], guess: Pose2, shifts: FloatArray, angles: FloatArray
) -> FloatArray:
    """The scores (A, S) of points (N, 2) at the guess turned by each angle and shifted.

    Shifts lie on a lattice; points are looked up at all of its square, which gathers rows at once.
    """
    offsets = np.round(shifts / field.resolution).astype(np.intp)
    reach, stride = int(np.abs(offsets).max(initial=0)), max(1, int(np.gcd.reduce(offsets.ravel())))
    column, row = ((offsets + reach) // stride).T
    border = 2 * reach + 1
    # what points may touch at any angle: columns and rows, one at least; the last is excluded
    size = np.array(field.values.shape[::-1])
    far = float(np.sqrt((np.asarray(points) ** 2).sum(axis=1)).max(initial=0.0))
    middle = (np.array([guess.x, guess.y]) - field.origin) / field.resolution
    around = far / field.resolution + reach + 2
    low = np.clip(np.floor(middle - around), 0, size - 1).astype(np.int64)
    high = np.clip(np.ceil(middle + around), low + 1, size).astype(np.int64)
    padded = cv2.copyMakeBorder(
        field.values[low[1] : high[1], low[0] : high[0]],
        *(border, border, border, border),
        cv2.BORDER_CONSTANT,
        value=0.0,
    )
    # by the first row and column of each window: its values at all shifts
    windows = sliding_window_view(padded, (2 * reach + 1,) * 2)[:, :, ::stride, ::stride]
    corner = np.asarray(field.origin) - border * field.resolution
    turned = np.tile([guess.x, guess.y, guess.theta], (len(angles), 1))
    turned[:, 2] += angles
    placed = apply_each(turned, [points] * len(angles))
    cells = ((placed - corner) / field.resolution).astype(np.intp) - low - reach
    # a point too far outside to be shifted onto the field waits on the border of noughts
    cells = np.minimum(np.maximum(cells, 0), np.array(windows.shape[1::-1]) - 1)
    columns, rows = np.moveaxis(cells.reshape(len(angles), len(points), 2), 2, 0)
    scores = np.empty((len(angles), len(shifts)))
    many = max(1, _GATHERED // (len(points) * windows[0, 0].size))  # angles at a time
    for first in range(0, len(angles), many):
        some = slice(first, first + many)
        sums = windows[rows[some], columns[some]].sum(axis=1, dtype=np.float64)
        scores[some] = sums[:, row, column]
    return scores / len(points)


def observability(points: FloatArray, range_noise_m: float) -> FloatArray:
    """Fisher information (3, 3) of a scan's own pose, from points (N, 2) in order of bearing.

    Sum of J^T J / sigma^2 with J = (n, p x n) for the surface normal n at p and the error sigma of
    a range (Censi, "On achievable accuracy for range-finder localization", ICRA 2007). Points
    without a neighbour on either side within reach of one surface say nothing.
    """
    if len(points) < 3:
        return np.zeros((3, 3))
    tangent = points[2:] - points[:-2]
    length = np.hypot(tangent[:, 0], tangent[:, 1])
    good = (length > _DISTINCT_M) & (length < 2 * SURFACE_GAP_M)
    tangent = tangent[good] / length[good, None]
    normal = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    p = points[1:-1][good]
    rows = np.column_stack([normal, p[:, 0] * normal[:, 1] - p[:, 1] * normal[:, 0]])
    return product(rows.T, rows) / range_noise_m**2


@dataclass(frozen=True, slots=True)
class Weakest:
    """The direction in which walls fix a place least: `heading`, in the frame of their points.

    As many points as `count` fix it in that direction, turned to it in full; noise is taken off. Of
    walls of n points all alike around it is n / 2, and 0 along a bare corridor. `open`: nothing but
    noise fixes it. `fisher` (3, 3) is what the walls tell of a pose, a point's worth for each piece
    of wall, as neighbours err alike, and nothing in a direction that is open.
    """

    heading: float
    count: float
    open: bool = True
    fisher: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))

    def precision_m(self, range_noise_m: float) -> float:
        """The standard deviation of the place in that direction, from the error of a reading."""
        return range_noise_m / math.sqrt(max(self.count, _SLACK))


def weakest_direction(points: FloatArray, known: FloatArray | None = None) -> Weakest:
    """Of points (N, 2) in order of bearing, which count as much as they are `known` (N,).

    From the normals of the surfaces (Censi, "On achievable accuracy for range-finder localization",
    ICRA 2007), smoothed over some decimetres: the noise of single readings turns the normals of
    dense points so much that a bare corridor would seem to have ends. What noise they are seen to
    have is taken off, twice.
    """
    if len(points) < _FEWEST_SURFACES:
        return Weakest(0.0, 0.0)
    steps = np.hypot(*np.diff(points, axis=0).T)
    apart = np.where(steps < _SMOOTHED_GAP_M, steps, 2.0 * _SMOOTHED_GAP_M)
    piece = np.floor(np.concatenate([[0.0], np.cumsum(apart)]) / _PIECE_M)
    _, start, count = np.unique(piece, return_index=True, return_counts=True)
    smooth = np.add.reduceat(points, start, axis=0) / count[:, None]
    worth = count.astype(np.float64) if known is None else np.add.reduceat(known, start)
    tangent = smooth[2:] - smooth[:-2]
    length = np.hypot(tangent[:, 0], tangent[:, 1])
    good = (length > _DISTINCT_M) & (length < 2 * _SMOOTHED_GAP_M)  # neighbours on one surface
    if np.count_nonzero(good) < _FEWEST_SURFACES:
        return Weakest(0.0, 0.0)
    length, tangent = length[good], tangent[good] / length[good, None]
    normals = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    places, counts = smooth[1:-1][good], worth[1:-1][good]
    # how far pieces lie off the line between their neighbours tells how far these turn the normals
    off = np.abs((((smooth[2:] + smooth[:-2])[good] / 2 - places) * normals).sum(axis=1))
    turned = _TURNED * float(np.median(off)) / length
    noise = _LEAST_NOISE * counts.sum() + float(counts @ (turned * turned))
    noise = min(noise, _MOST_NOISE * float(counts.sum()))
    turns = places[:, 0] * normals[:, 1] - places[:, 1] * normals[:, 0]
    rows = np.column_stack([normals, turns])
    heading, middle, half = _weakest(np.einsum("na,n,nb->ab", rows, counts, rows))
    is_open = middle - half < _MOST_NOISE * 2.0 * middle
    fisher = np.einsum("na,n,nb->ab", rows, counts / count[1:-1][good], rows)
    along, most, less = _weakest(fisher)
    way = np.array([math.cos(along), math.sin(along), 0.0])
    if most - less < _MOST_NOISE * 2.0 * most:
        fisher -= (most - less) * np.outer(way, way)
    return Weakest(heading, max(0.0, middle - half - noise), is_open, fisher)


def _weakest(fisher: FloatArray) -> tuple[float, float, float]:
    """The direction in which a place is known least, whatever the heading.

    Also what is known of a place in the mean of all directions, and how much less it is there.
    """
    arm, moment = fisher[:2, 2], float(fisher[2, 2])
    place = fisher[:2, :2] - np.outer(arm, arm) / moment if moment > 0.0 else fisher[:2, :2]
    (xx, xy), (_, yy) = place.tolist()
    middle, half = 0.5 * (xx + yy), math.hypot(0.5 * (xx - yy), xy)
    heading = 0.5 * math.atan2(2.0 * xy, xx - yy) + 0.5 * math.pi  # across the strongest one
    return heading, middle, half
