"""Splitting clusters that are still two: Algorithm 2 with k = 2 inside each cluster."""

from __future__ import annotations

import numpy as np
from scipy.sparse.csgraph import connected_components

from specmap_cli.segmentation.affinity import local_scales, normalised, similarity
from specmap_cli.segmentation.kmeans import LabelArray, bisect
from specmap_cli.segmentation.spectrum import largest_eigenpairs
from specmap_cli.segmentation.visibility import IndexArray, VisibilityGraph

_FEWEST = 4  # nodes of a cluster that is looked at


def split_again(
    graph: VisibilityGraph, labels: LabelArray, neighbours: int, least: float
) -> LabelArray:
    """(n,) labels after halving every cluster whose own second eigenvalue is above `least`.

    Inside a cluster the scales of eq. 1 are measured anew, so that a room is seen apart from the
    piece of corridor it was put together with among all the rooms of the map.
    """
    labels = labels.copy()
    pending = list(range(int(labels.max(initial=-1)) + 1))
    count = len(pending)
    while pending:
        label = pending.pop()
        members = np.flatnonzero(labels == label)
        other = _second_half(subgraph(graph, members), neighbours, least)
        if other is None:
            continue
        labels[members[other]] = count
        pending += [label, count]
        count += 1
    return np.unique(labels, return_inverse=True)[1].astype(np.int32)


def subgraph(graph: VisibilityGraph, members: IndexArray) -> VisibilityGraph:
    """The graph of some nodes, given by ascending number, and the edges between them."""
    place = np.full(len(graph.nodes), -1)
    place[members] = np.arange(len(members))
    pairs = place[graph.pairs]
    inside = (pairs >= 0).all(axis=1)
    return VisibilityGraph(graph.nodes[members], pairs[inside], graph.lengths[inside])


def _second_half(part: VisibilityGraph, neighbours: int, least: float) -> IndexArray | None:
    """Numbers of the nodes to split off, None when the cluster stays whole."""
    nodes = len(part.nodes)
    if nodes < _FEWEST:
        return None
    scales = local_scales(part.lengths, part.pairs, nodes, neighbours)
    affinity = similarity(part.lengths, part.pairs, scales, nodes)
    pieces, piece = connected_components(affinity, directed=False)
    if pieces > 1:
        return np.flatnonzero(piece > 0)
    values, vectors = largest_eigenpairs(normalised(affinity)[0], 2)
    if values[1] <= least:
        return None
    other = np.flatnonzero(bisect(vectors[:, 0], vectors[:, 1]))
    return other if 0 < len(other) < nodes else None
