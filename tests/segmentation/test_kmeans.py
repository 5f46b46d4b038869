"""k-means without random numbers, against scikit-learn's from the same start."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.cluster import KMeans

from specmap_cli.core.geometry import FloatArray
from specmap_cli.segmentation.spectral import bisect, kmeans_unit, unit_rows
from specmap_cli.segmentation.visibility import LabelArray
from tests.strategies import few

seeds = st.integers(0, 10_000)


def directions(seed: int, count: int = 30, dimensions: int = 3) -> FloatArray:
    """Unit vectors, some alike."""
    rng = np.random.default_rng(seed)
    middles = rng.normal(size=(4, dimensions))
    return unit_rows(middles[rng.integers(0, 4, count)] + rng.normal(0.0, 0.4, (count, dimensions)))


def cost(rows: FloatArray, labels: LabelArray) -> float:
    """Sum of squared distances to the mean of each label."""
    groups = [rows[labels == label] for label in np.unique(labels)]
    return sum(float(((group - group.mean(axis=0)) ** 2).sum()) for group in groups)


def farthest_first(rows: FloatArray, clusters: int, first: int) -> list[int]:
    """The start of Ng, Jordan and Weiss: each row as nearly orthogonal to the others as can be."""
    taken = [first]
    while len(taken) < clusters:
        likeness = [max(abs(float(row @ rows[k])) for k in taken) for row in rows]
        taken.append(int(np.argmin(likeness)))
    return taken


@given(seeds, st.integers(2, 5))
@few(15)
def test_labels_are_scikit_learn_s_from_the_same_start(seed: int, clusters: int) -> None:
    rows = directions(seed)
    start = rows[farthest_first(rows, clusters, 3)]
    oracle = KMeans(clusters, init=start, n_init=1, algorithm="lloyd", tol=0.0).fit(rows)
    found = kmeans_unit(rows, clusters, [3])
    if len(np.unique(found)) == clusters:  # it deals otherwise with a centre that lost its rows
        np.testing.assert_array_equal(found, oracle.labels_)


@given(seeds)
def test_of_several_starts_the_best_wins(seed: int) -> None:
    rows = directions(seed)
    single = [cost(rows, kmeans_unit(rows, 4, [first])) for first in (0, 7, 19)]
    assert cost(rows, kmeans_unit(rows, 4, [0, 7, 19])) == pytest.approx(min(single))


@pytest.mark.parametrize("rows", [0, 1, 2, 3])
def test_more_clusters_than_rows_are_as_many_as_rows(rows: int) -> None:
    labels = kmeans_unit(np.eye(4)[:rows], 9, [0])
    assert labels.shape == (rows,)
    assert len(np.unique(labels)) == rows


@given(seeds)
def test_rows_of_unit_length_point_where_they_did(seed: int) -> None:
    X = np.random.default_rng(seed).normal(size=(8, 3))
    X[2] = 0.0
    Y = unit_rows(X)
    lengths = np.linalg.norm(Y, axis=1)
    np.testing.assert_allclose(np.delete(lengths, 2), 1.0)
    assert lengths[2] == 0.0
    np.testing.assert_allclose(Y * np.linalg.norm(X, axis=1)[:, None], X, atol=1e-12)


@given(seeds)
@few(10)
def test_two_clusters_are_the_best_of_all_cuts_when_they_stand_apart(seed: int) -> None:
    rng = np.random.default_rng(seed)
    side = rng.random(10) < 0.5
    side[:2] = False, True
    first = rng.uniform(0.2, 0.4, 10)
    other = first * np.where(side, 1.0, -0.5) + rng.normal(0.0, 0.01, 10)
    rows = unit_rows(np.column_stack([first, other]))
    cuts = [np.array(cut, dtype=np.int32) for cut in itertools.product((0, 1), repeat=10)]
    best = min((cut for cut in cuts if 0 < cut.sum() < 10), key=lambda cut: cost(rows, cut))
    labels = bisect(first, other)
    assert labels.tolist() in (best.tolist(), (1 - best).tolist())
    turned = bisect(first, -other)  # the sign of an eigenvector means nothing
    assert turned.tolist() in (labels.tolist(), (1 - labels).tolist())
