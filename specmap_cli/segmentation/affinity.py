"""The similarity of section II-A and its normalisation."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from specmap_cli.core.geometry import FloatArray
from specmap_cli.segmentation.visibility import IndexArray

_NARROW = 1 << 16  # nodes whose numbers fit 16 bits: numpy sorts such numbers in linear time


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
    scaling = sparse.diags_array(_inverse_roots(degrees))
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
    inverse = _inverse_roots(S.sum(axis=1))
    return np.asarray(S * inverse[:, None] * inverse)  # Algorithm 2, line 2


def _inverse_roots(degrees: FloatArray) -> FloatArray:
    """D^-1/2 (n,); of nodes that see no other, it is zero."""
    inverse = np.zeros(len(degrees))
    inverse[degrees > 0] = degrees[degrees > 0] ** -0.5
    return inverse
