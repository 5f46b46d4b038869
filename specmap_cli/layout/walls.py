"""The walls that the robot saw around nodes of the graph."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2, compose, invert
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.grids.score_field import thinned
from specmap_cli.layout.path_graph import Graph
from specmap_cli.layout.wall_sides import Sides

PLACE_NODES = 8  # nodes on either side whose walls make one place: some 2 m of path
CELL_M = 0.05  # points are thinned to one in a cell of the fields they are matched on
_REMEMBERED = 256  # nodes whose points stay in memory: some 5 MB
_GATHERED = 10_000  # points that are thinned together: 160 kB


class Walls:
    """Wall points around the nodes of a graph, read from the store as needed; some are kept."""

    def __init__(self, store: KeyframeStore, graph: Graph, range_m: float) -> None:
        self._store, self._graph, self._range_m = store, graph, range_m
        self._pieces = graph.pieces
        self.points = lru_cache(_REMEMBERED)(self._read)
        self.sides = lru_cache(_REMEMBERED)(self._sides)

    def around(self, node: int, reach: int, poses: FloatArray) -> FloatArray:
        """Points (N, 2) seen from nodes within `reach` of row `node`, in the frame of `node`.

        `poses` (M, 3) place the nodes; only nodes between the same breaks are used.
        """
        near = self._near(node, reach, poses)
        return np.concatenate([pose.apply(self.points(k)) for k, pose in near])

    def sides_around(self, node: int, reach: int, poses: FloatArray) -> Sides:
        """The same points with the sides of the walls that are seen from there."""
        near = self._near(node, reach, poses)
        return Sides.joined([self.sides(k).placed(pose) for k, pose in near])

    def _near(self, node: int, reach: int, poses: FloatArray) -> list[tuple[int, Pose2]]:
        """The rows around a row, and where they are in its frame."""
        pieces = self._pieces
        low, high = max(0, node - reach), min(len(pieces), node + reach + 1)
        others = [k for k in range(low, high) if pieces[k] == pieces[node]]
        relative = compose(invert(poses[node]), poses[others])
        return [(k, Pose2(*pose.tolist())) for k, pose in zip(others, relative, strict=True)]

    def of_all(self, nodes: Sequence[int], poses: FloatArray) -> FloatArray:
        """Points (N, 2) seen from all rows `nodes`, in the map, thinned as they are gathered."""
        clouds: list[FloatArray] = [np.zeros((0, 2))]
        count, most = 0, _GATHERED
        for k in nodes:
            clouds.append(Pose2(*poses[k].tolist()).apply(self.points(k)))
            count += len(clouds[-1])
            if count > most:  # twice what was left the last time: each point is thinned a few times
                clouds = [thinned(np.concatenate(clouds), CELL_M)]
                count = len(clouds[0])
                most = max(_GATHERED, 2 * count)
        return thinned(np.concatenate(clouds), CELL_M)

    def _read(self, node: int) -> FloatArray:
        """Points of one node in its base frame."""
        number = int(self._graph.nodes[node])
        return thinned(self._store.points(number, self._range_m), CELL_M)

    def _sides(self, node: int) -> Sides:
        """Points of one node in its base frame, with the sides that its laser saw."""
        laser = self._store.base_from_laser(int(self._graph.nodes[node]))
        return Sides.of(self.points(node), (laser.x, laser.y))
