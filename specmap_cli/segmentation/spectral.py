"""Algorithm 2 of the paper on a visibility graph: similarity, eigenvectors, k-means.

Brunskill, Kollar and Roy, "Topological Mapping Using Spectral Clustering and Classification",
IROS 2007, section II-A. What the default settings add to it stands in `division.py`, around the
algorithm and not in it, but for two things. A large graph is cut first: Algorithm 2 takes about one
eigenvector a room, of one entry a node, so the cost of a whole building grows with the third power
of its rooms, while what lies behind a neck hardly moves the clusters on this side of it. And
clusters are halved by `split_again`. Nothing here is random: equal input gives equal output.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import sparse
from scipy.linalg import eigh
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import ArpackNoConvergence, eigsh

from specmap_cli.core.errors import NoResultError
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.settings import SegmentationConfig
from specmap_cli.grids.gridmap import BoolArray
from specmap_cli.segmentation.visibility import IndexArray, LabelArray, VisibilityGraph

MOST_REGIONS = (1 << 15) - 2  # labels of cells have 16 bits
_AT_ONCE = 1 << 18  # entries of a sparse matrix looked at in one go
_NARROW = 1 << 16  # nodes whose numbers fit 16 bits: numpy sorts such numbers in linear time

_DENSE = 160  # rows up to which solving for all eigenpairs is quicker than iterating
_TOLERANCE = 1e-6  # far below what moves a count of eigenvalues
_ROUGH = 1e-3  # tolerance where an order of the nodes is looked for, not their eigenvector
_ABOVE = 0.8  # of the sum of all squared eigenvalues, which is known: seldom more of them count
_START_SEED, _START_RANGE = 0, (0.5, 1.5)  # positive, so never at right angles to the first vector

_EVENED = 2  # times: nodes of two groups that see each other stand in the order of what they see
_LEAST_SHARE = 0.2  # of the degrees on either side: every cut leaves much smaller parts
_FEWEST_NODES = 4  # nodes of a cluster that is looked at: two for each half

_ROUNDS = 100  # of Lloyd's iteration, which ends by itself after some ten
_TIE = 1e-9  # costs this close are a tie
_TINY = 1e-12  # keeps a row of zeros from dividing by zero


@dataclass(frozen=True, slots=True, kw_only=True)
class Spectrum:
    """What Algorithm 2 found in a graph of n nodes.

    `labels` (n,) 0, 1, ... the cluster of each node; `eigenvalues` (m,) falling, of all parts
    together; `used` is the number of those that count, which is k summed over the parts.
    """

    labels: LabelArray
    eigenvalues: FloatArray
    used: int


def spectral_clusters(graph: VisibilityGraph, config: SegmentationConfig) -> Spectrum:
    """Algorithm 2 on `graph`, lines 3 to 7 for each of its parts by itself (`parts_of`).

    Clusters that a cut touches are dissolved and found once more, together with those beyond the
    cut: there they end where others do, and not at the cut.
    """
    S = similarity(graph, config.neighbours)  # Algorithm 2, line 1
    parts = parts_of(S, config.part_nodes)
    found = clusters_of(S, parts, config.eigenvalue_min)
    labels, part_of = found.labels, np.zeros(len(graph.nodes), dtype=np.intp)
    for number, part in enumerate(parts):
        part_of[part] = number
    ends = graph.pairs[part_of[graph.pairs[:, 0]] != part_of[graph.pairs[:, 1]]]
    cut = np.flatnonzero(np.isin(labels, labels[ends]))
    if len(cut):
        again = [cut[part] for part in parts_of(_within(S, cut), config.part_nodes)]
        new = clusters_of(S, again, config.eigenvalue_min).labels
        labels = np.where(new < 0, labels, labels.max() + 1 + new)
    return replace(found, labels=numbered(labels))


def clusters_of(S: Any, parts: Sequence[IndexArray], least: float) -> Spectrum:
    """Lines 2 to 7 of Algorithm 2 for each of some parts of a graph; label -1 outside them.

    The D_ii are those of the whole graph S (n, n), sparse: what a cut takes from the row of a node
    stays in its degree, as it goes to a neighbour elsewhere. k is the number of eigenvalues above
    `least`. k-means starts at the row of the best and of the least connected node, so it needs no
    random numbers.
    """
    degrees = np.asarray(S.sum(axis=1)).ravel()
    labels = np.full(len(degrees), -1, dtype=np.int16)
    eigenvalues, used = [np.zeros(0)], 0
    for later, part in zip(range(len(parts) - 1, -1, -1), parts, strict=True):
        L, _ = normalised(_within(S, part), degrees[part])  # Algorithm 2, line 2
        values, vectors = eigenpairs_above(L, least)
        k = max(1, int((values > least).sum()))  # Algorithm 2, line 3
        X = vectors[:, :k]  # Algorithm 2, line 4
        Y = unit_rows(X)  # Algorithm 2, line 5
        starts = [int(degrees[part].argmax()), int(degrees[part].argmin())]
        if used + k + later > MOST_REGIONS:
            raise NoResultError(
                f"more than {MOST_REGIONS:,} pieces of free space apart from each other",
                "check the resolution and the thresholds: is it the map of a building?",
            )
        labels[part] = used + kmeans_unit(Y, k, starts)  # Algorithm 2, lines 6 and 7
        eigenvalues.append(values)
        used += k
    falling = np.sort(np.concatenate(eigenvalues))[::-1]
    return Spectrum(labels=labels, eigenvalues=falling, used=used)


def parts_of(S: Any, most: int) -> list[IndexArray]:
    """The nodes, ascending, of each part of a graph, the parts in the order of their first nodes.

    S (n, n) sparse is the similarity of eq. 1. A part is connected. One with more than `most` nodes
    is cut in two.
    """
    parts, pending = [], [np.arange(S.shape[0])]
    while pending:
        nodes = pending.pop()
        some = S if len(nodes) == S.shape[0] else _within(S, nodes)
        # of a symmetric graph these are the pieces, found without a copy of it turned over
        count, piece = connected_components(some, connection="strong")
        for mine in (np.flatnonzero(piece == number) for number in range(count)):
            if len(mine) <= most:
                parts.append(nodes[mine])
                continue
            beyond = _beyond_the_neck(some if count == 1 else _within(some, mine))
            pending += [nodes[mine[beyond]], nodes[mine[~beyond]]]
    return sorted(parts, key=lambda part: int(part[0]))


def _within(S: Any, nodes: IndexArray) -> Any:
    """The rows and columns of S (n, n), in CSR, that are some nodes (k,), ascending: (k, k)."""
    number = np.full(S.shape[0], -1, dtype=np.int32)
    number[nodes] = np.arange(len(nodes), dtype=np.int32)
    rows = S[nodes]
    weights, columns, ends = rows.data, number[rows.indices], rows.indptr
    del rows  # its columns are memory that is needed
    stays = columns >= 0
    if not stays.all():  # else it is a piece, apart from all others
        ends = np.append(np.int32(0), np.cumsum(stays, dtype=np.int32))[ends]
        weights = weights[stays]
        columns = columns[stays]
    return sparse.csr_array((weights, columns, ends), (len(nodes), len(nodes)))


def _bands(S: Any) -> Iterator[tuple[slice, slice, IndexArray]]:
    """Rows of S (n, n), in CSR, their entries, and where rows begin: some at once, for memory."""
    first = 0
    while first < S.shape[0]:
        least = int(S.indptr[first]) + _AT_ONCE
        end = max(first + 1, int(np.searchsorted(S.indptr, least, side="right")) - 1)
        entries = slice(int(S.indptr[first]), int(S.indptr[end]))
        yield slice(first, end), entries, S.indptr[first:end] - entries.start
        first = end


def _beyond_the_neck(S: Any) -> BoolArray:
    """(n,) the nodes on one side of the best cut of a connected graph S (n, n).

    Of all cuts in the order of the second eigenvector, that of a graph of groups, evened out, it is
    the smallest normalised cut (Shi and Malik, "Normalized Cuts and Image Segmentation", PAMI
    2000).
    """
    degrees, group = np.asarray(S.sum(axis=1)).ravel(), _groups(S)
    ones = sparse.csr_array((np.ones(len(group)), (np.arange(len(group)), group)))
    # a band at a time: this bounds the memory
    between = sum(ones[rows].T.tocsr() @ (S[rows] @ ones) for rows, _, _ in _bands(S))
    between.sort_indices()
    L, of_groups = normalised(between)
    _, vectors = largest_eigenpairs(L, 2, _ROUGH)
    height = (vectors[:, 1] / np.sqrt(of_groups))[group]
    for _ in range(_EVENED):
        height = (S @ height) / degrees
    order = np.argsort(height, kind="stable")
    place = np.empty(len(order), dtype=np.int32)
    place[order] = np.arange(len(order), dtype=np.int32)
    begun, counts = np.empty(len(order)), np.diff(S.indptr)
    for rows, entries, starts in _bands(S):
        later = place[S.indices[entries]] > np.repeat(place[rows], counts[rows])
        signed = np.where(later, S.data[entries], -S.data[entries])
        begun[rows] = np.add.reduceat(signed, starts)
    lost = np.cumsum(begun[order])[:-1]
    before = np.cumsum(degrees[order])[:-1]
    after = degrees.sum() - before
    cost = lost / before + lost / after
    cost[np.minimum(before, after) < _LEAST_SHARE * degrees.sum()] = np.inf
    beyond = np.zeros(len(order), dtype=np.bool_)
    beyond[order[int(cost.argmin()) + 1 :]] = True
    return beyond


def _groups(S: Any) -> IndexArray:
    """(n,) the number of the group of like nodes that each node of a connected graph is in.

    Nodes have fixed random heights. Each goes up to the one it sees whose height times their
    similarity is the largest; those with none above them are far apart.
    """
    size, counts = S.shape[0], np.diff(S.indptr)
    heights = np.random.default_rng(_START_SEED).uniform(size=size)
    most, above = np.empty(size), np.arange(size)
    for rows, entries, starts in _bands(S):
        drawn = S.data[entries] * heights[S.indices[entries]]
        most[rows] = np.maximum.reduceat(drawn, starts)
        best = np.flatnonzero(drawn == np.repeat(most[rows], counts[rows]))
        owner = rows.start + np.searchsorted(starts, best, side="right") - 1
        above[owner] = S.indices[entries][best]
    above = np.where(most > heights, above, np.arange(size))
    while (above != above[above]).any():
        above = above[above]
    groups = np.unique(above, return_inverse=True)[1]
    return groups if groups.max() > 1 else np.arange(size)  # of two groups one may be nearly all


def split_again(
    graph: VisibilityGraph, labels: LabelArray, neighbours: int, least: float
) -> LabelArray:
    """(n,) labels after halving every cluster whose own second eigenvalue is above `least`.

    Inside a cluster the scales of eq. 1 are measured anew, so that a room is seen apart from the
    piece of corridor it was put together with among all the rooms of the map.
    """
    labels = labels.copy()
    (i, j), count = graph.pairs.T.copy(), int(labels.max(initial=-1)) + 1
    within = np.flatnonzero(labels[i] == labels[j])
    within = within[np.argsort(labels[i[within]], kind="stable")]
    ends = np.cumsum(np.bincount(labels[i[within]], minlength=count))
    pending = list(enumerate(np.split(within, ends[:-1])))  # clusters, and the links in each
    while pending:
        label, inside = pending.pop()
        members = np.flatnonzero(labels == label)
        if len(members) < _FEWEST_NODES:
            continue
        pairs = np.searchsorted(members, graph.pairs[inside])
        part = VisibilityGraph(graph.nodes[members], pairs, graph.lengths[inside])
        S = similarity(part, neighbours, dense=True)  # Algorithm 2, line 1
        values, vectors = largest_of(normalised(S)[0], 2)  # Algorithm 2, lines 2 and 4
        if values[1] <= least and S.any(axis=1).all():
            continue  # of a graph in pieces the second eigenvalue is 1, or a node sees no other
        links = sparse.coo_array((np.ones(len(pairs)), pairs.T), S.shape)
        pieces, piece = connected_components(links, directed=False)
        other = piece > 0 if pieces > 1 else bisect(vectors[:, 0], vectors[:, 1]) == 1
        if other.any() and not other.all():
            labels[members[other]] = count
            halves = labels[i[inside]], labels[j[inside]]
            for half in (label, count):
                pending.append((half, inside[(halves[0] == half) & (halves[1] == half)]))
            count += 1
    return numbered(labels)


def numbered(labels: LabelArray) -> LabelArray:
    """The labels (n,) renamed 0, 1, ... without empty clusters."""
    return np.unique(labels, return_inverse=True)[1].astype(np.int16)


def local_scales(graph: VisibilityGraph, neighbours: int) -> FloatArray:
    """(n,) sigma of eq. 1: the median distance to the `neighbours` nearest visible nodes, 0: all.

    Nodes that see no other get 1, which is never used.
    """
    nodes, squared = len(graph.nodes), np.rint(graph.lengths**2)  # whole: of cells
    small = squared.max(initial=0.0) < _NARROW
    rising = np.argsort(squared.astype(np.uint16) if small else squared, kind="stable")
    del squared
    owner, distance = graph.pairs[rising].ravel(), graph.lengths[rising]
    del rising
    count = np.bincount(owner, minlength=nodes)
    owner = owner.astype(np.uint16) if nodes <= _NARROW else owner
    order = np.argsort(owner, kind="stable")  # of the ends of all pairs, two each
    start = np.cumsum(count) - count
    used = np.minimum(count, neighbours) if neighbours else count
    scales = np.ones(nodes)
    some = used > 0
    low, high = (start + (used - 1) // 2)[some], (start + used // 2)[some]
    scales[some] = 0.5 * (distance[order[low] // 2] + distance[order[high] // 2])
    return scales


def similarity(
    graph: VisibilityGraph, neighbours: int, multiple: float = 1.0, *, dense: bool = False
) -> Any:
    """S of eq. 1, (n, n), symmetric: zero on the diagonal and between nodes that see no other.

    Sigma is a `multiple` of `local_scales`. S is sparse, or `dense`, an array: quicker for some
    hundred nodes.
    """
    scales, nodes = multiple * local_scales(graph, neighbours), len(graph.nodes)
    i, j = graph.pairs.T
    weight = -(graph.lengths**2)
    weight /= scales[i] * scales[j]
    np.exp(weight, out=weight)  # eq. 1
    if dense:
        S = np.zeros((nodes, nodes))
        S[i, j] = S[j, i] = weight
        return S
    half = sparse.coo_array((weight, (i, j)), shape=(nodes, nodes)).tocsr()
    del weight
    return (half + half.T).tocsr()


def normalised(S: Any, degrees: FloatArray | None = None) -> tuple[Any, FloatArray]:
    """L = D^-1/2 S D^-1/2 (n, n), and the degrees D_ii (n,); rows of zeros stay zero.

    S is sparse, or an array, and L is like it. `degrees` are given for a part of a graph.
    """
    if degrees is None:
        degrees = np.asarray(S.sum(axis=1), dtype=np.float64).ravel()  # Algorithm 2, line 2
    inverse = np.zeros(len(degrees))
    inverse[degrees > 0] = degrees[degrees > 0] ** -0.5
    if not sparse.issparse(S):
        return S * inverse[:, None] * inverse, degrees  # Algorithm 2, line 2
    scaling = sparse.diags_array(inverse)
    return (scaling @ S @ scaling).tocsr(), degrees  # Algorithm 2, line 2


def largest_eigenpairs(
    matrix: Any, count: int, tolerance: float = _TOLERANCE
) -> tuple[FloatArray, FloatArray]:
    """The `count` largest eigenvalues (k,), falling, and eigenvectors (n, k) of a symmetric matrix.

    `matrix` (n, n) is an array, or sparse; `tolerance`, relative, is that of the iteration, which
    starts from a fixed vector. Each eigenvector's sign makes its sum of cubes positive, so equal
    input gives equal output.
    """
    size = matrix.shape[0]
    count = min(count, size)
    if size > _DENSE and count <= size // 2:
        start = np.random.default_rng(_START_SEED).uniform(*_START_RANGE, size)
        with suppress(ArpackNoConvergence):  # of a long corridor many are nearly the same
            rows = sparse.csr_array(matrix)
            values, vectors = eigsh(rows, k=count, which="LA", v0=start, tol=tolerance)
            order = np.argsort(-values, kind="stable")
            return values[order], with_fixed_signs(vectors[:, order])
    values, vectors = np.linalg.eigh(matrix.toarray() if sparse.issparse(matrix) else matrix)
    return values[::-1][:count], with_fixed_signs(vectors[:, ::-1][:, :count])


def largest_of(matrix: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
    """As `largest_eigenpairs`, exact: for some hundred rows of an array and few eigenpairs."""
    size = len(matrix)
    last = [max(0, size - count), size - 1]
    values, vectors = eigh(matrix, subset_by_index=last, check_finite=False)
    return np.asarray(values[::-1]), with_fixed_signs(vectors[:, ::-1])


def with_fixed_signs(vectors: FloatArray) -> FloatArray:
    """Eigenvectors (n, k), each turned so that the sum of its cubes is not negative."""
    return np.asarray(vectors * np.where((vectors**3).sum(axis=0) < 0.0, -1.0, 1.0))


def eigenpairs_above(matrix: Any, least: float) -> tuple[FloatArray, FloatArray]:
    """All eigenpairs with eigenvalues above `least`, and at least one below where there is one.

    `matrix` (n, n) is sparse and symmetric.
    """
    size = matrix.shape[0]
    count = min(2 + math.ceil(_ABOVE * (matrix.data**2).sum()), size)
    while True:
        values, vectors = largest_eigenpairs(matrix, count)
        if count == size or values[-1] <= least:
            return values, vectors
        count = min(2 * count, size)


def kmeans_unit(rows: FloatArray, clusters: int, first: list[int]) -> LabelArray:
    """Cluster unit vectors `rows` (n, d) into at most `clusters`; (n,) labels.

    Lloyd's iteration runs once for each row number in `first`. The labels with the smallest sum of
    squared distances win, those of the earlier start on a tie. A start takes its row and then, one
    at a time, the row most nearly orthogonal to all taken before (Ng, Jordan and Weiss, "On
    Spectral Clustering", NIPS 2001).
    """
    best, least = np.zeros(len(rows), dtype=np.int16), np.inf
    for row in first:
        taken, likeness = [row], np.abs(rows @ rows[row])
        for _ in range(1, min(clusters, len(rows))):
            taken.append(int(likeness.argmin()))
            np.maximum(likeness, np.abs(rows @ rows[taken[-1]]), out=likeness)
        centres, labels = rows[taken], np.full(len(rows), -1, dtype=np.int16)
        for _ in range(_ROUNDS):
            scores = rows @ centres.T - 0.5 * (centres**2).sum(axis=1)
            found = scores.argmax(axis=1).astype(np.int16)
            if np.array_equal(found, labels):
                break
            labels = found
            members = np.zeros((len(centres), len(rows)))
            members[labels, np.arange(len(rows))] = 1.0
            counts = members.sum(axis=1, keepdims=True)
            means = members @ rows / np.maximum(counts, 1.0)
            centres = np.where(counts > 0, means, centres)  # one without rows stays where it was
        cost = float(((rows - centres[labels]) ** 2).sum())
        if cost < least - _TIE:
            best, least = labels, cost
    return best


def unit_rows(X: FloatArray) -> FloatArray:
    """The rows of X (n, k) made unit length; a row of zeros stays zero."""
    norm = np.sqrt((X**2).sum(axis=1, keepdims=True))
    return np.asarray(X / np.maximum(norm, _TINY))


def bisect(first: FloatArray, other: FloatArray) -> LabelArray:
    """Algorithm 2 with k = 2 on two eigenvectors (n,): the (n,) labels 0 and 1."""
    X = np.column_stack([first, other])  # Algorithm 2, line 4
    Y = unit_rows(X)  # Algorithm 2, line 5
    angle = np.arctan2(Y[:, 1], Y[:, 0])
    return kmeans_unit(Y, 2, [int(angle.argmax())])  # Algorithm 2, lines 6 and 7
