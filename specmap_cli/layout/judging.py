"""Which closures are believed: those that drift explains, and those that agree with each other.

One closure alone may be of two places that look alike. It must stay within what drift allows.
Several independent ones that agree may mend more, as far as the path's own error reaches: offices
in a row that look alike agree, too, but the way from one to the next is short and well known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import BoolArray, IntArray
from specmap_cli.layout.agreement import (
    AGREE_M,
    AGREE_RAD,
    Ends,
    Pairs,
    independent,
    largest_agreement,
    pairs_of,
)
from specmap_cli.layout.drift import CLOSURE_SLACK_M, Deviations, deviations
from specmap_cli.layout.path_graph import Draft, Graph
from specmap_cli.layout.pose_graph import Link
from specmap_cli.layout.uncertainty import Uncertainty, misfit, path_error, surprise

_CLOSURE_VOTES = 3  # independent closures that agree may mend more than drift explains
_CLOSURE_APART_M = 5.0  # closures nearer than this along both passes are one evidence
_MEND_SIGMAS = 5.0  # sigmas of the path's error that closures which agree may mend
_SURE = 3.0  # a closure that agrees with another one knows its place better than the path, by this

# near: the layout says the same; drift: drift explains the rest; agreement: others say the same;
# waiting: drift would explain it, but others that agree come first;
# impossible: nothing explains it; outvoted: closures that agree say otherwise; outlier: it does not
# fit the solved layout; contradicted: with it, more walls stand in free space.
Reason = Literal[
    "near", "drift", "agreement", "waiting", "impossible", "outvoted", "outlier", "contradicted"
]


@dataclass(frozen=True, slots=True, kw_only=True)
class Judged:
    """A closure or wide pass, whether it is `believed`, and why.

    It would move its end by `away_m`, of which drift alone allows `allowed_m`. `votes` independent
    closures agree with it, itself included.
    """

    link: Link
    believed: bool
    reason: Reason
    away_m: float
    allowed_m: float
    votes: int


@dataclass(frozen=True, slots=True)
class Judgement:
    """All closures in their order; `cut_short` counts searches that ended early."""

    closures: tuple[Judged, ...]
    cut_short: int

    def links(self, *, believed: bool) -> tuple[Link, ...]:
        """The closures that are believed, or those that are not."""
        return tuple(one.link for one in self.closures if one.believed is believed)


def judge(graph: Graph, draft: Draft, closures: Sequence[Link]) -> Judgement:
    """Each closure against the layout in the making and against all others."""
    if not closures:
        return Judgement((), 0)
    found, sigmas = deviations(graph, draft, closures), _sigmas(graph, closures)
    ends, spread = Ends.of(graph, closures), spread_of(graph, draft)
    pairs = pairs_of(graph, draft.poses, ends, spread)
    path = spread.between(ends.i, ends.j)
    sure_m = np.sqrt((path[:, 0, 0] + path[:, 1, 1]) / 2) / _SURE
    votes, cut_short = _votes(graph, ends, pairs, sigmas, sure_m)
    outvoted = _outvoted(graph, ends, pairs, votes >= _CLOSURE_VOTES)
    reasons = [
        _reason(away, allowed, count, out)
        for away, allowed, count, out in zip(
            found.away_m.tolist(), _alone(closures, found), votes.tolist(), outvoted, strict=True
        )
    ]
    if "agreement" in reasons:  # one alone is asked again in the layout that these have mended
        reasons = ["waiting" if reason == "drift" else reason for reason in reasons]
    judged = tuple(
        Judged(
            link=link,
            believed=reason in {"near", "drift", "agreement"},
            reason=reason,
            away_m=float(found.away_m[k]),
            allowed_m=float(found.allowed_m[k]),
            votes=int(votes[k]),
        )
        for k, (link, reason) in enumerate(zip(closures, reasons, strict=True))
    )
    return Judgement(judged, cut_short)


def _reason(away_m: float, allowed_m: float, votes: int, outvoted: bool) -> Reason:
    if outvoted:
        return "outvoted"
    if away_m <= CLOSURE_SLACK_M:
        return "near"
    if votes >= _CLOSURE_VOTES:
        return "agreement"
    return "drift" if away_m <= allowed_m else "impossible"


def _alone(closures: Sequence[Link], found: Deviations) -> list[float]:
    """What each may mend alone: passes found far away nothing, since walls look alike."""
    return [
        allowed if link.kind == "closure" else 0.0
        for link, allowed in zip(closures, found.allowed_m.tolist(), strict=True)
    ]


def spread_of(graph: Graph, draft: Draft) -> Uncertainty:
    """The error of the path at the poses of a draft."""
    return path_error(graph, draft.poses)


def _sigmas(graph: Graph, closures: Sequence[Link]) -> FloatArray:
    """(c,) how far each closure is from the path as tracked, in sigmas of its error."""
    ends = Ends.of(graph, closures)
    spread = path_error(graph, graph.poses)
    own = np.diag([AGREE_M**2, AGREE_M**2, AGREE_RAD**2])
    error = misfit(graph.poses, ends.i, ends.j, ends.z)
    sigmas = np.sqrt(surprise(error, spread.between(ends.i, ends.j) + own))
    over_break = graph.parts[ends.i] != graph.parts[ends.j]
    return np.where(over_break, 0.0, sigmas)


def _votes(
    graph: Graph,
    ends: Ends,
    pairs: Pairs,
    sigmas: FloatArray,
    sure_m: FloatArray,
) -> tuple[IntArray, int]:
    """(c,) with how many independent closures each agrees, itself included, and cuts.

    The largest set first, then that among closures between other parts, of which it says nothing.
    Within a set those count that hang together by pairs of which one knows the place of the other
    to `sure_m` (c,): far along the path anything agrees.
    """
    votes, cut_short = np.ones(len(sigmas), dtype=np.int64), 0
    left = np.flatnonzero(sigmas <= _MEND_SIGMAS)
    while len(left):
        within = np.ix_(left, left)
        found = largest_agreement(Pairs(pairs.agree[within], pairs.sigma_m[within]))
        cut_short += not found.exact
        members = left[list(found.members)]
        sure = pairs.sigma_m[np.ix_(members, members)] <= sure_m[members]
        _, chain = connected_components(csr_array(sure), directed=False)
        for number in range(int(chain.max()) + 1):
            linked = members[chain == number]
            votes[linked] = independent(ends, linked.tolist(), graph.path, _CLOSURE_APART_M)
        left = left[~_same_parts(graph, ends, members[:1])[left, 0]]
    return votes, cut_short


def _outvoted(graph: Graph, ends: Ends, pairs: Pairs, winners: BoolArray) -> BoolArray:
    """(c,) whether most of the winners of the same parts disagree with a closure."""
    same = _same_parts(graph, ends, np.arange(len(winners))) & winners
    against = (same & ~pairs.agree).sum(axis=1)
    return np.asarray(~winners & (2 * against > same.sum(axis=1)), dtype=bool)


def _same_parts(graph: Graph, ends: Ends, rows: IntArray) -> BoolArray:
    """(c, r) whether closures lie between the same two parts as those of some rows."""
    i, j = graph.parts[ends.i], graph.parts[ends.j]
    return np.asarray((i[:, None] == i[rows]) & (j[:, None] == j[rows]))
