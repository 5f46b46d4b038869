"""Which claims are believed: those that the path's own error explains, and no others outvote.

A claim ties two nodes by what was recognised: a closure of two submaps, or walls found far from
where they were expected. One alone may be of two places that look alike. Pairwise consistency
(Mangelson et al., "Pairwise Consistent Measurement Set Maximization for Robust Multi-robot Map
Merging", ICRA 2018): two claims agree when the way over the one and back over the other comes home,
within what the paths between their ends may be off. The tracked path is asked in the same way: a
claim must be what its error explains. Offices in a row that look alike agree, but the way from one
to the next is short and well known.

The error of a step is small, so that errors add up as motions of the map about one origin (Barfoot
and Furgale, "Associating uncertainty with three-dimensional poses", T-RO 2014, first order): sums
along the path give the covariance between any two nodes at once. A share of the way is added
for errors that go on in one direction: wheels measured wrongly, a corridor that looks shorter.
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
from specmap_cli.layout.pose_graph import Link, adjoint, errors, moved_covariance

DRIFT_SHARE = 0.04  # metres per metre driven by which a layout with passes may be off
_DRIFT_RAD_PER_M = 0.001  # radians per metre by which tracking may turn on and on
CLAIM_SLACK_M = 0.5  # what any claim may mend

_VOTES = 3  # independent claims that agree
_PART_VOTES = 2  # closures that agree on where a piece after a break lies
_APART_M = 5.0  # claims nearer than this along both passes count as one
# A closure alone may mend so many sigmas of the path's error, and this share of the way between its
# ends where no others agree.
_ALONE_SIGMAS, _ALONE_SHARE = 3.0, 0.15
_ALONE_RAD = 1.0  # by which it may turn the path: at quarter turns rooms look alike
MEND_SIGMAS = 5.0  # sigmas of the path's error that claims which agree may mend
# Error of a claim that is right, where claims are compared: of its place, of its heading.
_CLAIM_M, _CLAIM_RAD = 0.15, 0.03
_CLAIM_ERROR = np.diag([_CLAIM_M**2, _CLAIM_M**2, _CLAIM_RAD**2])
_SURE = 3.0  # one knows the place of another better than the path does, by this
_AGREE_CHI2 = 16.3  # below it two claims agree: one right pair of 1,000 is above

# near: the layout says the same; drift: the path's error explains it; votes: others say the same;
# alone: one find far away, or across a break, is not enough; impossible: the path's error does not
# explain it; outvoted: claims that agree say otherwise.
Reason = Literal["near", "drift", "votes", "alone", "impossible", "outvoted"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """A claim, and why it is believed or not."""

    link: Link
    reason: Reason

    @property
    def believed(self) -> bool:
        """Whether it goes into the layout."""
        return self.reason in {"near", "drift", "votes"}


def judge(graph: Graph, draft: Draft, claims: Sequence[Link]) -> tuple[Judgement, ...]:
    """Each claim against the layout in the making and against all others, in their order."""
    if not claims:
        return ()
    ends, spread = Ends.of(graph.row, claims), path_error(graph, draft.poses)
    away_m = np.hypot(*errors(draft.poses, ends.i, ends.j, ends.z)[:, :2].T)
    older, newer = ends.parts(graph)
    error = path_error(graph, graph.poses).between(ends.i, ends.j) + _CLAIM_ERROR
    missed = errors(graph.poses, ends.i, ends.j, ends.z)
    sigmas = np.sqrt(np.einsum("la,lab,lb->l", missed, inverse3(error), missed))
    known_m = _sigma_m(spread.between(ends.i, ends.j))
    agree, told_m = pairs_of(graph, draft.poses, ends, spread)
    possible = (older != newer) | (sigmas <= MEND_SIGMAS)
    votes = _votes(graph, ends, agree, told_m <= known_m / _SURE, possible)
    winners = votes >= _VOTES
    # of those that agree, the one that knows its place best, if better than the path
    told_m, rows = np.where(winners, told_m, np.inf), np.arange(len(claims))
    best = told_m.argmin(axis=1)
    outvoted = (told_m[rows, best] < known_m) & ~agree[rows, best]
    way_m = np.abs(graph.path[ends.j] - graph.path[ends.i])
    allowed_m = CLAIM_SLACK_M + np.maximum(_ALONE_SHARE * way_m, _ALONE_SIGMAS * known_m)
    is_beside = np.isfinite(told_m[rows, best])
    explained = np.where(is_beside, sigmas <= _ALONE_SIGMAS, away_m <= allowed_m)
    explained &= np.abs(missed[:, 2]) <= _ALONE_RAD
    lost = older != newer  # nothing is known of the way
    explained[lost] = votes[lost] >= _PART_VOTES
    judged = []
    for k, link in enumerate(claims):
        reason: Reason = "alone" if lost[k] else "impossible"
        if winners[k]:
            reason = "votes"
        elif outvoted[k]:
            reason = "outvoted"
        elif away_m[k] <= CLAIM_SLACK_M:
            reason = "near"
        elif explained[k]:
            reason = "drift" if link.kind == "closure" else "alone"
        judged.append(Judgement(link=link, reason=reason))
    return tuple(judged)


def pairs_of(
    graph: Graph, poses: FloatArray, ends: Ends, spread: Uncertainty
) -> tuple[BoolArray, FloatArray]:
    """Which links agree, (L, L), and how well one says where another would be, a sigma (L, L).

    Of links between other parts one says nothing: inf. The way home leads from the older end of
    link a over it, along the newer pass, back over link b, and along the older pass. Its error is
    told in the frame of the newer end of b. `poses` (M, 3) are those of the graph's nodes.
    """
    older, newer = ends.parts(graph)
    same = (older[:, None] == older) & (newer[:, None] == newer)
    a, b = np.nonzero(np.triu(same, 1))
    later = compose(invert(poses[ends.j[a]]), poses[ends.j[b]])  # ja from jb
    before = compose(invert(poses[ends.i[b]]), poses[ends.i[a]])  # ib from ia
    over = compose(compose(before, ends.z[a]), later)  # ib from jb, by way of link a
    error = compose(invert(ends.z[b]), over)
    # each piece's error, moved to the frame of jb: that of a link acts in the frame of its end
    covariance = spread.between(ends.j[a], ends.j[b]) + _CLAIM_ERROR
    covariance = covariance + moved_covariance(adjoint(invert(later)), _CLAIM_ERROR[None])
    back = adjoint(invert(compose(ends.z[a], later)))  # jb from ia
    covariance = covariance + moved_covariance(back, spread.between(ends.i[b], ends.i[a]))
    agree = np.eye(len(older), dtype=bool)
    chi2 = np.einsum("la,lab,lb->l", error, inverse3(covariance), error)
    agree[a, b] = agree[b, a] = chi2 <= _AGREE_CHI2
    told_m = np.full(same.shape, np.inf)
    told_m[a, b] = told_m[b, a] = _sigma_m(covariance)
    return agree, told_m


def _sigma_m(covariance: FloatArray) -> FloatArray:
    """(L,) the standard deviation of a place, of all directions, by (L, 3, 3)."""
    return np.asarray(np.sqrt((covariance[:, 0, 0] + covariance[:, 1, 1]) / 2))


def _votes(
    graph: Graph, ends: Ends, agree: BoolArray, sure: BoolArray, possible: BoolArray
) -> IntArray:
    """(c,) with how many independent claims each agrees that agree with each other, with itself.

    Sets in which each agrees with each are gathered, the largest first. In a set those count that
    hang together by `sure` pairs (c, c): far along the path anything agrees.
    """
    votes, left = np.ones(len(agree), dtype=np.int64), possible
    while left.any():
        members, common = np.zeros(len(agree), dtype=bool), left
        while common.any():
            best = int(np.argmax(np.where(common, (agree & common).sum(axis=1), -1)))
            members[best] = True
            common = common & agree[best] & ~members
        chosen = np.flatnonzero(members)
        _, chain = connected_components(csr_array(sure[np.ix_(chosen, chosen)]), directed=False)
        for number in range(int(chain.max()) + 1):
            linked = chosen[chain == number]
            votes[linked] = independent(ends, linked.tolist(), graph.path, _APART_M)
        left = left & ~members
    return votes


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
