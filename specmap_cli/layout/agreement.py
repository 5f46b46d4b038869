"""Closures judged together: the largest set in which each agrees with each.

Pairwise consistency maximisation (Mangelson et al., "Pairwise Consistent Measurement Set
Maximization for Robust Multi-robot Map Merging", ICRA 2018): two closures agree when the way over
the one and back over the other comes home, within what the paths between their ends may be off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from specmap_cli.core.geometry import FloatArray, compose, invert
from specmap_cli.core.records import BoolArray, IntArray
from specmap_cli.layout.cliques import largest_clique
from specmap_cli.layout.path_graph import Graph
from specmap_cli.layout.pose_graph import Link
from specmap_cli.layout.uncertainty import Uncertainty, adjoint, moved_covariance, surprise

AGREE_M = 0.15  # error of a closure that is right, where closures are compared
AGREE_RAD = 0.03  # error of the heading of a closure that is right
_AGREE_CHI2 = 16.3  # below it two closures agree: one right pair of 1,000 is above
_CLIQUE_STEPS = 100_000  # steps of the search for the largest set that agrees, at the most


@dataclass(frozen=True, slots=True, kw_only=True)
class Ends:
    """Links as rows of a graph: `i`, `j` (L,) with the older end first, and `z` (L, 3)."""

    i: IntArray
    j: IntArray
    z: FloatArray

    @classmethod
    def of(cls, graph: Graph, links: Sequence[Link]) -> Ends:
        """The ends of links, turned round where the target is the older one."""
        i = np.array([graph.row[link.source] for link in links], dtype=np.int64)
        j = np.array([graph.row[link.target] for link in links], dtype=np.int64)
        z = np.array([link.source_from_target for link in links]).reshape(-1, 3)
        turned = i > j
        return cls(
            i=np.where(turned, j, i),
            j=np.where(turned, i, j),
            z=np.where(turned[:, None], invert(z), z),
        )


@dataclass(frozen=True, slots=True)
class Pairs:
    """Which links agree, (L, L), and how well one says where another would be, (L, L) metres.

    The second is the standard deviation of the place; inf where links say nothing of each other.
    """

    agree: BoolArray
    sigma_m: FloatArray


@dataclass(frozen=True, slots=True)
class Agreement:
    """Links (rows of `members`) that agree with each other.

    `exact` is False when the search for the largest set was cut short.
    """

    members: tuple[int, ...]
    exact: bool


def largest_agreement(pairs: Pairs) -> Agreement:
    """The largest set of links that agree pair by pair."""
    return Agreement(*largest_clique(pairs.agree, _CLIQUE_STEPS))


def pairs_of(graph: Graph, poses: FloatArray, ends: Ends, spread: Uncertainty) -> Pairs:
    """Whether links agree, at poses (M, 3). Links between other parts say nothing of each other."""
    count = len(ends.i)
    a, b = np.triu_indices(count, 1)
    same = (graph.parts[ends.i[a]] == graph.parts[ends.i[b]]) & (
        graph.parts[ends.j[a]] == graph.parts[ends.j[b]]
    )
    a, b = a[same], b[same]
    error, covariance = way_home(poses, ends, a, b, spread)
    agree, sigma = np.zeros((count, count), dtype=bool), np.full((count, count), np.inf)
    agree[a, b] = surprise(error, covariance) <= _AGREE_CHI2
    sigma[a, b] = np.sqrt((covariance[:, 0, 0] + covariance[:, 1, 1]) / 2)
    return Pairs(agree | agree.T, np.minimum(sigma, sigma.T))


def way_home(
    poses: FloatArray,
    ends: Ends,
    a: IntArray,
    b: IntArray,
    spread: Uncertainty,
) -> tuple[FloatArray, FloatArray]:
    """Errors (P, 3) of the ways over links `a` (P,) and back over `b`, and covariances (P, 3, 3).

    From the older end of a link over it, along the newer pass, back over the other link, and along
    the older pass. Errors are told in the frame of the newer end of b.
    """
    later = compose(invert(poses[ends.j[a]]), poses[ends.j[b]])  # ja from jb
    older = compose(invert(poses[ends.i[b]]), poses[ends.i[a]])  # ib from ia
    over = compose(compose(older, ends.z[a]), later)  # ib from jb, by way of link a
    error = compose(invert(ends.z[b]), over)
    # each piece's error, moved to the frame of jb: that of a link acts in the frame of its end
    one = np.diag([AGREE_M**2, AGREE_M**2, AGREE_RAD**2])
    covariance = spread.between(ends.j[a], ends.j[b]) + one
    covariance = covariance + moved_covariance(adjoint(invert(later)), one[None])
    back = invert(compose(ends.z[a], later))  # jb from ia
    covariance = covariance + moved_covariance(adjoint(back), spread.between(ends.i[b], ends.i[a]))
    return error, covariance


def independent(ends: Ends, members: Sequence[int], way: FloatArray, apart_m: float) -> int:
    """How many of the members were seen at stretches of way `apart_m` from all others', in order.

    The same two stays seen twice within a few metres are one piece of evidence.
    """
    chosen: list[tuple[float, float]] = []
    for k in members:
        at = float(way[ends.i[k]]), float(way[ends.j[k]])
        if all(abs(at[0] - x) > apart_m or abs(at[1] - y) > apart_m for x, y in chosen):
            chosen.append(at)
    return len(chosen)
