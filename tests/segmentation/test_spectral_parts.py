"""The pieces of eq. 1 and Algorithm 2 against dense and slow versions of themselves."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import sparse
from sklearn.metrics import adjusted_rand_score

from specmap_cli.core.config import SegmentationConfig
from specmap_cli.segmentation.affinity import local_scales, normalised, similarity
from specmap_cli.segmentation.halving import split_again, subgraph
from specmap_cli.segmentation.kmeans import bisect, kmeans_unit
from specmap_cli.segmentation.spectral import spectral_clusters
from specmap_cli.segmentation.spectrum import eigenpairs_above, largest_eigenpairs
from specmap_cli.segmentation.visibility import VisibilityGraph, near_pairs

seeds = st.integers(0, 10_000)


def blobs(seed: int, clusters: int = 3, each: int = 25) -> VisibilityGraph:
    """Groups of nodes that see each other, chained by a few sight lines."""
    rng = np.random.default_rng(seed)
    centres = np.column_stack([np.arange(clusters) * 60, np.zeros(clusters)])
    spread = rng.integers(0, 30, (clusters * each, 2))
    nodes = (np.repeat(centres, each, axis=0) + spread).astype(np.intp)
    pairs = near_pairs(nodes, 200.0)
    group = pairs // each
    bridge = (pairs[:, 1] == pairs[:, 0] + 1) & (group[:, 0] != group[:, 1])
    pairs = pairs[(group[:, 0] == group[:, 1]) | bridge]
    lengths = np.hypot(*(nodes[pairs[:, 0]] - nodes[pairs[:, 1]]).T)
    return VisibilityGraph(nodes, pairs, np.maximum(lengths, 1.0))


@given(seed=seeds, neighbours=st.sampled_from([0, 1, 3, 7]))
def test_scales_are_medians_of_the_nearest_visible_nodes(seed: int, neighbours: int) -> None:
    graph = blobs(seed, each=6)
    scales = local_scales(graph.lengths, graph.pairs, len(graph.nodes), neighbours)
    for node in range(len(graph.nodes)):
        seen = np.sort(graph.lengths[(graph.pairs == node).any(axis=1)])
        assert scales[node] == np.median(seen[:neighbours] if neighbours else seen)


@given(seed=seeds)
def test_similarity_is_equation_1(seed: int) -> None:
    graph = blobs(seed, each=6)
    count = len(graph.nodes)
    scales = local_scales(graph.lengths, graph.pairs, count)
    S = similarity(graph.lengths, graph.pairs, scales, count).toarray()
    assert (S >= 0.0).all()
    np.testing.assert_array_equal(S, S.T)
    assert not S.diagonal().any()
    for (i, j), length in zip(graph.pairs[::5], graph.lengths[::5], strict=True):
        assert S[i, j] == pytest.approx(np.exp(-(length**2) / (scales[i] * scales[j])))


@given(seed=seeds)
def test_the_normalised_affinity_has_largest_eigenvalue_one(seed: int) -> None:
    graph = blobs(seed, each=6)
    count = len(graph.nodes)
    S = similarity(graph.lengths, graph.pairs, np.full(count, 20.0), count)
    L, degrees = normalised(S)
    np.testing.assert_allclose(degrees, S.toarray().sum(axis=1))
    np.testing.assert_allclose(
        L.toarray(), S.toarray() / np.sqrt(np.outer(degrees, degrees)), atol=1e-12
    )
    assert largest_eigenpairs(L, 1)[0][0] == pytest.approx(1.0)


def test_a_node_that_sees_nothing_has_a_row_of_zeros() -> None:
    pairs = np.array([[0, 1]])
    L, degrees = normalised(similarity(np.ones(1), pairs, np.ones(3), 3))
    assert degrees[2] == 0.0
    assert np.isfinite(L.toarray()).all()


def random_symmetric(size: int) -> sparse.csr_array:
    rng = np.random.default_rng(size)
    half = sparse.random_array((size, size), density=0.05, rng=rng)
    return sparse.csr_array(half + half.T)


@pytest.mark.parametrize("size", [5, 90, 400])
def test_eigenpairs_are_those_of_a_dense_solver(size: int) -> None:
    matrix = random_symmetric(size)
    values, vectors = largest_eigenpairs(matrix, 5)
    np.testing.assert_allclose(values, np.linalg.eigvalsh(matrix.toarray())[::-1][:5], atol=1e-6)
    np.testing.assert_allclose(matrix @ vectors, vectors * values, atol=1e-4)
    assert ((vectors**3).sum(axis=0) >= 0.0).all()


def test_eigenpairs_are_the_same_on_every_run() -> None:
    matrix = random_symmetric(400)
    for one, other in zip(
        largest_eigenpairs(matrix, 6), largest_eigenpairs(matrix, 6), strict=True
    ):
        np.testing.assert_array_equal(one, other)


def test_all_eigenvalues_above_a_level_are_found() -> None:
    matrix = random_symmetric(400)
    every = np.linalg.eigvalsh(matrix.toarray())[::-1]
    level = float(every[120] + every[121]) / 2.0
    values, _ = eigenpairs_above(matrix, level)
    assert (values > level).sum() == 121


@given(seed=seeds)
def test_kmeans_finds_well_separated_directions(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = rng.permutation(np.repeat(np.arange(4), 10))
    rows = np.eye(4)[truth] + rng.normal(0.0, 0.05, (40, 4))
    rows /= np.linalg.norm(rows, axis=1, keepdims=True)
    assert adjusted_rand_score(truth, kmeans_unit(rows, 4, [0, 7])) == 1.0


def test_kmeans_of_one_cluster_or_equal_rows() -> None:
    rows = np.tile([1.0, 0.0], (6, 1))
    assert not kmeans_unit(rows, 1, [0]).any()
    assert len(np.unique(kmeans_unit(rows, 3, [0]))) == 1


def test_bisect_cuts_at_the_step_of_an_eigenvector() -> None:
    other = np.concatenate([np.full(30, -0.1), np.full(10, 0.3)])
    labels = bisect(np.full(40, 0.15), other)
    assert len(set(labels[:30])) == len(set(labels[30:])) == 1
    assert labels[0] != labels[-1]


@given(seed=seeds)
def test_clusters_are_the_groups_whatever_the_order_of_the_nodes(seed: int) -> None:
    graph = blobs(seed)
    config = SegmentationConfig()
    truth = np.repeat(np.arange(3), 25)
    assert adjusted_rand_score(truth, spectral_clusters(graph, config).labels) == 1.0
    order = np.random.default_rng(seed).permutation(len(graph.nodes))
    place = np.argsort(order)
    shuffled = VisibilityGraph(
        graph.nodes[order], np.sort(place[graph.pairs], axis=1), graph.lengths
    )
    assert adjusted_rand_score(truth[order], spectral_clusters(shuffled, config).labels) == 1.0


def test_components_are_never_joined() -> None:
    graph = blobs(1)
    group = graph.pairs // 25
    inner = group[:, 0] == group[:, 1]
    apart = VisibilityGraph(graph.nodes, graph.pairs[inner], graph.lengths[inner])
    found = spectral_clusters(apart, SegmentationConfig())
    assert adjusted_rand_score(np.repeat(np.arange(3), 25), found.labels) == 1.0
    assert (found.eigenvalues[:3] > 1.0 - 1e-9).all()


def test_one_cluster_that_is_two_is_halved_and_a_tight_one_is_not() -> None:
    graph = blobs(4, clusters=2)
    halves = split_again(graph, np.zeros(50, dtype=np.int32), 0, 0.7)
    assert adjusted_rand_score(np.repeat([0, 1], 25), halves) == 1.0
    one = subgraph(graph, np.arange(25))
    assert not split_again(one, np.zeros(25, dtype=np.int32), 0, 0.7).any()


def test_subgraph_keeps_the_edges_between_its_nodes() -> None:
    graph = blobs(4, clusters=2)
    part = subgraph(graph, np.arange(25, 50))
    assert len(part.nodes) == 25
    assert len(part.pairs) == ((graph.pairs >= 25).all(axis=1)).sum()
