"""Largest eigenpairs of a normalised affinity, the same on every run."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse
from scipy.linalg import eigh
from scipy.sparse.linalg import ArpackNoConvergence, eigsh

from specmap_cli.core.geometry import FloatArray

_DENSE = 160  # rows up to which solving for all eigenpairs is quicker than iterating
_TOLERANCE = 1e-6  # far below what moves a count of eigenvalues
_FIRST, _NODES_A_CLUSTER = 12, 80  # eigenpairs asked for at first: a guess that is seldom short
_START_SEED, _START_RANGE = 0, (0.5, 1.5)  # positive, so never at right angles to the first vector


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
    if size <= _DENSE or count > size // 2:
        values, vectors = _all_at_once(matrix, count)
    else:
        start = np.random.default_rng(_START_SEED).uniform(*_START_RANGE, size)
        try:
            few = sparse.csr_array(matrix)
            values, vectors = eigsh(few, k=count, which="LA", v0=start, tol=tolerance)
        except ArpackNoConvergence:  # of a long corridor many eigenvalues are nearly the same
            values, vectors = _all_at_once(matrix, count)
        order = np.argsort(-values, kind="stable")
        values, vectors = values[order], vectors[:, order]
    return np.asarray(values), with_fixed_signs(vectors)


def _all_at_once(matrix: Any, count: int) -> tuple[FloatArray, FloatArray]:
    """The `count` largest eigenpairs of a matrix, falling, by solving for all of them."""
    values, vectors = np.linalg.eigh(matrix.toarray() if sparse.issparse(matrix) else matrix)
    return values[::-1][:count], vectors[:, ::-1][:, :count]


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
