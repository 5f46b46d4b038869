"""Chains of motions that nothing else ties, taken for one motion each: a smaller pose graph.

Most nodes of a path hang between their neighbours alone. Between two nodes that a loop ties, some
motions in a row say no more than their product with the sum of their errors (first order, as in
`uncertainty`), so that a graph solved again and again needs the ends of the chains only. What a
chain is stretched by in the end is shared out along it as its errors say.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from specmap_cli.core.geometry import FloatArray, compose, inverse3, invert, product
from specmap_cli.core.records import IntArray
from specmap_cli.layout.pose_graph import LinkArrays
from specmap_cli.layout.uncertainty import adjoint, moved_covariance

_LONGEST = 16  # motions in a chain: some 5 m, which bend too little for the second order


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
        """Of links whose first `motions` lead from each row to the next, in order."""
        kept, since = _kept(links, motions)
        there, sums, after, total = _along(links.z[:motions], links.w[:motions], since)
        start = np.searchsorted(kept, np.arange(motions + 1), side="right") - 1
        last = kept[1:] - 1  # motion of each chain
        share = np.zeros((motions + 1, 3, 3))
        inner = np.flatnonzero(since)
        share[inner] = product(sums[inner], inverse3(total)[last[start[inner]]])
        spread = moved_covariance(adjoint(invert(after[last])), total[last])
        loops = slice(motions, None)
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


def _kept(links: LinkArrays, motions: int) -> tuple[IntArray, IntArray]:
    """Rows that anything but two motions ties, and some more, so that no chain is too long.

    And for each row how many motions lead there from the last of these (M,).
    """
    tied = np.zeros(motions + 1, dtype=bool)
    tied[[0, motions]] = True
    tied[links.i[motions:]] = tied[links.j[motions:]] = True
    special = np.flatnonzero(np.isfinite(links.width[:motions]))
    tied[special] = tied[special + 1] = True
    rows, ends = np.arange(motions + 1), np.flatnonzero(tied)
    since = (rows - ends[np.searchsorted(ends, rows, side="right") - 1]) % _LONGEST
    return np.flatnonzero(since == 0), since


def _along(
    z: FloatArray, w: FloatArray, since: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Each row (M, 3) seen from the start of its chain, and its covariance there (M, 3, 3).

    And the same after the motion that follows each row, (M - 1, 3) and (M - 1, 3, 3). `z` and `w`
    are the motions, `since` (M,) their numbers in their chains.
    """
    there, sums = np.zeros((len(since), 3)), np.zeros((len(since), 3, 3))
    after, total, noise = np.array(z), np.zeros(w.shape), inverse3(w)
    for number in range(_LONGEST):
        rows = np.flatnonzero(since[:-1] == number)
        after[rows] = compose(there[rows], z[rows])
        total[rows] = sums[rows] + moved_covariance(adjoint(after[rows]), noise[rows])
        on = rows[since[rows + 1] > 0]
        there[on + 1], sums[on + 1] = after[on], total[on]
    return there, sums, after, total
