"""Which closures are believed: those that drift explains, and those that agree with each other.

One closure alone may be of two places that look alike. It must stay within what drift allows.
Several independent ones that agree may mend more, as far as the path's own error reaches: offices
in a row that look alike agree, too, but the way from one to the next is short and well known.

Pairwise consistency maximisation (Mangelson et al., "Pairwise Consistent Measurement Set
Maximization for Robust Multi-robot Map Merging", ICRA 2018): two closures agree when the way over
the one and back over the other comes home, within what the paths between their ends may be off. The
largest set in which each agrees with each is the largest clique of a graph (Tomita and Seki, "An
efficient branch-and-bound algorithm for finding a maximum clique", DMTCS 2003).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from specmap_cli.core.geometry import FloatArray, compose, inverse3, invert
from specmap_cli.core.records import BoolArray, IntArray
from specmap_cli.layout.path_graph import Draft, Ends, Graph
from specmap_cli.layout.pose_graph import Link, errors
from specmap_cli.layout.uncertainty import (
    CLOSURE_SLACK_M,
    Uncertainty,
    adjoint,
    deviations,
    moved_covariance,
    path_error,
)

_CLOSURE_VOTES = 3  # independent closures that agree may mend more than drift explains
_CLOSURE_APART_M = 5.0  # closures nearer than this along both passes count as one
_MEND_SIGMAS = 5.0  # sigmas of the path's error that closures which agree may mend
_SURE = 3.0  # a closure that agrees with another one knows its place better than the path, by this
# Error of a closure that is right, where closures are compared: of its place, of its heading.
_CLOSURE_M, _CLOSURE_RAD = 0.15, 0.03
_CLOSURE_ERROR = np.diag([_CLOSURE_M**2, _CLOSURE_M**2, _CLOSURE_RAD**2])
_AGREE_CHI2 = 16.3  # below it two closures agree: one right pair of 1,000 is above
_CLIQUE_STEPS = 100_000  # steps of the search for the largest set that agrees, at the most

# near: the layout says the same; drift: drift explains the rest; votes: others say the same;
# waiting: drift would explain it, but others that agree come first;
# impossible: nothing explains it; outvoted: closures that agree say otherwise.
Reason = Literal["near", "drift", "votes", "waiting", "impossible", "outvoted"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """A closure or wide pass, and why it is believed or not.

    It would move its end by `away_m`, of which drift alone allows `allowed_m`. `votes` independent
    closures agree with it, itself included.
    """

    link: Link
    reason: Reason
    away_m: float
    allowed_m: float
    votes: int

    @property
    def believed(self) -> bool:
        """Whether it goes into the layout."""
        return self.reason in {"near", "drift", "votes"}


def judge(
    graph: Graph, draft: Draft, closures: Sequence[Link]
) -> tuple[tuple[Judgement, ...], int]:
    """Each closure against the layout in the making and against all others, in their order.

    And how many searches for the largest set that agrees ended early.
    """
    if not closures:
        return (), 0
    away_m, allowed_m = deviations(graph, draft, closures)
    ends, spread = Ends.of(graph.row, closures), path_error(graph, draft.poses)
    pairs = Pairs.of(graph, draft.poses, ends, spread)
    votes, cut_short = _votes(graph, ends, pairs, spread)
    winners = votes >= _CLOSURE_VOTES
    rivals = pairs.same & winners
    against = (rivals & ~pairs.agree).sum(axis=1)
    outvoted = ~winners & (2 * against > rivals.sum(axis=1))
    reasons: list[Reason] = []
    for k, link in enumerate(closures):
        if outvoted[k]:
            reasons.append("outvoted")
        elif away_m[k] <= CLOSURE_SLACK_M:
            reasons.append("near")
        elif winners[k]:
            reasons.append("votes")
        # what is found far away may mend nothing alone, since walls look alike
        elif link.kind == "closure" and away_m[k] <= allowed_m[k]:
            reasons.append("drift")
        else:
            reasons.append("impossible")
    if "votes" in reasons:  # one alone is asked again in the layout that these have mended
        reasons = ["waiting" if reason == "drift" else reason for reason in reasons]
    judged = tuple(
        Judgement(
            link=link,
            reason=reason,
            away_m=float(away_m[k]),
            allowed_m=float(allowed_m[k]),
            votes=int(votes[k]),
        )
        for k, (link, reason) in enumerate(zip(closures, reasons, strict=True))
    )
    return judged, cut_short


@dataclass(frozen=True, slots=True)
class Pairs:
    """Which links lie between the `same` two parts, (L, L), and which of these `agree`.

    `sigma_m` (L, L): how well one says where another would be, as the standard deviation of the
    place; inf where links say nothing of each other.
    """

    same: BoolArray
    agree: BoolArray
    sigma_m: FloatArray

    @classmethod
    def of(cls, graph: Graph, poses: FloatArray, ends: Ends, spread: Uncertainty) -> Pairs:
        """Of links at poses (M, 3). Those between other parts say nothing of each other.

        The way home leads from the older end of link a over it, along the newer pass, back over
        link b, and along the older pass. Its error is told in the frame of the newer end of b.
        """
        older, newer = ends.parts(graph)
        same = (older[:, None] == older) & (newer[:, None] == newer)
        a, b = np.nonzero(np.triu(same, 1))
        later = compose(invert(poses[ends.j[a]]), poses[ends.j[b]])  # ja from jb
        before = compose(invert(poses[ends.i[b]]), poses[ends.i[a]])  # ib from ia
        over = compose(compose(before, ends.z[a]), later)  # ib from jb, by way of link a
        error = compose(invert(ends.z[b]), over)
        # each piece's error, moved to the frame of jb: that of a link acts in the frame of its end
        covariance = spread.between(ends.j[a], ends.j[b]) + _CLOSURE_ERROR
        covariance = covariance + moved_covariance(adjoint(invert(later)), _CLOSURE_ERROR[None])
        back = adjoint(invert(compose(ends.z[a], later)))  # jb from ia
        covariance = covariance + moved_covariance(back, spread.between(ends.i[b], ends.i[a]))
        agree, sigma = np.zeros(same.shape, dtype=bool), np.full(same.shape, np.inf)
        chi2 = np.einsum("la,lab,lb->l", error, inverse3(covariance), error)
        agree[a, b] = chi2 <= _AGREE_CHI2
        sigma[a, b] = np.sqrt((covariance[:, 0, 0] + covariance[:, 1, 1]) / 2)  # of all directions
        return cls(same, agree | agree.T, np.minimum(sigma, sigma.T))


def _votes(graph: Graph, ends: Ends, pairs: Pairs, spread: Uncertainty) -> tuple[IntArray, int]:
    """(c,) with how many independent closures each agrees, itself included, and cuts.

    The largest set first, then that among closures between other parts, of which it says nothing.
    Within a set those count that hang together by pairs of which one knows the place of the other
    much better than the path does: far along the path anything agrees.
    """
    own = spread.between(ends.i, ends.j)
    sure_m = np.sqrt((own[:, 0, 0] + own[:, 1, 1]) / 2) / _SURE
    # how far each is from the path as tracked, in sigmas of its error
    error = path_error(graph, graph.poses).between(ends.i, ends.j) + _CLOSURE_ERROR
    missed = errors(graph.poses, ends.i, ends.j, ends.z)
    sigmas = np.sqrt(np.einsum("la,lab,lb->l", missed, inverse3(error), missed))
    older, newer = ends.parts(graph)
    left = np.flatnonzero((older != newer) | (sigmas <= _MEND_SIGMAS))
    votes, cut_short = np.ones(len(ends.i), dtype=np.int64), 0
    while len(left):
        clique, is_largest = largest_clique(pairs.agree[np.ix_(left, left)], _CLIQUE_STEPS)
        cut_short += not is_largest
        members = left[list(clique)]
        sure = pairs.sigma_m[np.ix_(members, members)] <= sure_m[members]
        _, chain = connected_components(csr_array(sure), directed=False)
        for number in range(int(chain.max()) + 1):
            linked = members[chain == number]
            votes[linked] = independent(ends, linked.tolist(), graph.path, _CLOSURE_APART_M)
        left = left[~pairs.same[left, members[0]]]
    return votes, cut_short


def independent(ends: Ends, members: Sequence[int], way: FloatArray, apart_m: float) -> int:
    """How many of the members were seen at stretches of way `apart_m` from all others', in order.

    The same two places seen twice within a few metres are one vote.
    """
    chosen: list[tuple[float, float]] = []
    for k in members:
        at = float(way[ends.i[k]]), float(way[ends.j[k]])
        if all(abs(at[0] - x) > apart_m or abs(at[1] - y) > apart_m for x, y in chosen):
            chosen.append(at)
    return len(chosen)


def largest_clique(adjacent: BoolArray, most_steps: int) -> tuple[tuple[int, ...], bool]:
    """The largest clique of an undirected graph (n, n), ascending, and whether that is certain.

    Branch and bound with colours: vertices that share a colour are not neighbours, so that a clique
    has at most one of each. Of equals the first found counts: the same every time. It starts from a
    greedy one and ends after `most_steps` steps with the best so far.
    """
    search = _CliqueSearch(adjacent, most_steps)
    search.expand([], search.all)
    return tuple(sorted(search.best)), search.left > 0


class _CliqueSearch:
    """Sets of vertices are the bits of whole numbers."""

    def __init__(self, adjacent: BoolArray, most_steps: int) -> None:
        self.neighbours = [
            sum(1 << int(k) for k in np.flatnonzero(row) if k != vertex)
            for vertex, row in enumerate(adjacent)
        ]
        self.all = (1 << len(adjacent)) - 1
        self.left = most_steps
        self.best: list[int] = []  # at first of the most neighbours, each one of all before
        common = self.all
        for vertex in sorted(
            range(len(adjacent)), key=lambda v: (-self.neighbours[v].bit_count(), v)
        ):
            if common >> vertex & 1:
                self.best.append(vertex)
                common &= self.neighbours[vertex]

    def expand(self, clique: list[int], candidates: int) -> None:
        """Look for larger cliques of `clique` and some of its common neighbours `candidates`."""
        if not candidates and len(clique) > len(self.best):
            self.best = list(clique)
        order: list[tuple[int, int]] = []  # with colours, ascending: a bound on cliques up to there
        colour, rest = 0, candidates
        while rest:
            colour += 1
            free = rest
            while free:
                vertex = (free & -free).bit_length() - 1
                rest &= ~(1 << vertex)
                free &= ~(1 << vertex) & ~self.neighbours[vertex]
                order.append((vertex, colour))
        for vertex, colour in reversed(order):
            if self.left <= 0 or len(clique) + colour <= len(self.best):
                return
            self.left -= 1
            self.expand([*clique, vertex], candidates & self.neighbours[vertex])
            candidates &= ~(1 << vertex)
