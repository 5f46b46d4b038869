"""k-means on unit vectors, without random numbers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray

LabelArray = NDArray[np.int32]

_ROUNDS = 100  # of Lloyd's iteration, which ends by itself after some ten
_SLACK = 1e-9  # costs this close are a tie
_TINY = 1e-12  # keeps a row of zeros from dividing by zero


def kmeans_unit(rows: FloatArray, clusters: int, first: list[int]) -> LabelArray:
    """Cluster unit vectors `rows` (n, d) into at most `clusters`; (n,) labels.

    Lloyd's iteration runs once for each row number in `first`. The labels with the smallest sum of
    squared distances win, those of the earlier start on a tie. A start takes its row and then, one
    at a time, the row most nearly orthogonal to all taken before (Ng, Jordan and Weiss, "On
    Spectral Clustering", NIPS 2001).
    """
    if clusters <= 1 or len(rows) <= 1:
        return np.zeros(len(rows), dtype=np.int32)
    best, least = np.zeros(len(rows), dtype=np.int32), np.inf
    for row in first:
        labels, cost = _lloyd(rows, rows[_orthogonal_start(rows, clusters, row)])
        if cost < least - _SLACK:
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


def _orthogonal_start(rows: FloatArray, clusters: int, first: int) -> list[int]:
    """Numbers of `clusters` rows, each the least similar to those before it."""
    taken = [first]
    similarity = np.abs(rows @ rows[first])
    for _ in range(1, min(clusters, len(rows))):
        taken.append(int(similarity.argmin()))
        np.maximum(similarity, np.abs(rows @ rows[taken[-1]]), out=similarity)
    return taken


def _lloyd(rows: FloatArray, centres: FloatArray) -> tuple[LabelArray, float]:
    """Labels (n,) and the sum of squared distances to the centres."""
    labels = np.full(len(rows), -1, dtype=np.int32)
    for _ in range(_ROUNDS):
        scores = rows @ centres.T - 0.5 * (centres**2).sum(axis=1)
        found = scores.argmax(axis=1).astype(np.int32)
        if np.array_equal(found, labels):
            break
        labels = found
        centres = _means(rows, labels, centres)
    return labels, float(((rows - centres[labels]) ** 2).sum())


def _means(rows: FloatArray, labels: LabelArray, centres: FloatArray) -> FloatArray:
    """Means (k, d) of the rows of each label; a centre without rows stays where it was."""
    members = np.zeros((len(centres), len(rows)))
    members[labels, np.arange(len(rows))] = 1.0
    counts = members.sum(axis=1)
    means = np.asarray(members @ rows / np.maximum(counts, 1.0)[:, None])
    means[counts == 0] = centres[counts == 0]
    return means
