"""How far one node of the path may be from where another one has it: errors of steps, added up.

The error of a step is small, so that errors add up as motions of the map about one origin (Barfoot
and Furgale, "Associating uncertainty with three-dimensional poses", T-RO 2014, first order): sums
along the path give the covariance between any two nodes at once. A share of the way is added
for errors that go on in one direction: wheels measured wrongly, a corridor that looks shorter.

What a single closure may mend is bounded by drift alone, along the shortest chain of links between
its two keyframes. In look-alike rooms off one corridor that chain is short, and a closure between
them impossible.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from specmap_cli.core.geometry import FloatArray, inverse3, invert
from specmap_cli.core.records import BoolArray, IntArray
from specmap_cli.layout.path_graph import GUESS_M, Draft, Graph, RowPair
from specmap_cli.layout.pose_graph import Link, LinkArrays, errors

DRIFT_SHARE = 0.04  # metres per metre driven by which a layout with passes may be off
_DRIFT_RAD_PER_M = 0.001  # radians per metre by which tracking may turn on and on
_CLOSURE_DRIFT_SHARE = 0.15  # metres per metre driven between its ends that a closure may mend
CLOSURE_SLACK_M = 0.5  # what any closure may mend
_LEAST_M = 1e-3  # length of a link between two nodes at one place: csgraph takes 0 for no edge
_BRIDGE_SIGMAS = 3.0  # of a bridge that are still no surprise
_CUT_SHORT = 0.9  # a chain below this share of the path goes over a nearby pass


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """`sums` (M, 3, 3): the covariance of each node in the map's frame, seen from the first.

    `way` (M,) metres driven up to each node; `share` and `veer` are errors that go on, metres and
    radians a metre.
    """

    sums: FloatArray
    way: FloatArray
    poses: FloatArray
    share: float
    veer: float = 0.0

    @classmethod
    def along(
        cls, poses: FloatArray, motions: Sequence[Link], share: float, veer: float = 0.0
    ) -> Uncertainty:
        """Of a path of nodes (M, 3), from its M - 1 motions."""
        steps = np.array([link.information for link in motions]).reshape(-1, 3, 3)
        lengths = [link.source_from_target.distance for link in motions]
        noise = moved_covariance(adjoint(poses[1:]), inverse3(steps))
        sums = np.concatenate([np.zeros((1, 3, 3)), np.cumsum(noise, axis=0)])
        way = np.concatenate([[0.0], np.cumsum(np.array(lengths))])
        return cls(sums, way, poses, share, veer)

    def between(self, i: IntArray, j: IntArray) -> FloatArray:
        """(L, 3, 3) covariance of the poses of rows `j` (L,) seen from rows `i`, in their frame."""
        low, high = np.minimum(i, j), np.maximum(i, j)
        summed = self.sums[high] - self.sums[low]
        spread = moved_covariance(adjoint(invert(self.poses[j])), summed)
        driven, away = self.way[high] - self.way[low], self.poses[j, :2] - self.poses[i, :2]
        turned = self.veer * driven
        aside = 0.5 * turned * np.hypot(away[:, 0], away[:, 1])  # half: it turns bit by bit
        steady = (self.share * driven) ** 2 + aside**2
        spread[:, 0, 0] += steady
        spread[:, 1, 1] += steady
        spread[:, 2, 2] += turned**2
        return spread


def path_error(graph: Graph, poses: FloatArray) -> Uncertainty:
    """The error of a path at poses (M, 3): of errors that go on, the constants are two sigmas."""
    return Uncertainty.along(poses, graph.odometry, 0.5 * DRIFT_SHARE, 0.5 * _DRIFT_RAD_PER_M)


def adjoint(poses: FloatArray) -> FloatArray:
    """(L, 3, 3) what turns a small motion in the frame of each pose (L, 3) into one of the map."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    matrix = np.zeros((len(poses), 3, 3))
    matrix[:, 0, 0], matrix[:, 0, 1], matrix[:, 0, 2] = c, -s, poses[:, 1]
    matrix[:, 1, 0], matrix[:, 1, 1], matrix[:, 1, 2] = s, c, -poses[:, 0]
    matrix[:, 2, 2] = 1.0
    return matrix


def moved_covariance(matrix: FloatArray, covariance: FloatArray) -> FloatArray:
    """(L, 3, 3) A C A^T, summed in one order on every processor."""
    half = np.einsum("lab,lbc->lac", matrix, covariance)
    return np.asarray(np.einsum("lac,ldc->lad", half, matrix), dtype=np.float64)


def within_ellipse(away: FloatArray, covariance: FloatArray) -> BoolArray:
    """(N,) whether vectors (N, 2) end inside the ellipse of a covariance (2, 2)."""
    (a, b), (_, c) = covariance.tolist()
    x, y = away[:, 0], away[:, 1]
    return np.asarray(c * x * x - 2.0 * b * x * y + a * y * y <= a * c - b * b)


def deviations(
    graph: Graph, draft: Draft, closures: Sequence[Link]
) -> tuple[FloatArray, FloatArray]:
    """How far the layout in the making is from what each closure says, and may be by drift alone.

    Metres (c,) and (c,). Any of them may mend `CLOSURE_SLACK_M`. Along a chain that passes cut
    short drift is `DRIFT_SHARE` of its length, along another one `_CLOSURE_DRIFT_SHARE`. Over a
    break of which nothing is known it is the guess that may be off, by three times `GUESS_M`: parts
    are moved farther as a whole only, when several links agree where to.
    """
    ends = LinkArrays.of(closures, graph.row, {})
    off = errors(draft.poses, ends.i, ends.j, ends.z)
    chain_m = chain_lengths(graph, draft.loops, closures)
    driven_m = np.abs(graph.path[ends.j] - graph.path[ends.i])
    share = np.where(chain_m < _CUT_SHORT * driven_m, DRIFT_SHARE, _CLOSURE_DRIFT_SHARE)
    drift_m = np.where(np.isfinite(chain_m), share * chain_m, _BRIDGE_SIGMAS * GUESS_M)
    return np.hypot(off[:, 0], off[:, 1]), CLOSURE_SLACK_M + drift_m


def chain_lengths(graph: Graph, loops: Sequence[Link], closures: Sequence[Link]) -> FloatArray:
    """(c,) metres along the shortest chain of links between the ends of each closure.

    The chain runs over motions that were tracked and over `loops`; inf where there is none. A break
    that odometry bridged counts as the way along which tracking drifts as far, another one ends it.
    By Dijkstra's algorithm, once for each keyframe from which a closure starts.
    """
    if not closures:
        return np.zeros(0)
    shortest: dict[RowPair, float] = {}  # csgraph would add up edges between the same two rows
    for link in (*graph.odometry, *loops):
        if link.kind == "loose":
            continue
        length_m = link.source_from_target.distance
        if link.kind == "bridge":
            reach_m = _BRIDGE_SIGMAS / float(np.sqrt(link.information[:2, :2].trace() / 2))
            length_m += reach_m / _CLOSURE_DRIFT_SHARE
        a, b = sorted((graph.row[link.source], graph.row[link.target]))
        shortest[a, b] = min(max(length_m, _LEAST_M), shortest.get((a, b), np.inf))
    ends = np.array(list(shortest), dtype=np.int32).reshape(-1, 2).T  # csgraph wants 32 bits
    lengths, count = np.array(list(shortest.values()), dtype=np.float64), len(graph.nodes)
    matrix = csr_array((lengths, (ends[0], ends[1])), shape=(count, count))
    starts, which = np.unique([graph.row[one.source] for one in closures], return_inverse=True)
    found = dijkstra(matrix, directed=False, indices=starts)
    return np.asarray(found[which, [graph.row[one.target] for one in closures]])
