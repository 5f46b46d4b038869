"""Drafts of the layout solved: as they are, over any drift, and without what does not fit.

Most nodes of a path hang between their neighbours alone. Between two nodes that a loop ties, some
motions in a row say no more than their product with the sum of their errors (first order, as in
`uncertainty`), so that a graph solved again and again needs the ends of such chains only. What a
chain is stretched by in the end is shared out along it as its errors say.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2, compose, inverse3, invert, product
from specmap_cli.core.records import IntArray
from specmap_cli.layout.path_graph import Draft, Graph
from specmap_cli.layout.pose_graph import (
    SETTLED,
    adjoint,moved_covariance,
    Link,
    LinkArrays,
    Solution,
    errors,
    solve,
    squared,
)

_KERNEL_SIGMAS = 2.0  # closures and passes farther off than this pull less and less
_OUTLIER_CHI2 = 25.0  # closures and passes above it, five sigmas off, are dropped in the end
_SOLVE_ITERATIONS = 20  # steps of the solver at the most
_HASTY = 5  # steps at a width that the next one replaces
_ROUGHLY = 1e-3  # share of the cost below which a step moves nodes by a millimetre or two
_EXACT = 1e-8  # metres and radians: what rounding makes of a motion that fits
_DECIMALS = 9  # of poses solved: a nanometre; libraries differ from the fourteenth on
_NARROWER = 3.0  # from one width of the kernel to the next: outvoted closures let go one by one

_LONGEST = 16  # motions in a chain: some 5 m, which bend too little for the second order


def solved(graph: Graph, draft: Draft, *, roughly: bool = False) -> Draft:
    """The draft with the poses that fit its links best; roughly to look for more from there."""
    solution = _solution(graph, draft, _KERNEL_SIGMAS, _ROUGHLY if roughly else SETTLED)
    draft = replace(draft, poses=solution.poses)
    return draft.counting("solve_iterations", not solution.converged)


def tighten(graph: Graph, draft: Draft) -> Draft:
    """Loops pull over any drift at first; those outvoted are let go step by step.

    Graduated non-convexity (Yang et al., RA-L 2020): Cauchy's kernel starts wider than the largest
    error and narrows to its usual width. Solved roughly: others follow, `settle` the last of them.
    """
    solution = _solution(graph, draft, np.inf, _ROUGHLY)
    width = float(np.sqrt(solution.chi2[len(graph.odometry) :].max(initial=0.0)))
    while width > _KERNEL_SIGMAS:
        rounded = replace(draft, poses=np.round(solution.poses, _DECIMALS))
        solution = _solution(graph, rounded, width, _ROUGHLY, hasty=True)
        width /= _NARROWER
    return solved(graph, replace(draft, poses=solution.poses), roughly=True)


def settle(graph: Graph, draft: Draft) -> tuple[Draft, tuple[Link, ...]]:
    """The draft solved without the loops that do not fit, and these loops.

    What does not fit is dropped and the rest solved anew until all that is left fits.
    """
    dropped: list[Link] = []
    while True:
        solution = _solution(graph, draft, _KERNEL_SIGMAS)
        fits = solution.chi2[len(graph.odometry) :] <= _OUTLIER_CHI2
        dropped += [link for link, fit in zip(draft.loops, fits, strict=True) if not fit]
        loops = tuple(link for link, fit in zip(draft.loops, fits, strict=True) if fit)
        draft = replace(draft, poses=solution.poses, loops=loops)
        draft = draft.counting("solve_iterations", not solution.converged)
        if fits.all():
            return draft, tuple(dropped)


def _solution(
    graph: Graph, draft: Draft, width: float, settled: float = SETTLED, *, hasty: bool = False
) -> Solution:
    """The solution with Cauchy's kernel of `width` sigmas on the loops.

    Where a rough one will do the chains of the path are solved as one motion each.
    """
    widths = {"closure": width, "nearby": width, "loose": _KERNEL_SIGMAS, "bridge": _KERNEL_SIGMAS}
    motions = list(graph.odometry)
    for row, motion in enumerate(motions):
        # where a part was placed, the guess that led to it says nothing any more: it holds the part
        # where it is, so that it does not bend the path that closures tie
        if motion.kind == "loose" and int(graph.parts[row + 1]) in draft.tied:
            placed = compose(invert(draft.poses[row]), draft.poses[row + 1])
            motions[row] = replace(motion, source_from_target=Pose2(*placed.tolist()))
    links = LinkArrays.of((*motions, *draft.loops), graph.row, widths)
    steps = _HASTY if hasty else _SOLVE_ITERATIONS
    # what follows the last row that a link may move hangs on it by motions and goes with it
    missed = errors(draft.poses, links.i, links.j, links.z)
    pulls = np.abs(missed).max(axis=1, initial=0.0) > _EXACT
    pulls[len(motions) :] = True
    count = 1 + int(np.maximum(links.i, links.j)[pulls].max(initial=0))
    path, inner = draft.poses[:count], (links.i < count) & (links.j < count)
    some = LinkArrays._make(each[inner] for each in links)
    if settled <= SETTLED:
        found = solve(path, some, steps, settled)
    else:
        condensed = Condensed.of(some, count - 1)
        found = solve(path[condensed.kept], condensed.links, steps, settled)
        found = replace(found, poses=condensed.expanded(found.poses))
    tail = compose(invert(draft.poses[count - 1]), draft.poses[count:])
    poses = np.concatenate([found.poses, compose(found.poses[-1], tail)])
    return replace(found, poses=poses, chi2=squared(poses, links))


@dataclass(frozen=True, slots=True)
class Condensed:
    """The rows `kept` (K,) of a path of M nodes, ascending, and the links between them.

    `start` (M,) is the number of the kept row that each row follows or is. `there` (M, 3) is each
    row seen from that one along the motions, and `share` (M, 3, 3) what it takes of a motion of the
    end of its chain, in the frame of that kept row.
    """

    kept: IntArray
    links: LinkArrays
    start: IntArray
    there: FloatArray
    share: FloatArray

    @classmethod
    def of(cls, links: LinkArrays, motions: int) -> Condensed:
        """Of links whose first `motions` lead from each row to the next, in order.

        Rows that anything but two motions ties are kept, and some more: no chain is too long.
        """
        tied, loops = np.zeros(motions + 1, dtype=bool), slice(motions, None)
        tied[[0, motions]] = True
        tied[links.i[loops]] = tied[links.j[loops]] = True
        special = np.flatnonzero(np.isfinite(links.width[:motions]))
        tied[special] = tied[special + 1] = True
        rows, ends = np.arange(motions + 1), np.flatnonzero(tied)
        since = (rows - ends[np.searchsorted(ends, rows, side="right") - 1]) % _LONGEST
        kept = np.flatnonzero(since == 0)
        # each row seen from the start of its chain, and its covariance there; and the same after
        # the motion that follows each row
        z, w = links.z[:motions], links.w[:motions]
        there, sums = np.zeros((motions + 1, 3)), np.zeros((motions + 1, 3, 3))
        after, total, noise = np.array(z), np.zeros(w.shape), inverse3(w)
        for number in range(_LONGEST):  # of a motion in its chain
            here = np.flatnonzero(since[:-1] == number)
            after[here] = compose(there[here], z[here])
            total[here] = sums[here] + moved_covariance(adjoint(after[here]), noise[here])
            on = here[since[here + 1] > 0]
            there[on + 1], sums[on + 1] = after[on], total[on]
        start = np.searchsorted(kept, rows, side="right") - 1
        last = kept[1:] - 1  # motion of each chain
        share = np.zeros((motions + 1, 3, 3))
        inner = np.flatnonzero(since)
        share[inner] = product(sums[inner], inverse3(total)[last[start[inner]]])
        spread = moved_covariance(adjoint(invert(after[last])), total[last])
        chains = LinkArrays(
            i=np.concatenate([start[kept[:-1]], start[links.i[loops]]]),
            j=np.concatenate([start[kept[1:]], start[links.j[loops]]]),
            z=np.concatenate([after[last], links.z[loops]]),
            w=np.concatenate([inverse3(spread), links.w[loops]]),
            width=np.concatenate([links.width[last], links.width[loops]]),
        )
        return cls(kept, chains, start, there, share)

    def expanded(self, poses: FloatArray) -> FloatArray:
        """(M, 3) poses of all rows, those of the kept ones being `poses` (K, 3)."""
        ends = compose(invert(poses[:-1]), poses[1:])  # seen from the start of each chain
        motion = compose(ends, invert(self.links.z[: len(ends)]))
        motion = np.concatenate([motion, np.zeros((1, 3))])  # nothing follows the last row
        moved = np.einsum("mab,mb->ma", self.share, motion[self.start])
        return compose(poses[self.start], compose(moved, self.there))
