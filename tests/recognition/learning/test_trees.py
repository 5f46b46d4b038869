"""Boosted trees: bins, the best splits by brute force, weights of classes and of samples."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.recognition.learning.boosting import TreeBoost
from specmap_cli.recognition.learning.trees import BINS, CodeArray, Forest, Quantiser
from tests.strategies import few, seeds

BoolArray = NDArray[np.bool_]
NAMES = ("a", "b", "c")


def data(seed: int, n: int = 120) -> tuple[FloatArray, FloatArray]:
    """Samples of three features; the label depends on two of them, with some noise."""
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(n, len(NAMES)))
    y = np.where(X[:, 0] + (X[:, 1] > 0.0) + 0.5 * rng.normal(size=n) > 0.5, 1.0, -1.0)
    return X, y


@given(seeds, st.integers(1, 400))
def test_codes_are_the_edges_that_a_value_reaches(seed: int, n: int) -> None:
    X = np.random.default_rng(seed).normal(size=(n, 2)).round(1)
    quantiser = Quantiser.of(X)
    codes = quantiser.codes(X)
    assert codes.shape == (2, n)
    assert codes.max(initial=0) < BINS
    for feature in range(2):
        edges = quantiser.edges[feature]
        expected = [(edges <= value).sum() for value in X[:, feature]]
        assert codes[feature].tolist() == expected


def test_edges_of_many_different_values_are_their_quantiles() -> None:
    X = np.random.default_rng(0).permutation(3200.0 * np.linspace(0, 1, 3201))[:, None]
    edges = Quantiser.of(X).edges[0]
    assert edges == pytest.approx(3200.0 / BINS * np.arange(1, BINS), abs=1.0)
    counts = np.bincount(Quantiser.of(X).codes(X)[0], minlength=BINS)
    assert counts.min() >= 3200 // BINS - 1


def test_a_constant_feature_has_one_bin_and_is_never_a_reason() -> None:
    X, y = data(0)
    X[:, 2] = 7.0
    model = TreeBoost(NAMES, 30, feature_share=1.0).fit(X, y)
    changed = X.copy()
    changed[:, 2] = -1e6
    assert Quantiser.of(X).codes(X)[2].max() <= 1
    assert model.margins(changed).tolist() == model.margins(X).tolist()


def impurity(above: BoolArray, positive: BoolArray, weights: FloatArray) -> float:
    """Sum over both sides of sqrt(W+ W-)."""
    total = 0.0
    for side in (above, ~above):
        total += np.sqrt(weights[side & positive].sum() * weights[side & ~positive].sum())
    return float(total)


def best_split(
    codes: CodeArray, chosen: BoolArray, positive: BoolArray, weights: FloatArray
) -> float:
    """The least impurity of the chosen samples over all features and cuts, by trying them."""
    return min(
        impurity(row[chosen] > cut, positive[chosen], weights[chosen])
        for row in codes
        for cut in range(BINS - 1)
    )


@given(seeds)
@few(10)
def test_the_first_tree_s_splits_are_the_best_of_all(seed: int) -> None:
    X, y = data(seed, n=60)
    positive = y > 0.0
    quantiser = Quantiser.of(X)
    codes = quantiser.codes(X)
    weights = np.where(positive, 0.5 / positive.sum(), 0.5 / (~positive).sum())
    forest = TreeBoost(NAMES, 1, feature_share=1.0).fit(X, y).forest_
    features, thresholds = forest.features[0].tolist(), forest.thresholds[0].tolist()
    everyone = np.ones(len(y), dtype=bool)
    upper = X[:, features[0]] >= thresholds[0]
    found = impurity(upper, positive, weights)
    assert found == pytest.approx(best_split(codes, everyone, positive, weights))
    for node, chosen in ((1, ~upper), (2, upper)):
        above = X[chosen, features[node]] >= thresholds[node]
        found = impurity(above, positive[chosen], weights[chosen])
        assert found == pytest.approx(best_split(codes, chosen, positive, weights))


def test_both_classes_weigh_alike_however_many_samples_they_have() -> None:
    X, y = data(3)
    quantiser = Quantiser.of(X)
    many = np.concatenate([np.arange(len(y)), np.repeat(np.flatnonzero(y < 0.0), 4)])
    once, often = (
        TreeBoost(NAMES, 1, feature_share=1.0).fit_codes(
            quantiser.codes(X[rows]), quantiser, y[rows]
        )
        for rows in (np.arange(len(y)), many)
    )
    assert often.forest_.features.tolist() == once.forest_.features.tolist()
    assert often.forest_.thresholds.tolist() == once.forest_.thresholds.tolist()


def test_features_cut_beforehand_give_the_same_trees() -> None:
    X, y = data(4)
    quantiser = Quantiser.of(X)
    direct = TreeBoost(NAMES, 20, seed=5).fit(X, y)
    cut = TreeBoost(NAMES, 20, seed=5).fit_codes(quantiser.codes(X), quantiser, y)
    assert cut.to_dict() == direct.to_dict()


def test_a_smaller_share_of_the_features_is_drawn_anew_each_round() -> None:
    X, y = data(5)
    third = TreeBoost(NAMES, 40, feature_share=0.34).fit(X, y).forest_.features
    assert (third == third[:, :1]).all()  # one of three features a round: all nodes ask for it
    assert len(np.unique(third)) == 3


def test_shrinkage_scales_the_first_votes() -> None:
    X, y = data(6)
    whole, half = (TreeBoost(NAMES, 1, shrink, 1.0).fit(X, y) for shrink in (1.0, 0.5))
    assert half.forest_.votes == pytest.approx(0.5 * whole.forest_.votes, abs=1e-6)


def test_more_rounds_separate_what_can_be_separated() -> None:
    X, _ = data(7, n=300)
    y = np.where(X[:, 0] * X[:, 1] > 0.0, 1.0, -1.0)
    shares = [
        ((TreeBoost(NAMES, rounds, feature_share=1.0).fit(X, y).margins(X) > 0.0) == (y > 0)).mean()
        for rounds in (1, 10, 200)
    ]
    assert shares == sorted(shares)
    assert shares[-1] > 0.98


def test_samples_of_one_class_alone_are_all_of_it() -> None:
    X, _ = data(8)
    for sign in (1.0, -1.0):
        margins = TreeBoost(NAMES, 5).fit(X, np.full(len(X), sign)).margins(X)
        assert (np.sign(margins) == sign).all()


def test_joined_forests_vote_side_by_side() -> None:
    X, y = data(9)
    parts = [TreeBoost(NAMES, 4, seed=k).fit(X, y).forest_ for k in range(3)]
    votes = Forest.joined(parts).tree_votes(X)
    assert votes.shape == (len(X), 12)
    assert votes == pytest.approx(np.hstack([part.tree_votes(X) for part in parts]))
    assert Forest.joined(parts).tree_votes(X[:1]) == pytest.approx(votes[:1])


@given(seeds)
@few(10)
def test_the_order_of_the_samples_changes_no_bit(seed: int) -> None:
    """Sums of weights are exact. Equal columns are equally good: the first of them is taken."""
    X, y = data(seed)
    X[:, 2] = X[:, 0]
    order = np.random.default_rng(seed).permutation(len(y))
    one = TreeBoost(NAMES, 8, feature_share=1.0).fit(X, y).to_dict()
    assert TreeBoost(NAMES, 8, feature_share=1.0).fit(X[order], y[order]).to_dict() == one
    asked = {part["feature"] for k in one["rounds"] for part in (k["root"], k["below"], k["above"])}
    assert "c" not in asked
