"""The pieces of eq. 1 and Algorithm 2, and of large graphs, against slow versions of themselves."""

import itertools
from collections.abc import Sequence
from dataclasses import replace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import ArpackNoConvergence
from sklearn.cluster import KMeans
from sklearn.metrics import adjusted_rand_score

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.settings import SegmentationConfig
from specmap_cli.segmentation import spectral
from specmap_cli.segmentation.division import segment
from specmap_cli.segmentation.spectral import parts_of, spectral_clusters, split_again
from specmap_cli.segmentation.visibility import LabelArray, VisibilityGraph, near_pairs
from tests.segmentation.plans import plan
from tests.strategies import few, seeds


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
    scales = spectral.local_scales(graph, neighbours)
    for node in range(len(graph.nodes)):
        seen = np.sort(graph.lengths[(graph.pairs == node).any(axis=1)])
        assert scales[node] == np.median(seen[:neighbours] if neighbours else seen)
    nodes = np.zeros((6, 2), dtype=np.intp)
    blind = VisibilityGraph(nodes, np.array([[1, 3], [3, 4]]), np.array([2.0, 6.0]))
    scales = spectral.local_scales(blind, 0)
    assert scales.tolist() == [1.0, 2.0, 1.0, 4.0, 6.0, 1.0]  # who sees no other has one
    none = VisibilityGraph(nodes[:2], blind.pairs[:0], np.zeros(0))
    assert spectral.local_scales(none, 0).tolist() == [1.0, 1.0]


@given(seed=seeds, multiple=st.sampled_from([1.0, 3.0]))
def test_similarity_is_equation_1(seed: int, multiple: float) -> None:
    graph = blobs(seed, each=6)
    alone = np.array([[500, 500]])  # sees no other
    graph = replace(graph, nodes=np.concatenate([graph.nodes, alone]))
    scales = multiple * spectral.local_scales(graph, 3)
    S = spectral.similarity(graph, 3, multiple).toarray()
    assert (S >= 0.0).all()
    np.testing.assert_array_equal(S, S.T)
    assert not S.diagonal().any()
    for (i, j), length in zip(graph.pairs[::5], graph.lengths[::5], strict=True):
        assert S[i, j] == pytest.approx(np.exp(-(length**2) / (scales[i] * scales[j])))
    np.testing.assert_array_equal(spectral.similarity(graph, 3, multiple, dense=True), S)


@given(seed=seeds)
def test_the_normalised_affinity_has_largest_eigenvalue_one(seed: int) -> None:
    S = spectral.similarity(blobs(seed, each=6), 0)
    L, degrees = spectral.normalised(S)
    dense = S.toarray()
    np.testing.assert_allclose(degrees, dense.sum(axis=1))
    np.testing.assert_allclose(L.toarray(), dense / np.sqrt(np.outer(degrees, degrees)), atol=1e-12)
    assert spectral.largest_eigenpairs(L, 1)[0][0] == pytest.approx(1.0)
    alone = np.pad(dense, (0, 1))  # the last sees no other
    sparse_L, _ = spectral.normalised(sparse.csr_array(alone))
    dense_L, degrees = spectral.normalised(alone)
    np.testing.assert_allclose(dense_L, sparse_L.toarray(), rtol=1e-12)
    np.testing.assert_allclose(degrees, alone.sum(axis=1))


@pytest.mark.parametrize("size", [2, 5, 60, 90, 400])
def test_eigenpairs_are_those_of_a_dense_solver(size: int) -> None:
    rng = np.random.default_rng(size)
    half = np.where(rng.random((size, size)) < 0.05, rng.random((size, size)), 0.0)
    matrix = sparse.csr_array(half + half.T)
    dense = matrix.toarray()
    every = np.linalg.eigvalsh(dense)[::-1]
    values, vectors = spectral.largest_eigenpairs(matrix, 5)
    np.testing.assert_allclose(values, every[:5], atol=1e-6)
    np.testing.assert_allclose(matrix @ vectors, vectors * values, atol=1e-4)
    assert ((vectors**3).sum(axis=0) >= 0.0).all()
    for again in (matrix, dense):  # the same on every run, and of an array
        same_values, same_vectors = spectral.largest_eigenpairs(again, 5)
        np.testing.assert_array_equal(same_values, values)
        np.testing.assert_array_equal(same_vectors, vectors)
    values, vectors = spectral.largest_of(dense, 2)
    np.testing.assert_allclose(values, every[:2], atol=1e-9)
    np.testing.assert_allclose(matrix @ vectors, vectors * values, atol=1e-9)
    if size < 10:  # those asked for in excess are all there are
        values, vectors = spectral.largest_eigenpairs(matrix, 40)
        assert (values.shape, vectors.shape) == ((size,), (size, size))
        assert (np.diff(values) <= 0.0).all()
        assert len(spectral.eigenpairs_above(matrix, -100.0)[0]) == size


@given(seed=seeds)
@few(15)
def test_clusters_are_the_groups_whatever_the_order_of_the_nodes(seed: int) -> None:
    graph = blobs(seed)
    config = SegmentationConfig()
    truth = np.repeat(np.arange(3), 25)
    assert adjusted_rand_score(truth, spectral_clusters(graph, config).labels) == 1.0
    order = np.random.default_rng(seed).permutation(len(graph.nodes))
    pairs = np.sort(np.argsort(order)[graph.pairs], axis=1)
    shuffled = VisibilityGraph(graph.nodes[order], pairs, graph.lengths)
    assert adjusted_rand_score(truth[order], spectral_clusters(shuffled, config).labels) == 1.0


def by_the_paper(graph: VisibilityGraph, least: float) -> tuple[list[float], list[int]]:
    """Algorithm 2 in dense matrices, line by line; the k-means of many starts is scikit-learn's."""
    n = len(graph.nodes)
    distance = np.full((n, n), np.inf)
    for (i, j), length in zip(graph.pairs.tolist(), graph.lengths.tolist(), strict=True):
        distance[i, j] = distance[j, i] = length
    sigma = np.array([np.median(row[np.isfinite(row)]) for row in distance])
    S = np.exp(-(distance**2) / np.outer(sigma, sigma))  # 1
    D = np.diag(S.sum(axis=1))  # 2
    L = np.diag(np.diag(D) ** -0.5) @ S @ np.diag(np.diag(D) ** -0.5)
    values, vectors = np.linalg.eigh(L)
    k = int((values > least).sum())  # 3
    X = vectors[:, -k:]  # 4
    Y = X / np.linalg.norm(X, axis=1, keepdims=True)  # 5
    labels = KMeans(k, n_init=5, random_state=0).fit_predict(Y)  # 6, 7
    return values[::-1].tolist(), labels.tolist()


@given(seed=seeds, clusters=st.integers(0, 4))
@few(12)
def test_algorithm_2_is_the_paper_s_in_dense_matrices(seed: int, clusters: int) -> None:
    """Whether the graph hangs together or, without a cluster, lies in pieces."""
    graph = blobs(seed, clusters, each=12) if clusters else in_pieces(seed)
    config = SegmentationConfig()
    values, labels = by_the_paper(graph, config.eigenvalue_min)
    found = spectral_clusters(graph, config)
    assert found.used == sum(value > config.eigenvalue_min for value in values)
    told = slice(found.used + 1)  # those that count, and the first that does not
    np.testing.assert_allclose(found.eigenvalues[told], values[told], atol=1e-6)
    assert adjusted_rand_score(labels, found.labels) == 1.0
    assert sorted(set(found.labels.tolist())) == list(range(found.labels.max() + 1))


def in_pieces(seed: int) -> VisibilityGraph:
    """Three groups of nodes without a sight line between them."""
    graph = blobs(seed, clusters=3, each=8)
    group = graph.pairs // 8
    inner = group[:, 0] == group[:, 1]
    return VisibilityGraph(graph.nodes, graph.pairs[inner], graph.lengths[inner])


def test_nodes_that_see_nothing_are_clusters_of_their_own() -> None:
    nodes, config = np.array([[0, 0], [0, 3], [40, 40], [80, 0]]), SegmentationConfig()
    graph = VisibilityGraph(nodes, np.array([[0, 1]]), np.array([3.0]))
    found = spectral_clusters(graph, config)
    assert found.labels.tolist() == [0, 0, 1, 2]
    assert found.used == 3
    alone = spectral_clusters(VisibilityGraph(nodes[:0], graph.pairs[:0], np.zeros(0)), config)
    assert alone.labels.shape == alone.eigenvalues.shape == (0,)
    assert alone.used == 0


@pytest.mark.parametrize("used", [1, 2, 5, 24])
def test_k_is_the_number_of_eigenvalues_above_the_level(used: int) -> None:
    S = spectral.similarity(blobs(0, clusters=2, each=12), 0)
    L, _ = spectral.normalised(S)
    every = np.append(np.linalg.eigvalsh(L.toarray())[::-1], -2.0)
    whole, level = [np.arange(24)], float(every[used - 1] + every[used]) / 2.0
    found = spectral.clusters_of(S, whole, level)
    assert found.used == used
    assert len(np.unique(found.labels)) <= used
    assert len(found.eigenvalues) >= min(used + 1, 24)  # one below, where there is one
    none = spectral.clusters_of(S, whole, 1.0 + 1e-6)
    assert none.used == 1
    assert not none.labels.any()


def test_as_many_equal_eigenvalues_as_there_are_pieces_are_found() -> None:
    ring = np.array([[0.0, 0.5, 0.5], [0.5, 0.0, 0.5], [0.5, 0.5, 0.0]])
    many = sparse.block_diag([ring] * 60, format="csr")  # more than are asked for at first
    values, vectors = spectral.eigenpairs_above(many, 0.9)
    assert (values > 0.9).sum() == 60
    np.testing.assert_allclose(many @ vectors, vectors * values, atol=1e-4)


@given(seed=seeds, level=st.sampled_from([0.5, 0.7, 0.95]))
@few(20)
def test_halving_only_divides_and_every_piece_hangs_together(seed: int, level: float) -> None:
    graph = blobs(seed, clusters=4, each=7)
    before = np.repeat([0, 0, 1, 1], 7).astype(np.int32)
    after = split_again(graph, before, 0, level)
    for label in np.unique(after):
        members = np.flatnonzero(after == label)
        assert len(np.unique(before[members])) == 1
        links = sparse.csr_array((np.ones(len(graph.pairs)), graph.pairs.T), shape=(28, 28))
        own = links[members][:, members]
        assert len(members) < 4 or connected_components(own, directed=False)[0] == 1
    assert sorted(set(after.tolist())) == list(range(after.max() + 1))


def test_a_cluster_of_four_rooms_is_halved_until_each_stands_alone() -> None:
    graph = blobs(2, clusters=4, each=20)
    one = np.zeros(80, dtype=np.int32)
    assert adjusted_rand_score(np.repeat(np.arange(4), 20), split_again(graph, one, 0, 0.7)) == 1.0
    assert not split_again(graph, one, 0, 1.0).any()
    parts = split_again(in_pieces(5), one[:24], 0, 0.999)  # they fall apart whatever the level
    assert adjusted_rand_score(np.repeat(np.arange(3), 8), parts) == 1.0
    for nodes in (0, 1, 3):  # too small for two
        few_nodes, none = np.arange(2 * nodes).reshape(nodes, 2), np.zeros((0, 2), dtype=np.intp)
        apart = VisibilityGraph(few_nodes, none, np.zeros(0))
        assert split_again(apart, one[:nodes], 0, 0.5).tolist() == [0] * nodes


def test_what_does_not_converge_is_solved_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    dense = np.random.default_rng(0).random((200, 200))
    matrix = sparse.csr_array(dense + dense.T)
    usual_values, usual = spectral.largest_eigenpairs(matrix, 5)
    never = ArpackNoConvergence("No convergence", np.zeros(0), np.zeros((200, 0)))
    monkeypatch.setattr(spectral, "eigsh", Mock(side_effect=never))
    values, vectors = spectral.largest_eigenpairs(matrix, 5)
    assert (np.diff(values) <= 0.0).all()
    assert np.allclose(values, usual_values)
    assert np.allclose(vectors, usual, atol=1e-6)


def directions(seed: int) -> FloatArray:
    """Unit vectors, some alike."""
    rng = np.random.default_rng(seed)
    middles = rng.normal(size=(4, 3))
    return spectral.unit_rows(middles[rng.integers(0, 4, 30)] + rng.normal(0.0, 0.4, (30, 3)))


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
def test_labels_are_scikit_learn_s_and_the_best_of_starts_wins(seed: int, clusters: int) -> None:
    rows = directions(seed)
    start = rows[farthest_first(rows, clusters, 3)]
    oracle = KMeans(clusters, init=start, n_init=1, algorithm="lloyd", tol=0.0).fit(rows)
    found = spectral.kmeans_unit(rows, clusters, [3])
    if len(np.unique(found)) == clusters:  # it deals otherwise with a centre that lost its rows
        np.testing.assert_array_equal(found, oracle.labels_)
    single = [cost(rows, spectral.kmeans_unit(rows, 4, [first])) for first in (0, 7, 19)]
    assert cost(rows, spectral.kmeans_unit(rows, 4, [0, 7, 19])) == pytest.approx(min(single))


def test_more_clusters_than_rows_are_as_many_as_rows() -> None:
    for rows in range(1, 4):
        assert sorted(spectral.kmeans_unit(np.eye(4)[:rows], 9, [0]).tolist()) == list(range(rows))


@given(seeds)
def test_rows_of_unit_length_point_where_they_did(seed: int) -> None:
    X = np.random.default_rng(seed).normal(size=(8, 3))
    X[2] = 0.0
    Y = spectral.unit_rows(X)
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
    rows = spectral.unit_rows(np.column_stack([first, other]))
    cuts = [np.array(cut, dtype=np.int32) for cut in itertools.product((0, 1), repeat=10)]
    best = min((cut for cut in cuts if 0 < cut.sum() < 10), key=lambda cut: cost(rows, cut))
    labels = spectral.bisect(first, other)
    assert labels.tolist() in (best.tolist(), (1 - best).tolist())
    turned = spectral.bisect(first, -other)  # the sign of an eigenvector means nothing
    assert turned.tolist() in (labels.tolist(), (1 - labels).tolist())


def cliques(sizes: Sequence[int], bridge: float = 0.05) -> sparse.csr_array:
    """A chain of cliques, each joined to the next by one weak edge."""
    count = sum(sizes)
    S = np.zeros((count, count))
    start = 0
    for size in sizes:
        S[start : start + size, start : start + size] = 1.0
        if start:
            S[start - 1, start] = S[start, start - 1] = bridge
        start += size
    np.fill_diagonal(S, 0.0)
    return sparse.csr_array(S)


def test_a_small_graph_is_one_part_a_component() -> None:
    parts = [part.tolist() for part in parts_of(cliques([5, 4, 6], bridge=0.0), 6)]
    assert parts == [[*range(5)], [*range(5, 9)], [*range(9, 15)]]
    assert [part.tolist() for part in parts_of(cliques([5, 4]), 9)] == [list(range(9))]
    assert parts_of(sparse.csr_array((0, 0)), 10) == []


@given(sizes=st.lists(st.integers(4, 20), min_size=2, max_size=12), seed=st.integers(0, 1000))
def test_cuts_go_through_the_weak_edges_and_through_no_room(sizes: list[int], seed: int) -> None:
    place = np.random.default_rng(seed).permutation(sum(sizes))
    S, room = cliques(sizes)[place][:, place], np.repeat(np.arange(len(sizes)), sizes)[place]
    parts = parts_of(S, max(sizes))
    assert sorted(np.concatenate(parts).tolist()) == list(range(sum(sizes)))
    for part in parts:
        assert len(part) <= max(sizes)
        assert (np.diff(part) > 0).all()
        assert connected_components(S[part][:, part])[0] == 1
    if len(set(sizes)) == 1:  # else a share of the degrees may ask for a cut through a room
        assert all(len(np.unique(room[part])) == 1 for part in parts)
    assert [part[0] for part in parts] == sorted(part[0] for part in parts)


def test_the_cut_goes_where_least_is_lost() -> None:
    S = cliques([30, 30, 30, 30]).tolil()
    for i, j in ((29, 30), (89, 90)):  # wide openings; between them a narrow one
        S[i, j] = S[j, i] = 5.0
    parts = parts_of(sparse.csr_array(S), 60)
    assert [part.tolist() for part in parts] == [list(range(60)), list(range(60, 120))]


def test_a_neck_is_found_among_groups_as_among_all_nodes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two halls of 30 by 20 m, joined by a corridor of one node across."""
    places = [(row, column) for row in range(20) for column in range(64)]
    nodes = np.array([(r, c) for r, c in places if not 30 <= c < 34 or r == 6])
    pairs = near_pairs(nodes, 4.0)
    ends = nodes[pairs]
    walled = (((ends[:, :, 1] >= 30) & (ends[:, :, 1] < 34)) | (ends[:, :, 0] == 6)).all(axis=1)
    across = (ends[:, :, 1] < 32).sum(axis=1) == 1
    pairs = pairs[~across | walled]
    lengths = np.hypot(*(nodes[pairs[:, 0]] - nodes[pairs[:, 1]]).T)
    S = spectral.similarity(VisibilityGraph(nodes, pairs, lengths), 0)
    sizes = []

    def counted(L: Any, *rest: Any) -> tuple[FloatArray, FloatArray]:
        sizes.append(L.shape[0])
        return spectral.largest_of(L.toarray(), rest[0])

    monkeypatch.setattr(spectral, "largest_eigenpairs", counted)
    parts = parts_of(S, 700)
    assert len(parts) == 2
    assert max(sizes) < len(nodes) / 3
    for part, end in zip(parts, (0, 63), strict=True):
        assert (np.abs(nodes[part][:, 1] - end) <= 34).all()


def test_rooms_are_the_same_whether_a_graph_is_cut_or_not(monkeypatch: pytest.MonkeyPatch) -> None:
    """Twelve rooms on either side of a corridor."""
    lefts = [0.5 + 3.9 * k for k in range(12)]
    rooms = [(x, y, x + 3.7, y + 4.0) for x in lefts for y in (0.5, 6.5)]
    doors = [(x + 1.4, y, x + 2.3, y + 0.2) for x in lefts for y in (4.5, 6.3)]
    hotel = plan(49.0, 11.0, (0.5, 4.7, 48.5, 6.3), *rooms, *doors)
    whole, solving = segment(hotel, SegmentationConfig()), Mock(wraps=spectral.eigenpairs_above)
    monkeypatch.setattr(spectral, "eigenpairs_above", solving)
    cut = segment(hotel, SegmentationConfig(part_nodes=300))
    sizes = [call.args[0].shape[0] for call in solving.call_args_list]
    assert max(sizes) <= 300 < 600 < len(whole.nodes)
    assert whole.count == cut.count == 25
    both = whole.labels >= 0
    assert adjusted_rand_score(whole.labels[both], cut.labels[both]) > 0.99
