"""One map laid on another by its walls, and a map on itself, without the program's own matching.

Real recordings have no true poses. But the walls of two sessions in one building are the same
walls. So the one map is laid on the other: as a whole, by a search over all turns and shifts, and
then view by view, each from where the one before was found, or from the best place near there.
What comes out is good to some centimetres where walls show it, and follows a map that is bent.
Where a view fits as well half a metre on, as along a bare corridor, nothing is said. A view is what
the robot saw along a few metres of its way.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from scipy import fft
from scipy.spatial import cKDTree

from specmap_cli.core.geometry import FloatArray, Pose2, travelled
from specmap_cli.core.records import IntArray
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.maps.store import Map

_FINE_M, _VIEW_M = 0.02, 0.05  # cells that keep one point: of walls, of a view
_NEIGHBOURS, _AROUND_M = 12, 0.25  # points that tell which way a wall runs
_FAR_M = 40.0  # returns beyond are left out
_GATES_M = (1.0, 0.5, 0.3, 0.15, 0.1)  # a return and its wall, in turn
_NEAR_GATES_M = _GATES_M[1:]
_ON_M = 0.1  # a return lies on a wall
_MOST_VIEWS = 20  # scans in a view
_SPACING = 0.25  # metres, or radians, between views
_LEAST = 20  # returns, to lay a view
_DETOUR = 1.5  # of a straight line, from which on a way there is another pass
FITS = 0.5  # share of a view on walls: it was laid rightly
_SURE = 0.7  # from which on it is looked for nowhere else
_BENT_M, _BENT_DEG = 3.0, 10.0  # of a map between two views: a bare hallway, no odometry
_SLID_M = 0.5  # a pose that far off is wrong
_HELD = 0.05  # share of a view that walls must lose when it is slid so far, to hold it there


class Walls:
    """Points (n, 2) of walls, and which way they run there."""

    def __init__(self, points: FloatArray) -> None:
        cells = np.unique(np.floor(points / _FINE_M).astype(np.int64), axis=0)
        self.points = (cells + 0.5) * _FINE_M
        self.tree = cKDTree(self.points)

    @cached_property
    def normals(self) -> FloatArray:
        """(n, 2) across the wall at each point."""
        away, near = self.tree.query(self.points, k=_NEIGHBOURS, distance_upper_bound=_AROUND_M)
        near = np.where(np.isfinite(away), near, np.arange(len(near))[:, None])
        spread = self.points[near] - self.points[near].mean(axis=1, keepdims=True)
        _, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", spread, spread))
        return np.asarray(axes[:, :, 0])

    def share_on(self, points: FloatArray, reach_m: float = _ON_M) -> float:
        """The share of points (n, 2) that lie on a wall."""
        away, _ = self.tree.query(points, distance_upper_bound=reach_m)
        return float(np.isfinite(away).mean()) if len(points) else 0.0


@dataclass(frozen=True, slots=True)
class Laid:
    """Where a view lies, and the share of it that lies on walls there."""

    pose: Pose2
    share: float


def lay(
    view: FloatArray, walls: Walls, guess: Pose2, gates_m: tuple[float, ...] = _GATES_M
) -> Laid:
    """A view (n, 2) laid on walls from a guess: point to line, robustly, by Gauss and Newton."""
    pose = guess
    for gate in gates_m:
        for _ in range(6):
            at = pose.apply(view)
            away, nearest = walls.tree.query(at, distance_upper_bound=gate)
            near = np.isfinite(away)
            if near.sum() < _LEAST:
                return Laid(pose, 0.0)
            normals, at = walls.normals[nearest[near]], at[near]
            off = ((walls.points[nearest[near]] - at) * normals).sum(axis=1)
            arm = at - (pose.x, pose.y)
            turn = arm[:, 0] * normals[:, 1] - arm[:, 1] * normals[:, 0]
            jacobian = np.column_stack([normals, turn])
            weight = 1.0 / (1.0 + (off / (gate / 3)) ** 2)
            normal = (jacobian * weight[:, None]).T @ jacobian + 1e-3 * len(off) * np.eye(3)
            step = np.linalg.solve(normal, (jacobian * weight[:, None]).T @ off)
            pose = Pose2(pose.x + step[0], pose.y + step[1], pose.theta + step[2])
            if math.hypot(step[0], step[1]) < 1e-4 and abs(step[2]) < 1e-5:
                break
    return Laid(pose, walls.share_on(pose.apply(view)))


def search(
    view: FloatArray,
    walls: Walls,
    guess: Pose2 | None = None,
    *,
    reach_m: float = math.inf,
    turn_deg: float = 180.0,
    cell_m: float = 0.1,
    step_deg: float = 2.0,
) -> Pose2:
    """The motion that lays most of a view on walls, of all turns and shifts within reach."""
    start = guess or Pose2(0.0, 0.0, 0.0)
    low = walls.points.min(axis=0) - 1.0
    size = np.ceil((walls.points.max(axis=0) + 1.0 - low) / cell_m).astype(int)
    field = np.zeros(size[::-1], dtype=np.float32)
    field[tuple(np.floor((walls.points - low) / cell_m).astype(int).T[::-1])] = 1.0
    field = cv2.GaussianBlur(field, (0, 0), 1.2)
    radius = float(np.hypot(*view.T).max()) + cell_m
    side = int(2 * radius / cell_m) + 2
    shape = [fft.next_fast_len(length + side) for length in field.shape]
    spectrum = fft.rfft2(field, shape)
    best, found = -1.0, start
    for turn in np.arange(-turn_deg, turn_deg, step_deg):
        theta = start.theta + math.radians(turn)
        cells = np.floor((Pose2(0.0, 0.0, theta).apply(view) + radius) / cell_m).astype(int)
        other = np.zeros((side, side), dtype=np.float32)
        other[tuple(cells.T[::-1])] = 1.0
        fits = fft.irfft2(spectrum * np.conj(fft.rfft2(other, shape)), shape)
        rows, columns = (
            np.where(np.arange(n) < m, np.arange(n), np.arange(n) - n)
            for n, m in zip(shape, field.shape, strict=True)
        )
        x, y = low[0] + columns * cell_m + radius, low[1] + rows * cell_m + radius
        if math.isfinite(reach_m):
            fits[np.abs(y - start.y) > reach_m] = 0.0
            fits[:, np.abs(x - start.x) > reach_m] = 0.0
        at = np.unravel_index(int(fits.argmax()), fits.shape)
        if fits[at] > best:
            best, found = float(fits[at]), Pose2(float(x[at[1]]), float(y[at[0]]), theta)
    return found


class Seen:
    """The keyframes of a map: their poses and what each saw."""

    def __init__(self, stored: Map) -> None:
        self.stored = stored
        self.poses = stored.labels.poses
        self.stamps_ns: IntArray = stored.labels.stamps_ns
        self.way_m = travelled(self.poses)
        with stored.scans() as store:
            self._hits = [_hits(store, number) for number in range(len(store))]

    def walls(self, rows: IntArray | None = None) -> FloatArray:
        """(n, 2) all that some keyframes saw, in the map; of all of them by default."""
        chosen = range(len(self.poses)) if rows is None else rows.tolist()
        placed = [Pose2(*self.poses[k]).apply(self._hits[k]) for k in chosen]
        return np.concatenate(placed) if placed else np.zeros((0, 2))

    def view(self, k: int, reach_m: float = 1.5) -> FloatArray:
        """(n, 2) what was seen along the way around keyframe `k`, in its frame."""
        rows = np.flatnonzero(np.abs(self.way_m - self.way_m[k]) <= reach_m)
        if len(rows) > _MOST_VIEWS:
            rows = rows[np.linspace(0, len(rows) - 1, _MOST_VIEWS).astype(int)]
        return thinned(Pose2(*self.poses[k]).inverse().apply(self.walls(rows)), _VIEW_M)


def _hits(store: KeyframeStore, number: int) -> FloatArray:
    scan = store.scan(number)
    hits = scan.hits(min(0.99 * scan.range_max, _FAR_M))
    return store.base_from_laser(number).apply(thinned(hits, _FINE_M))


def thinned(points: FloatArray, cell_m: float) -> FloatArray:
    """One of the points (n, 2) in each cell."""
    _, first = np.unique(np.floor(points / cell_m).astype(np.int64), axis=0, return_index=True)
    return points[np.sort(first)]


def whole(there: Seen, here: Seen) -> Laid:
    """Where the map `here` lies in the map `there`, and the share of its walls that fits."""
    walls, own = Walls(there.walls()), thinned(here.walls(), 0.1)
    return lay(own, walls, search(own, walls))


@dataclass(frozen=True, slots=True)
class Placed:
    """Keyframes of one session as they lie on the walls of another.

    `rows` (n,) are the keyframes that were looked at, one every quarter of a metre; `poses` (n, 3)
    theirs, NaN where the view does not fit or walls do not hold it in all directions; `off_m` (n,)
    from where the rigid motion of the whole map puts them, `off_deg` (n,) the same in degrees: how
    much the two maps differ.
    """

    whole: Laid
    rows: IntArray
    poses: FloatArray
    off_m: FloatArray
    off_deg: FloatArray

    @property
    def known(self) -> np.ndarray:
        """(n,) whether a keyframe that was looked at was placed."""
        return np.asarray(np.isfinite(self.poses[:, 0]))


def placed(there: Seen, here: Seen) -> Placed:
    """Keyframes of `here` laid on the walls of `there`, each from the one before."""
    base, walls = whole(there, here), Walls(there.walls())
    rows = spaced(here.poses)
    poses, off = np.full((len(rows), 3), np.nan), np.full((len(rows), 2), np.nan)
    last: tuple[Pose2, Pose2] | None = None  # its pose here and there
    for k, row in enumerate(rows.tolist()):
        own = Pose2(*here.poses[row].tolist())
        guess = base.pose @ own if last is None else last[1] @ last[0].inverse() @ own
        view = here.view(row)
        laid = lay(view, walls, guess, _NEAR_GATES_M)
        if laid.share < _SURE:
            found = search(view, walls, guess, reach_m=_BENT_M, turn_deg=_BENT_DEG)
            laid = max(laid, lay(view, walls, found, _NEAR_GATES_M), key=lambda one: one.share)
        if laid.share >= FITS and held(view, walls, laid):
            last, poses[k] = (own, laid.pose), laid.pose
            moved = (base.pose @ own).inverse() @ laid.pose
            off[k] = moved.distance, abs(math.degrees(moved.theta))
    return Placed(base, rows, poses, off[:, 0], off[:, 1])


def held(view: FloatArray, walls: Walls, laid: Laid) -> bool:
    """Whether a view fits worse half a metre on, whichever way: else its place is not known."""
    at = laid.pose.apply(view)
    ways = np.arange(0.0, 2 * np.pi, np.pi / 8)
    slid = (walls.share_on(at + _SLID_M * np.array([np.cos(w), np.sin(w)])) for w in ways)
    return max(slid) <= laid.share - _HELD


def spaced(poses: FloatArray) -> IntArray:
    """Which of the poses (n, 3) to look at: one after each quarter of a metre or of a radian."""
    chosen, last = [0], poses[0]
    for k, pose in enumerate(poses):
        step = np.abs(pose - last)
        if math.hypot(step[0], step[1]) >= _SPACING or step[2] >= _SPACING:
            chosen.append(k)
            last = pose
    return np.array(chosen)


@dataclass(frozen=True, slots=True)
class Pass:
    """A place that the robot came through twice: how far the second pass lies off the first.

    `gain` is by how much more of the view lies on the walls of the other passes when it is moved
    so: little where the map is right.
    """

    way_m: float
    off_m: float
    off_deg: float
    gain: float

    @property
    def is_doubled(self) -> bool:
        """Whether walls stand twice there."""
        return self.gain >= 0.1 and (self.off_m > 0.2 or self.off_deg > 5.0)


def passes(
    seen: Seen, *, apart_m: float = 10.0, view_m: float = 2.0, most: int = 40
) -> Iterator[Pass]:
    """Views along the way, each laid on what was seen on another pass, so many metres of way apart.

    It is another pass where the way there is half as long again as the straight line: on one pass
    walls are in sight from afar, and facades and rows of trees look like themselves.
    A second pass is looked for within a fiftieth of the whole way: farther no map drifts that holds
    together at all, and farther off a corridor looks like itself.
    """
    drift_m = max(0.5, 0.02 * float(seen.way_m[-1]))
    every = max(1.0, seen.way_m[-1] / most)
    for k in np.flatnonzero(np.diff(np.floor(seen.way_m / every), prepend=-1.0) > 0).tolist():
        view = seen.view(k, view_m)
        reach = float(np.abs(view).max()) + drift_m if len(view) else 0.0
        away = np.hypot(*(seen.poses[:, :2] - seen.poses[k, :2]).T)
        near = np.abs(seen.poses[:, :2] - seen.poses[k, :2]).max(axis=1) < 2 * reach
        others = np.abs(seen.way_m - seen.way_m[k]) > np.maximum(apart_m, _DETOUR * away)
        other = seen.walls(np.flatnonzero(near & others))
        pose = Pose2(*seen.poses[k])
        other = other[np.abs(other - (pose.x, pose.y)).max(axis=1) < reach]
        if len(other) < 10 * _LEAST or len(view) < _LEAST:
            continue
        walls = Walls(other)
        here = walls.share_on(pose.apply(view))
        found = max(
            (
                lay(view, walls, guess)
                for guess in (pose, search(view, walls, pose, reach_m=drift_m, turn_deg=20.0))
            ),
            key=lambda one: one.share,
        )
        if found.share >= FITS:
            moved = pose.inverse() @ found.pose
            turned = abs(math.degrees(math.remainder(moved.theta, 2 * math.pi)))
            yield Pass(float(seen.way_m[k]), moved.distance, turned, found.share - here)
