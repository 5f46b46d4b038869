"""A visibility graph divided into clusters: Algorithm 2, in parts where the graph is large.

Algorithm 2 takes about one eigenvector a room, of one entry a node: the cost of a whole building
grows with the third power of its rooms. But what lies behind a neck hardly moves the clusters on
this side of it. So a large graph is cut where the least similarity is lost, into halves and
halves again, until each part is small; then the cost grows with the number of parts. What lies at
a cut is clustered once more: there the clusters end where others do, and not at a cut.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.settings import SegmentationConfig
from specmap_cli.grids.gridmap import BoolArray
from specmap_cli.segmentation.spectral import (
    Spectrum,
    bisect,
    clusters_of,
    dense_normalised,
    dense_similarity,
    largest_eigenpairs,
    local_scales,
    normalised,
    numbered,
    similarity,
    two_largest,
)
from specmap_cli.segmentation.visibility import IndexArray, LabelArray, VisibilityGraph

_ROUGH = 1e-3  # tolerance: an order of the nodes is looked for, not their eigenvector
_LEAST_SHARE = 0.2  # of the degrees on either side: every cut leaves much smaller parts
_FEWEST_NODES = 4  # nodes of a cluster that is looked at: two for each half


def spectral_clusters(graph: VisibilityGraph, config: SegmentationConfig) -> Spectrum:
    """Algorithm 2 on `graph`, lines 3 to 7 for each of its parts by itself.

    Parts are connected components, which no eigenvector joins, and of components with more than
    `part_nodes` nodes what is left when they are cut at their necks. Clusters that a cut touches
    are dissolved and found once more, together with those beyond the cut.
    """
    nodes = len(graph.nodes)
    scales = local_scales(graph.lengths, graph.pairs, nodes, config.neighbours)
    S = similarity(graph.lengths, graph.pairs, scales, nodes)  # Algorithm 2, line 1
    L, degrees = normalised(S)  # Algorithm 2, line 2
    parts = parts_of(S, config.part_nodes)
    first = _clusters_of_parts(L, degrees, parts, config)
    part_of = np.zeros(nodes, dtype=np.intp)
    for number, part in enumerate(parts):
        part_of[part] = number
    ends = graph.pairs[part_of[graph.pairs[:, 0]] != part_of[graph.pairs[:, 1]]]
    cut = np.flatnonzero(np.isin(first.labels, first.labels[ends]))
    if not len(cut):
        return first
    again = [cut[part] for part in parts_of(S[cut][:, cut], config.part_nodes)]
    second = _clusters_of_parts(L, degrees, again, config)
    labels = np.where(second.labels < 0, first.labels, first.labels.max() + 1 + second.labels)
    return replace(first, labels=numbered(labels))


def _clusters_of_parts(
    L: Any, degrees: FloatArray, parts: Sequence[IndexArray], config: SegmentationConfig
) -> Spectrum:
    """Lines 3 to 7 for some parts of a graph of which L (n, n) is the whole's; -1 outside them.

    What a cut takes from the row of a node stays in its degree: it goes to a neighbour elsewhere.
    """
    labels = np.full(len(degrees), -1, dtype=np.int32)
    values, clusters, used = [np.zeros(0)], 0, 0
    for part in parts:
        found = clusters_of(L[part][:, part], degrees[part], config.eigenvalue_min)
        labels[part] = clusters + found.labels
        clusters += int(found.labels.max()) + 1
        values.append(found.eigenvalues)
        used += found.used
    return Spectrum(labels=labels, eigenvalues=np.sort(np.concatenate(values))[::-1], used=used)


def parts_of(S: Any, most: int) -> list[IndexArray]:
    """The nodes, ascending, of each part of a graph, the parts in the order of their first nodes.

    S (n, n) sparse is the similarity of eq. 1. A part is connected. One with more than `most` nodes
    is cut in two.
    """
    parts, pending = [], [np.arange(S.shape[0])]
    while pending:
        nodes = pending.pop()
        count, piece = connected_components(S[nodes][:, nodes], directed=False)
        for part in (nodes[piece == number] for number in range(count)):
            if len(part) <= most:
                parts.append(part)
            else:
                beyond = _beyond_the_neck(S[part][:, part])
                pending += [part[beyond], part[~beyond]]
    return sorted(parts, key=lambda part: int(part[0]))


def _beyond_the_neck(S: Any) -> BoolArray:
    """(n,) the nodes on one side of the best cut of a connected graph S (n, n).

    The nodes stand in the order of the second eigenvector. Of all cuts of this order the one with
    the smallest normalised cut is taken (Shi and Malik, "Normalized Cuts and Image Segmentation",
    PAMI 2000): similarity lost, over the sum of the degrees of either side.
    """
    L, degrees = normalised(S)
    _, vectors = largest_eigenpairs(L, 2, _ROUGH)
    order = np.argsort(vectors[:, 1] / np.sqrt(degrees), kind="stable")
    edges = S[order][:, order].tocoo()
    ends = np.minimum(edges.row, edges.col), np.maximum(edges.row, edges.col)
    begun, ended = (np.bincount(each, edges.data, len(order)) for each in ends)
    lost = np.cumsum(begun - ended)[:-1] / 2.0  # each edge stands in S twice
    before = np.cumsum(degrees[order])[:-1]
    after = degrees.sum() - before
    cost = lost / before + lost / after
    cost[np.minimum(before, after) < _LEAST_SHARE * degrees.sum()] = np.inf
    beyond = np.zeros(len(order), dtype=np.bool_)
    beyond[order[int(cost.argmin()) + 1 :]] = True
    return beyond


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
        nodes = len(part.nodes)
        if nodes < _FEWEST_NODES:
            continue
        i, j = part.pairs[:, 0], part.pairs[:, 1]
        scales = local_scales(part.lengths, part.pairs, nodes, neighbours)
        S = dense_similarity(part.lengths, part.pairs, scales, nodes)  # Algorithm 2, line 1
        values, vectors = two_largest(dense_normalised(S))  # Algorithm 2, lines 2 and 4
        if values[1] <= least and S.any(axis=1).all():
            continue  # of a graph in pieces the second eigenvalue is 1, or a node sees no other
        pieces, piece = connected_components(coo_array((S[i, j], (i, j)), S.shape), directed=False)
        other = piece > 0 if pieces > 1 else bisect(vectors[:, 0], vectors[:, 1]) == 1
        if not other.any() or other.all():
            continue
        labels[members[other]] = count
        count += 1
        pending += [
            (members[half], subgraph(part, np.flatnonzero(half))) for half in (~other, other)
        ]
    return numbered(labels)


def subgraph(graph: VisibilityGraph, members: IndexArray) -> VisibilityGraph:
    """The graph of some nodes, given by ascending number, and the edges between them."""
    place = np.full(len(graph.nodes), -1)
    place[members] = np.arange(len(members))
    pairs = place[graph.pairs]
    inside = (pairs >= 0).all(axis=1)
    return VisibilityGraph(graph.nodes[members], pairs[inside], graph.lengths[inside])
