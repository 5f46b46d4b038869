"""The path of the robot as a graph, and a layout of it in the making: the values of `relax`."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.sparse import csr_array

from specmap_cli.core.geometry import FloatArray, Pose2, moved, step_lengths
from specmap_cli.core.records import IntArray
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.motion_edges import Bridge, motion_links
from specmap_cli.layout.pose_graph import Link

NODE_M = 0.3  # motion between nodes of the pose graph
_NODE_RAD = 0.25  # turn between nodes of the pose graph
LOOP_EVERY_M = 1.0  # least path between searches for nearby passes
LOOP_PATH_M = 6.0  # less path than this between is no pass

Pair = tuple[int, int]
# Keyframes at which tracking started afresh, and what is known of the motion over each break.
Breaks = Collection[int] | Mapping[int, Bridge | None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Graph:
    """The nodes of the pose graph in the order of the path, and the motions between them.

    `nodes` (M,) are keyframe numbers, ascending, `row` their places in it. `tracked` (n, 3) are the
    poses of all keyframes before any relaxing. A part is a piece of the path between breaks of the
    tracking that nothing bridged: `parts` (M,) numbers them from 0. `path` (M,) is the way driven
    up to each node, where a break counts as a way too long for nodes on either side of it to be
    successive.
    """

    nodes: IntArray
    row: Mapping[int, int]
    tracked: FloatArray
    parts: IntArray
    path: FloatArray
    odometry: tuple[Link, ...]

    @property
    def poses(self) -> FloatArray:
        """(M, 3) the poses of the nodes as tracked."""
        return self.tracked[self.nodes]

    @property
    def pieces(self) -> IntArray:
        """(M,) numbers from 0 of the pieces between all breaks, bridged or not."""
        after = [motion.kind != "odometry" for motion in self.odometry]
        return np.concatenate([[0], np.cumsum(after)]).astype(np.int64)

    @property
    def part_numbers(self) -> range:
        """The numbers of all parts."""
        return range(int(self.parts[-1]) + 1)


@dataclass(frozen=True, slots=True, kw_only=True)
class Draft:
    """A layout in the making: `poses` (M, 3) of the nodes, and `loops`, what else ties them.

    `tied` are the parts whose poses are better than a guess. `tried` holds, for pairs of rows that
    were matched, the guess that the match began with; `tries` how often a part was searched for
    without one. `hints` are closures, which count as finds in the search for a part. `limits`
    counts by name how often a setting cut the work short, if it did.
    """

    poses: FloatArray
    loops: tuple[Link, ...] = ()
    tied: frozenset[int] = frozenset({0})
    tried: Mapping[Pair, Pose2] = field(default_factory=dict)
    tries: Mapping[int, int] = field(default_factory=dict)
    limits: Mapping[str, int] = field(default_factory=dict)
    hints: tuple[Link, ...] = ()

    def counting(self, limit: str, count: int) -> Draft:
        """The draft in which a limit was hit `count` times more."""
        if not count:
            return self
        return replace(self, limits={**self.limits, limit: self.limits.get(limit, 0) + count})


def graph_of(store: KeyframeStore, ends: Collection[int], breaks: Breaks) -> Graph:
    """The graph of a store's keyframes, with nodes at the `ends` of constraints and at `breaks`."""
    known = breaks if isinstance(breaks, Mapping) else dict.fromkeys(breaks)
    fresh = {number: bridge for number, bridge in known.items() if number != 0}
    nodes = chosen_nodes(store.poses, {*ends, *fresh})
    return joined(store.poses, nodes, motion_links(store, nodes, fresh))


def joined(tracked: FloatArray, nodes: IntArray, odometry: tuple[Link, ...]) -> Graph:
    """The graph of the keyframes `nodes` (M,), of all at poses `tracked` (n, 3), and its motions.

    `odometry` are the M - 1 links from each node to the next.
    """
    after = [False, *(motion.kind != "odometry" for motion in odometry)]
    loose = [False, *(motion.kind == "loose" for motion in odometry)]
    steps = np.concatenate([[0.0], step_lengths(tracked[nodes])])
    return Graph(
        nodes=nodes,
        row={number: row for row, number in enumerate(nodes.tolist())},
        tracked=tracked,
        parts=np.cumsum(loose).astype(np.int64),
        path=np.cumsum(np.where(after, 2 * LOOP_PATH_M, steps)),
        odometry=odometry,
    )


def chosen_nodes(poses: FloatArray, always: Collection[int]) -> IntArray:
    """Keyframe numbers for the graph: the first, the last, one a step of the path, `always`."""
    chosen: list[int] = []
    last: Pose2 | None = None
    for number, row in enumerate(poses.tolist()):
        pose = Pose2(*row)
        due = number in always or number == len(poses) - 1
        if due or moved(last, pose, NODE_M, _NODE_RAD):
            chosen.append(number)
            last = pose
    return np.array(chosen, dtype=np.int64)


def lengths_matrix(count: int, pairs: Sequence[Pair], lengths: Sequence[float]) -> csr_array:
    """The (count, count) sparse matrix of undirected edges for scipy.sparse.csgraph.

    Of several edges between the same two rows the shortest counts. Lengths must be above zero.
    """
    shortest: dict[Pair, float] = {}
    for (a, b), length in zip(pairs, lengths, strict=True):
        pair = (min(a, b), max(a, b))
        shortest[pair] = min(length, shortest.get(pair, np.inf))
    ends = np.array(list(shortest), dtype=np.int32).reshape(-1, 2)  # csgraph wants 32 bits
    values = np.array(list(shortest.values()), dtype=np.float64)
    return csr_array((values, (ends[:, 0], ends[:, 1])), shape=(count, count))
