"""Splitting clusters that are still two: Algorithm 2 with k = 2 inside each cluster."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from specmap_cli.grids.gridmap import BoolArray
from specmap_cli.segmentation.affinity import dense_normalised, dense_similarity, local_scales
from specmap_cli.segmentation.kmeans import LabelArray, bisect
from specmap_cli.segmentation.spectrum import two_largest
from specmap_cli.segmentation.visibility import IndexArray, VisibilityGraph

_FEWEST = 4  # nodes of a cluster that is looked at: two for each half


def split_again(
    graph: VisibilityGraph, labels: LabelArray, neighbours: int, least: float
) -> LabelArray:
    """(n,) labels after halving every cluster whose own second eigenvalue is above `least`.

    Inside a cluster the scales of eq. 1 are measured anew, so that a room is seen apart from the
    piece of corridor it was put together with among all the rooms of the map.
    """
    labels = labels.copy()
    count = int(labels.max(initial=-1)) + 1
    alike = labels[graph.pairs[:, 0]] == labels[graph.pairs[:, 1]]
    pairs, lengths = graph.pairs[alike], graph.lengths[alike]
    owner = labels[pairs[:, 0]]
    pending = []
    for label in range(count):
        members, own = np.flatnonzero(labels == label), owner == label
        whole = VisibilityGraph(graph.nodes, pairs[own], lengths[own])
        pending.append((members, subgraph(whole, members)))
    while pending:
        members, part = pending.pop()
        other = _second_half(part, neighbours, least)
        if other is None:
            continue
        labels[members[other]] = count
        count += 1
        pending += [
            (members[half], subgraph(part, np.flatnonzero(half))) for half in (~other, other)
        ]
    return np.unique(labels, return_inverse=True)[1].astype(np.int32)


def subgraph(graph: VisibilityGraph, members: IndexArray) -> VisibilityGraph:
    """The graph of some nodes, given by ascending number, and the edges between them."""
    place = np.full(len(graph.nodes), -1)
    place[members] = np.arange(len(members))
    pairs = place[graph.pairs]
    inside = (pairs >= 0).all(axis=1)
    return VisibilityGraph(graph.nodes[members], pairs[inside], graph.lengths[inside])


def _second_half(part: VisibilityGraph, neighbours: int, least: float) -> BoolArray | None:
    """(n,) the nodes to split off, None when the cluster stays whole."""
    nodes = len(part.nodes)
    if nodes < _FEWEST:
        return None
    i, j = part.pairs[:, 0], part.pairs[:, 1]
    scales = local_scales(part.lengths, part.pairs, nodes, neighbours)
    S = dense_similarity(part.lengths, part.pairs, scales, nodes)  # Algorithm 2, line 1
    values, vectors = two_largest(dense_normalised(S))  # Algorithm 2, lines 2 and 4
    if values[1] <= least and S.any(axis=1).all():
        return None  # of a graph in pieces the second eigenvalue is 1, or a node sees no other
    pieces, piece = connected_components(coo_array((S[i, j], (i, j)), S.shape), directed=False)
    if pieces > 1:
        return np.asarray(piece > 0)
    other = bisect(vectors[:, 0], vectors[:, 1]) == 1
    return other if other.any() and not other.all() else None
