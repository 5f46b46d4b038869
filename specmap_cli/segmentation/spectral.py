"""Algorithm 2 of the paper on a connected graph: similarity, eigenvectors, k-means.

Brunskill, Kollar and Roy, "Topological Mapping Using Spectral Clustering and Classification",
IROS 2007, section II-A. A whole map is clustered in parts, by `graph_division.py`; what the default
settings add (docs/segmentation.md) stands in `division.py`, around the algorithm and not in it.
Nothing here is random: equal input gives equal output.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse
from scipy.linalg import eigh
from scipy.sparse.linalg import ArpackNoConvergence, eigsh

from specmap_cli.core.geometry import FloatArray
from specmap_cli.segmentation.visibility import IndexArray, LabelArray

_NARROW = 1 << 16  # nodes whose numbers fit 16 bits: numpy sorts such numbers in linear time

_DENSE = 160  # rows up to which solving for all eigenpairs is quicker than iterating
_TOLERANCE = 1e-6  # far below what moves a count of eigenvalues
_FIRST, _NODES_A_CLUSTER = 12, 80  # eigenpairs asked for at first: a guess that is seldom short
_START_SEED, _START_RANGE = 0, (0.5, 1.5)  # positive, so never at right angles to the first vector

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


def clusters_of(L: Any, degrees: FloatArray, least: float) -> Spectrum:
    """Lines 3 to 7 of Algorithm 2 for a connected part: L (n, n) sparse, its D_ii `degrees` (n,).

    k is the number of eigenvalues above `least`. k-means starts at the row of the best and of the
    least connected node, so it needs no random numbers.
    """
    values, vectors = eigenpairs_above(L, least)
    k = max(1, int((values > least).sum()))  # Algorithm 2, line 3
    X = vectors[:, :k]  # Algorithm 2, line 4
    Y = unit_rows(X)  # Algorithm 2, line 5
    starts = [int(degrees.argmax()), int(degrees.argmin())]
    labels = kmeans_unit(Y, k, starts)  # Algorithm 2, lines 6 and 7
    return Spectrum(labels=numbered(labels), eigenvalues=values, used=k)


def numbered(labels: LabelArray) -> LabelArray:
    """The labels (n,) renamed 0, 1, ... without empty clusters."""
    return np.unique(labels, return_inverse=True)[1].astype(np.int32)


def local_scales(
    lengths: FloatArray, pairs: IndexArray, nodes: int, neighbours: int = 0
) -> FloatArray:
    """(n,) sigma of eq. 1: the median distance to the `neighbours` nearest visible nodes, 0: all.

    `pairs` (m, 2) are visible nodes i < j and `lengths` (m,) their distances, in any one unit.
    Nodes that see no other get 1, which is never used.
    """
    rising = np.argsort(lengths)
    owner, distance = pairs[rising].ravel(), np.repeat(lengths[rising], 2)
    numbers = owner.astype(np.uint16) if nodes <= _NARROW else owner
    distance = distance[np.argsort(numbers, kind="stable")]
    count = np.bincount(owner, minlength=nodes)
    start = np.cumsum(count) - count
    used = np.minimum(count, neighbours) if neighbours else count
    scales = np.ones(nodes)
    some = used > 0
    low, high = (start + (used - 1) // 2)[some], (start + used // 2)[some]
    scales[some] = 0.5 * (distance[low] + distance[high])
    return scales


def edge_weights(lengths: FloatArray, pairs: IndexArray, scales: FloatArray) -> FloatArray:
    """(m,) S_ij of eq. 1 for the visible pairs (m, 2)."""
    product = scales[pairs[:, 0]] * scales[pairs[:, 1]]
    return np.asarray(np.exp(-(lengths**2) / product))  # eq. 1


def similarity(lengths: FloatArray, pairs: IndexArray, scales: FloatArray, nodes: int) -> Any:
    """S of eq. 1, (n, n) sparse and symmetric: zero on the diagonal and between unseen pairs."""
    weight = edge_weights(lengths, pairs, scales)
    half = sparse.coo_array((weight, (pairs[:, 0], pairs[:, 1])), shape=(nodes, nodes)).tocsr()
    return (half + half.T).tocsr()


def normalised(affinity: Any) -> tuple[Any, FloatArray]:
    """L = D^-1/2 S D^-1/2 (n, n) sparse, and the degrees D_ii (n,); rows of zeros stay zero."""
    degrees = np.asarray(affinity.sum(axis=1), dtype=np.float64).ravel()  # Algorithm 2, line 2
    inverse = np.zeros(len(degrees))
    inverse[degrees > 0] = degrees[degrees > 0] ** -0.5
    scaling = sparse.diags_array(inverse)
    return (scaling @ affinity @ scaling).tocsr(), degrees  # Algorithm 2, line 2


def dense_similarity(
    lengths: FloatArray, pairs: IndexArray, scales: FloatArray, nodes: int
) -> FloatArray:
    """`similarity` as an array (n, n): quicker for the few hundred nodes of a test."""
    S = np.zeros((nodes, nodes))
    i, j = pairs[:, 0], pairs[:, 1]
    S[i, j] = S[j, i] = edge_weights(lengths, pairs, scales)
    return S


def dense_normalised(S: FloatArray) -> FloatArray:
    """`normalised` of an array S (n, n): L = D^-1/2 S D^-1/2."""
    degrees = S.sum(axis=1)
    inverse = np.zeros(len(degrees))
    inverse[degrees > 0] = degrees[degrees > 0] ** -0.5
    return np.asarray(S * inverse[:, None] * inverse)  # Algorithm 2, line 2


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
    few, found = size > _DENSE and count <= size // 2, None
    if few:
        start = np.random.default_rng(_START_SEED).uniform(*_START_RANGE, size)
        with suppress(ArpackNoConvergence):  # of a long corridor many are nearly the same
            rows = sparse.csr_array(matrix)
            found = eigsh(rows, k=count, which="LA", v0=start, tol=tolerance)
    if found is None:  # by solving for all of them
        values, vectors = np.linalg.eigh(matrix.toarray() if sparse.issparse(matrix) else matrix)
        values, vectors = values[::-1][:count], vectors[:, ::-1][:, :count]
    else:
        values, vectors = found
    if few:
        order = np.argsort(-values, kind="stable")
        values, vectors = values[order], vectors[:, order]
    return np.asarray(values), with_fixed_signs(vectors)


def two_largest(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The two largest eigenvalues, falling, and eigenvectors (n, 2) of a dense matrix (n, n)."""
    size = len(matrix)
    values, vectors = eigh(matrix, subset_by_index=[size - 2, size - 1])
    return np.asarray(values[::-1]), with_fixed_signs(vectors[:, ::-1])


def with_fixed_signs(vectors: FloatArray) -> FloatArray:
    """Eigenvectors (n, k), each turned so that the sum of its cubes is not negative."""
    return np.asarray(vectors * np.where((vectors**3).sum(axis=0) < 0.0, -1.0, 1.0))


def eigenpairs_above(matrix: Any, least: float) -> tuple[FloatArray, FloatArray]:
    """All eigenpairs with eigenvalues above `least`, and at least one below where there is one."""
    size = matrix.shape[0]
    count = min(_FIRST + size // _NODES_A_CLUSTER, size)
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
    best, least = np.zeros(len(rows), dtype=np.int32), np.inf
    if clusters <= 1 or len(rows) <= 1:
        return best
    for row in first:
        taken, similarity = [row], np.abs(rows @ rows[row])
        for _ in range(1, min(clusters, len(rows))):
            taken.append(int(similarity.argmin()))
            np.maximum(similarity, np.abs(rows @ rows[taken[-1]]), out=similarity)
        centres, labels = rows[taken], np.full(len(rows), -1, dtype=np.int32)
        for _ in range(_ROUNDS):
            scores = rows @ centres.T - 0.5 * (centres**2).sum(axis=1)
            found = scores.argmax(axis=1).astype(np.int32)
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
