"""A large visibility graph cut into parts that hardly hang together, before it is clustered.

Algorithm 2 takes about one eigenvector a room, of one entry a node: the cost of a whole building
grows with the third power of its rooms. But what lies behind a neck hardly moves the clusters on
this side of it. So a large graph is cut where the least similarity is lost, into halves and
halves again, until each part is small; then the cost grows with the number of parts. What lies at
a cut is clustered once more: there the clusters end where others do, and not at a cut.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.sparse.csgraph import connected_components

from specmap_cli.grids.gridmap import BoolArray
from specmap_cli.segmentation.affinity import normalised
from specmap_cli.segmentation.kmeans import LabelArray
from specmap_cli.segmentation.spectrum import largest_eigenpairs
from specmap_cli.segmentation.visibility import IndexArray

_ROUGH = 1e-3  # tolerance: an order of the nodes is looked for, not their eigenvector
_LEAST_SHARE = 0.2  # of the degrees on either side: every cut leaves much smaller parts


def parts_of(S: Any, most: int) -> list[IndexArray]:
    """The nodes, ascending, of each part of a graph, the parts in the order of their first nodes.

    S (n, n) sparse is the similarity of eq. 1. A part is connected. One with more than `most` nodes
    is cut in two.
    """
    parts, pending = [], _pieces(S, np.arange(S.shape[0]))
    while pending:
        part = pending.pop()
        if len(part) <= most:
            parts.append(part)
            continue
        beyond = _beyond_the_neck(S[part][:, part])
        pending += _pieces(S, part[beyond]) + _pieces(S, part[~beyond])
    return sorted(parts, key=lambda part: int(part[0]))


def touched(pairs: IndexArray, parts: Sequence[IndexArray], labels: LabelArray) -> IndexArray:
    """The nodes, ascending, of all clusters with an edge from one part to another.

    `pairs` (m, 2) are the edges, `labels` (n,) the clusters.
    """
    part = np.zeros(len(labels), dtype=np.intp)
    for number, nodes in enumerate(parts):
        part[nodes] = number
    ends = pairs[part[pairs[:, 0]] != part[pairs[:, 1]]]
    return np.flatnonzero(np.isin(labels, labels[ends]))


def _pieces(S: Any, nodes: IndexArray) -> list[IndexArray]:
    """The connected pieces of some nodes of a graph."""
    count, piece = connected_components(S[nodes][:, nodes], directed=False)
    return [nodes[piece == number] for number in range(count)]


def _beyond_the_neck(S: Any) -> BoolArray:
    """(n,) the nodes on one side of the best cut of a connected graph S (n, n).

    The nodes stand in the order of the second eigenvector. Of all cuts of this order the one with
    the smallest normalised cut is taken (Shi and Malik, "Normalized Cuts and Image Segmentation",
    PAMI 2000): similarity lost, over the sum of the degrees of either side.
    """
    L, degrees = normalised(S)
    _, vectors = largest_eigenpairs(L, 2, _ROUGH)
    order = np.argsort(vectors[:, 1] / np.sqrt(degrees), kind="stable")
    lost = _lost_after_each(S[order][:, order])
    before = np.cumsum(degrees[order])[:-1]
    after = degrees.sum() - before
    cost = lost / before + lost / after
    cost[np.minimum(before, after) < _LEAST_SHARE * degrees.sum()] = np.inf
    beyond = np.zeros(len(order), dtype=np.bool_)
    beyond[order[int(cost.argmin()) + 1 :]] = True
    return beyond


def _lost_after_each(S: Any) -> Any:
    """(n - 1,) the similarity between the nodes up to each one and those after it."""
    size = S.shape[0]
    edges = S.tocoo()
    first, last = np.minimum(edges.row, edges.col), np.maximum(edges.row, edges.col)
    begun, ended = (np.bincount(ends, edges.data, size) for ends in (first, last))
    return np.cumsum(begun - ended)[:-1] / 2.0  # each edge stands in S twice
