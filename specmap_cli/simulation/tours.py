"""Tours: a path through all the space a robot can reach, and how it is driven.

Targets are spread over the reachable space, ordered by nearest neighbour and 2-opt, joined by the
shortest paths on a lattice that prefers to keep away from walls, and smoothed. The drive limits
speed, acceleration and turn rate, and turns in place at sharp corners.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components, dijkstra, shortest_path

from specmap_cli.core.errors import MapError
from specmap_cli.core.geometry import FloatArray, step_lengths, travelled, wrap_angles
from specmap_cli.simulation.worlds import World

IndexArray = NDArray[np.intp]

_LATTICE_M = 0.1  # distance of the lattice's nodes: passages show, and a building is searched
_WALL_COST = 4.0  # a metre that touches a wall counts as 1 + this, so that doors are crossed midway
_STEP_M = 0.05  # distance of the path's points: a corner's bend takes several of them
_SMOOTHINGS = 60  # passes over the path; they round corners over some 0.5 m
_LEAST_GAIN_M = 1e-9  # what a reversal must shorten the tour by; less is rounding
_REVERSALS_PER_TARGET = 20  # no more; tours need one or two

_SHARP_RAD = 0.35  # 20 degrees: the robot stops and turns at sharper corners, and rounds others
_TURN_STEP_RAD = 0.1  # a turn in place is told by poses this far apart
# The ease-in, ease-out curve 3 s^2 - 2 s^3 of a turn in place is steepest in its middle: 1.5.
_EASE_PEAK = 1.5
_TINY = 1e-9  # metres, radians or metres a second that count as none


@dataclass(frozen=True, slots=True)
class Lattice:
    """The space that a disc of `radius_m` can reach, as a graph of nodes `points` (n, 2).

    `lengths` and `costs` (n, n) hold the metres between neighbours, and more of them near walls;
    `comfort` (n,) in [0, 1] is how far a node is from walls: 0 at one, 1 where more is no better.
    """

    points: FloatArray
    comfort: FloatArray
    lengths: csr_matrix
    costs: csr_matrix
    area_m2: float
    radius_m: float


def reachable_space(world: World, radius_m: float, comfort_m: float) -> Lattice:
    """The largest connected part of the plan in which a disc of `radius_m` fits.

    From `comfort_m` on, farther from a wall is no better. Raises MapError when the disc fits
    nowhere.
    """
    stride = max(1, round(_LATTICE_M / world.plan.resolution))
    rows, columns = (np.arange(stride // 2, side, stride) for side in world.plan.cells.shape)
    cells = np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1)
    centres = world.plan.centres_of(cells.reshape(-1, 2))
    clearance = world.clearance_at(centres)
    open_ = clearance >= radius_m
    if not open_.any():
        raise MapError(
            f"the plan has no free space for a robot of radius {radius_m:g} m",
            "check its resolution and that free space is white",
        )
    number = np.where(open_, np.cumsum(open_) - 1, -1).reshape(len(rows), len(columns))
    spacing = stride * world.plan.resolution
    # metres between the eight neighbours of each node
    sources, targets, metres = [], [], []
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        a = number[: len(rows) - down, max(-right, 0) : len(columns) - max(right, 0)]
        b = number[down:, max(right, 0) : len(columns) - max(-right, 0)]
        both = (a >= 0) & (b >= 0)
        sources.append(a[both])
        targets.append(b[both])
        metres.append(np.full(len(sources[-1]), spacing * math.hypot(down, right)))
    ends = np.concatenate(sources), np.concatenate(targets)
    count = int(number.max()) + 1
    half = csr_matrix((np.concatenate(metres), ends), shape=(count, count))
    lengths = csr_matrix(half + half.T)
    _, part = connected_components(lengths, directed=False)
    kept = np.flatnonzero(part == np.bincount(part).argmax())
    comfort = np.minimum(clearance[open_][kept] / comfort_m, 1.0)
    lengths = csr_matrix(lengths[kept][:, kept])
    # up to 1 + `_WALL_COST` times as much along walls
    edges, near_wall = lengths.tocoo(), (1.0 - comfort) ** 2
    dearer = 1.0 + _WALL_COST * 0.5 * (near_wall[edges.row] + near_wall[edges.col])
    costs = csr_matrix((edges.data * dearer, (edges.row, edges.col)), shape=lengths.shape)
    return Lattice(
        points=centres[open_][kept],
        comfort=comfort,
        lengths=lengths,
        costs=costs,
        area_m2=len(kept) * spacing**2,
        radius_m=radius_m,
    )


def plan_tour(
    world: World, lattice: Lattice, spacing_m: float, laps: int, rng: np.random.Generator
) -> FloatArray:
    """A path (N, 2) that comes within about `spacing_m` of every reachable point in each lap.

    `rng` draws the start and each lap's targets, so that every lap and every seed is a new path.
    Each lap starts where the one before ended.
    """
    here = int(rng.choice(len(lattice.points), p=_preference(lattice, np.inf)))
    nodes = [np.array([here])]
    for _ in range(laps):
        # nodes, the last one first, of which one is within `spacing_m` of every node of the lattice
        spread, far = [here], dijkstra(lattice.lengths, indices=here, limit=spacing_m)
        while np.isinf(far).any():
            spread.append(int(rng.choice(len(far), p=_preference(lattice, far))))
            near = dijkstra(lattice.lengths, indices=spread[-1], limit=spacing_m)
            far = np.minimum(far, near)
        targets = np.array(spread, dtype=np.intp)
        distances = _distances(lattice, targets, spacing_m)
        order = shortest_order(distances)
        for a, b in pairwise(order):
            # the cheapest way; the same sum in another order may be a little more
            source, limit = int(targets[a]), distances[a, b] * (1.0 + 1e-9) + 1e-9
            tree = dijkstra(lattice.costs, indices=source, limit=limit, return_predecessors=True)
            way = [int(targets[b])]
            while way[-1] != source:
                way.append(int(tree[1][way[-1]]))
            nodes.append(np.array(way[-2::-1], dtype=np.intp))
        here = int(targets[order[-1]])
    # without the lattice's corners; no point moves to where the robot does not fit
    points = _resample(lattice.points[np.concatenate(nodes)])
    for _ in range(_SMOOTHINGS):
        moved = points.copy()
        moved[1:-1] = 0.25 * points[:-2] + 0.5 * points[1:-1] + 0.25 * points[2:]
        fits = world.clearance_at(moved) >= lattice.radius_m
        points[fits] = moved[fits]
    return _resample(points)


def _preference(lattice: Lattice, distance: Any) -> FloatArray:
    """(n,) probability of each node as a target: none where covered, more away from walls."""
    weight = np.where(np.isinf(distance), lattice.comfort**2, 0.0)
    return np.asarray(weight / weight.sum(), dtype=np.float64)


def _distances(lattice: Lattice, targets: IndexArray, spacing_m: float) -> FloatArray:
    """Costs (t, t) between targets by way of neighbours within 2.5 spacings, which join all."""
    limit = 2.5 * spacing_m * (1.0 + _WALL_COST)
    n = len(targets)
    near = np.zeros((n, n))
    for row, target in enumerate(targets):
        reached = dijkstra(lattice.costs, indices=target, limit=limit)[targets]
        near[row] = np.where(np.isfinite(reached), reached, 0.0)
    return np.asarray(shortest_path(csr_matrix(near), directed=False), dtype=np.float64)


def shortest_order(distances: FloatArray) -> IndexArray:
    """An order (t,) of the targets, the first one first: nearest neighbour, then 2-opt."""
    n = len(distances)
    order = [0]
    left = np.ones(n, dtype=bool)
    left[0] = False
    while left.any():
        order.append(int(np.where(left, distances[order[-1]], np.inf).argmin()))
        left[order[-1]] = False
    tour = np.array(order, dtype=np.intp)
    for _ in range(_REVERSALS_PER_TARGET * n if n > 2 else 0):
        # what the reversal of each stretch of the open tour shortens it by
        before, inner = tour[:-1], tour[1:]
        step = distances[before, inner]
        after_step = np.append(step[1:], 0.0)  # the last stretch has nothing behind it
        joined = np.zeros((n - 1, n - 1))
        joined[:, :-1] = distances[np.ix_(inner, inner[1:])]
        gain = step[:, None] + after_step[None, :] - distances[np.ix_(before, inner)] - joined
        gain[np.tril_indices(n - 1)] = 0.0
        first, last = np.unravel_index(int(gain.argmax()), gain.shape)
        if gain[first, last] <= _LEAST_GAIN_M:
            break
        inner[first : last + 1] = inner[first : last + 1][::-1].copy()
    return tour


def _resample(path: FloatArray) -> FloatArray:
    """The same path with points at equal distances of about `_STEP_M`."""
    at = travelled(path)
    count = max(2, round(at[-1] / _STEP_M) + 1)
    wanted = np.linspace(0.0, at[-1], count)
    return np.column_stack([np.interp(wanted, at, path[:, axis]) for axis in (0, 1)])


@dataclass(frozen=True, slots=True)
class Drive:
    """Poses over time: `times_s` (k,) ascending from 0 and `poses` (k, 3), angles unwrapped."""

    times_s: FloatArray
    poses: FloatArray

    @property
    def duration_s(self) -> float:
        """When the robot arrives."""
        return float(self.times_s[-1])

    def at(self, times_s: NDArray[Any]) -> FloatArray:
        """Poses (..., 3) at any times, the robot standing before the first and after the last."""
        times = np.asarray(times_s, dtype=np.float64)
        columns = [np.interp(times, self.times_s, self.poses[:, axis]) for axis in range(3)]
        return np.stack(columns, axis=-1)


def drive(path: FloatArray, highest: float, turn_rate: float, acceleration: float) -> Drive:
    """Drive along a path (N, 2), N >= 1, as fast as wheels can: m/s, radians/s and m/s^2, above 0.

    From standstill to standstill, with turns in place at sharp corners; one place is a stop.
    """
    path = path[np.concatenate([[True], step_lengths(path) > _TINY])]
    if len(path) < 2:
        return Drive(np.zeros(1), np.array([[path[0, 0], path[0, 1], 0.0]]))
    lengths, steps = step_lengths(path), np.diff(path, axis=0)
    heading = np.arctan2(steps[:, 1], steps[:, 0])
    turns = wrap_angles(np.diff(heading))
    heading = heading[0] + np.concatenate([[0.0], np.cumsum(turns)])
    # an inner corner is reached in the heading in which it is left, unless the robot turns there
    sharp, middle = np.abs(turns) > _SHARP_RAD, heading[:-1] + 0.5 * turns
    reached = np.concatenate([np.where(sharp, heading[:-1], middle), heading[-1:]])
    left = np.concatenate([heading[:1], np.where(sharp, heading[1:], middle)])
    bend = np.abs(reached - left)
    limit = np.minimum(highest, turn_rate * lengths / np.maximum(bend, _TINY))
    corner = np.minimum(limit[:-1], limit[1:])
    speeds = np.concatenate([[0.0], np.where(sharp, 0.0, corner), [0.0]])
    # neither speeding up nor braking passes the acceleration: forwards, then backwards in time
    for ahead, steps in ((speeds, lengths), (speeds[::-1], lengths[::-1])):
        for i, length in enumerate(steps):
            ahead[i + 1] = min(ahead[i + 1], math.sqrt(ahead[i] ** 2 + 2.0 * acceleration * length))
    # from standstill to standstill by way of a peak
    peaked = 2.0 * np.sqrt(lengths / acceleration)
    coasting = lengths / highest + highest / acceleration
    stopped = np.where(lengths * acceleration > highest**2, coasting, peaked)
    both = speeds[:-1] + speeds[1:]
    seconds = np.where(both > 0.0, 2.0 * lengths / np.maximum(both, _TINY), stopped)
    return _knots(path, reached, left, seconds, turn_rate)


def _knots(
    path: FloatArray, reached: FloatArray, left: FloatArray, seconds: FloatArray, turn_rate: float
) -> Drive:
    """The drive through all corners, with eased turns where a corner is left in another heading."""
    times, poses = [np.zeros(1)], [np.array([[*path[0], left[0]]])]
    now = 0.0
    for i, second in enumerate(seconds):
        now += float(second)
        times.append(np.array([now]))
        poses.append(np.array([[*path[i + 1], reached[i]]]))
        turn = float(left[i + 1] - reached[i]) if i + 1 < len(left) else 0.0
        if turn == 0.0:
            continue
        share = np.linspace(0.0, 1.0, math.ceil(abs(turn) / _TURN_STEP_RAD) + 1)[1:]
        eased = share * share * (3.0 - 2.0 * share)
        duration = _EASE_PEAK * abs(turn) / turn_rate
        times.append(now + duration * share)
        still = np.tile(path[i + 1], (len(share), 1))
        poses.append(np.column_stack([still, reached[i] + turn * eased]))
        now += duration
    return Drive(np.concatenate(times), np.concatenate(poses))
