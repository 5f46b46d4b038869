"""Edges between nearby passes: places the robot came by again, matched scan to scan.

A candidate is a pair of nodes that the current layout puts near each other though the path between
them is long. The walls seen around the newer one are matched against those seen around the older,
within what the path may have drifted since the last such edge; an edge is what fits well, with the
covariance of its score surface.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence

import numpy as np

from specmap_cli.core.config import RelaxationConfig
from specmap_cli.core.geometry import FloatArray, Pose2, compose, invert, wrap_angles
from specmap_cli.core.records import IntArray
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.grids.matching import (
    ScoreField,
    Window,
    covariance,
    refine,
    search,
    search_everywhere,
    thinned,
)
from specmap_cli.layout.pose_graph import Link

_CACHED_NODES = 256
_FEWEST_POINTS = 20
_RIVALS, _LEAD = 4, 0.05  # places compared when nothing is known, and by how much to be ahead
_PINNED_M = 0.1  # largest mean deviation of a place found without a guess
_ROUGH_M, _MOST_CELLS = 0.3, 512  # step of the search everywhere, and cells a side at the most
_FLOOR = np.diag([0.015**2, 0.015**2, 0.004**2])  # of a match: cells, moved furniture, people


class Walls:
    """Thinned wall points around nodes, read from the store as needed (a few stay in memory)."""

    def __init__(
        self, store: KeyframeStore, nodes: Sequence[int], config: RelaxationConfig
    ) -> None:
        self._store, self._nodes, self._config = store, nodes, config
        self._cache: OrderedDict[int, FloatArray] = OrderedDict()

    def around(self, node: int, reach: int, poses: FloatArray, part: IntArray) -> FloatArray:
        """Points (N, 2) seen from nodes within `reach` of `node`, in the frame of `node`.

        `poses` (M, 3) place the nodes; only nodes of the same tracked `part` (M,) are used.
        """
        low, high = max(0, node - reach), min(len(self._nodes), node + reach + 1)
        others = [k for k in range(low, high) if part[k] == part[node]]
        relative = compose(invert(poses[node]), poses[others])
        clouds = [
            Pose2(*map(float, pose)).apply(self._points(k))
            for k, pose in zip(others, relative, strict=True)
        ]
        return np.concatenate(clouds)

    def of_all(self, nodes: Sequence[int], poses: FloatArray) -> FloatArray:
        """Points (N, 2) seen from all of `nodes`, in the map, thinned as they are gathered."""
        gathered, fresh = np.zeros((0, 2)), []
        for count, k in enumerate(nodes, start=1):
            fresh.append(Pose2(*poses[k].tolist()).apply(self._points(k)))
            if count % 50 == 0 or count == len(nodes):
                gathered = thinned(np.concatenate([gathered, *fresh]), 0.05)
                fresh = []
        return gathered

    def _points(self, node: int) -> FloatArray:
        """Points of one node in its base frame."""
        if node in self._cache:
            self._cache.move_to_end(node)
            return self._cache[node]
        points = self._store.points(self._nodes[node], self._config.match_range_m)
        self._cache[node] = thinned(points, 0.05)
        if len(self._cache) > _CACHED_NODES:
            self._cache.popitem(last=False)
        return self._cache[node]


def candidates(
    node: int, poses: FloatArray, path: FloatArray, config: RelaxationConfig
) -> list[int]:
    """Older nodes to match `node` with: near it, far along the path, apart from each other."""
    old = np.flatnonzero(path < path[node] - config.loop_path_m)
    if not len(old):
        return []
    away = poses[old, :2] - poses[node, :2]
    distance = np.sqrt((away**2).sum(axis=1))
    turn = np.abs(wrap_angles(poses[old, 2] - poses[node, 2]))
    near = distance < config.loop_radius_m
    old, rank = old[near], (distance + 0.7 * turn)[near]
    chosen: list[int] = []
    for k in old[np.argsort(rank, kind="stable")].tolist():
        if all(abs(path[k] - path[c]) > config.loop_radius_m for c in chosen):
            chosen.append(k)
        if len(chosen) == config.loops_per_node:
            break
    return chosen


def verified(
    source: FloatArray, target: FloatArray, guess: Pose2, drift_m: float, config: RelaxationConfig
) -> tuple[Pose2, FloatArray] | None:
    """The pose of points `source` (N, 2) among `target` (M, 2) and its information, if they fit.

    `guess` and the result are `target_from_source`; `drift_m` bounds how wrong the guess may be.
    """
    field = _field(target, config)
    drift_rad = float(np.clip(0.15 * drift_m, 0.06, 0.35))
    coarse = Window(drift_m, drift_rad, 0.2, None, 0.01, 0.05)
    rough = search(field.coarser(4), thinned(source, 0.25), guess, coarse)
    return _confirmed(field, source, rough.pose, config.loop_score)


def _field(target: FloatArray, config: RelaxationConfig) -> ScoreField:
    return ScoreField.from_points(target, 0.05, 0.1, 4.0 * config.match_range_m)


def _confirmed(
    field: ScoreField, source: FloatArray, rough: Pose2, score: float
) -> tuple[Pose2, FloatArray] | None:
    """A rough pose brought to the optimum, with its information, if `score` is reached there."""
    few = thinned(source, 0.2)
    if len(few) < _FEWEST_POINTS:
        return None
    fine = search(field, few, rough, Window(0.3, 0.09, 0.1))
    near = refine(field, thinned(source, 0.1), fine.pose, 8)
    if near.score < score:
        return None
    pose = refine(field.sharper(), thinned(source, 0.05), near.pose).pose
    spread = covariance(field, few, pose)
    turn = np.eye(3)
    turn[:2, :2] = pose.rotation().T  # errors are weighed in the source's own frame
    information = np.linalg.inv(turn @ spread @ turn.T + _FLOOR)
    return pose, np.asarray(information, dtype=np.float64)


class OlderWalls:
    """The walls of all parts older than `part`, to find a piece of a later part among."""

    def __init__(self, part: int, points: FloatArray, config: RelaxationConfig) -> None:
        self.part, self._points, self._config = part, points, config
        side = 40.0 * config.match_range_m
        self._field = ScoreField.from_points(points, 0.1, 0.1, side)
        area = self._field.values.size * self._field.resolution**2
        self._step = max(_ROUGH_M, float(np.sqrt(area)) / _MOST_CELLS)

    def place_of(self, source: FloatArray) -> tuple[Pose2, FloatArray] | None:
        """The pose of points (N, 2) and its information.

        They must fit well, nowhere else nearly as well, and leave no direction open: in a bare
        corridor nothing is found.
        """
        few = thinned(source, 0.2)
        if len(few) < _FEWEST_POINTS:
            return None
        turn = 0.04 * self._step / _ROUGH_M
        rough = search_everywhere(
            self._field, thinned(source, 0.25), _RIVALS, self._step, min(turn, 0.08)
        )
        window = Window(0.75 * self._step, 0.06, 0.1)
        fine = [search(self._field, few, match.pose, window) for match in rough]
        fine.sort(key=lambda match: -match.score)
        if not fine or (len(fine) > 1 and fine[1].score > fine[0].score - _LEAD):
            return None
        pose = fine[0].pose
        away = self._points - (pose.x, pose.y)
        near = np.hypot(away[:, 0], away[:, 1]) < 2.0 * self._config.match_range_m
        field = _field(self._points[near], self._config)
        found = _confirmed(field, source, pose, 0.5 + 0.5 * self._config.loop_score)
        if found is None or np.linalg.inv(found[1])[:2, :2].trace() > 2 * _PINNED_M**2:
            return None
        return found


class NearbyPasses:
    """Finds edges between nearby passes, node by node along the path."""

    def __init__(
        self,
        walls: Walls,
        nodes: Sequence[int],
        path: FloatArray,
        part: IntArray,
        config: RelaxationConfig,
    ) -> None:
        self._walls, self._nodes, self._path, self._part = walls, nodes, path, part
        self._config = config
        self._tried: dict[tuple[int, int], Pose2] = {}
        self._tied_parts = {0}
        self._older: OlderWalls | None = None
        self._tries: dict[int, int] = {}

    def links(self, node: int, poses: FloatArray, drift_m: float) -> list[Link]:
        """The edges from older nodes to `node` that could be verified at the poses (M, 3)."""
        found = []
        for old in candidates(node, poses, self._path, self._config):
            guess = Pose2(*compose(invert(poses[old]), poses[node]).tolist())
            if not self._fresh(old, node, guess):
                continue
            source, target = self._around(node, old, poses)
            match = verified(source, target, guess, drift_m, self._config)
            if match is not None:
                found.append(Link(self._nodes[old], self._nodes[node], *match, "nearby"))
        return found

    def links_of_stray(self, node: int, poses: FloatArray) -> list[Link]:
        """Edges to `node` of a part joined by a guess only: no pose is trusted, the fit must be.

        Its walls are looked for among those of all older parts, at any angle.
        """
        part = int(self._part[node])
        if self._tries.get(part, 0) >= self._config.stray_tries:
            return []
        self._tries[part] = self._tries.get(part, 0) + 1
        old = np.flatnonzero(self._part < part)
        if self._older is None or self._older.part != part:
            self._older = OlderWalls(part, self._walls.of_all(old.tolist(), poses), self._config)
        source = self._walls.around(node, 8, poses, self._part)
        match = self._older.place_of(source)
        if match is None:
            return []
        pose, information = match
        away = np.hypot(poses[old, 0] - pose.x, poses[old, 1] - pose.y)
        nearest = int(old[np.argmin(away)])
        relative = Pose2(*compose(invert(poses[nearest]), np.array(pose)).tolist())
        return [Link(self._nodes[nearest], self._nodes[node], relative, information, "nearby")]

    def tie(self, part: int) -> None:
        """Note that the poses of a part can be trusted to some metres."""
        self._tied_parts.add(part)

    def is_stray(self, node: int) -> bool:
        """Whether the part of a node hangs on the others by a guess only."""
        return int(self._part[node]) not in self._tied_parts

    def _around(self, node: int, old: int, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The walls about the newer node and about the older one."""
        source = self._walls.around(node, 3, poses, self._part)
        return source, self._walls.around(old, 8, poses, self._part)

    def _fresh(self, old: int, node: int, guess: Pose2) -> bool:
        """Whether a pair was not tried yet, or from a guess that differs by a metre."""
        before = self._tried.get((old, node))
        self._tried[(old, node)] = guess
        return before is None or (before.inverse() @ guess).distance > 1.0
