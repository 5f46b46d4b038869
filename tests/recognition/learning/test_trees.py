"""Boosted trees: bins, the best splits by brute force, weights, and classifiers grown together."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import BoolArray, IntArray
from specmap_cli.recognition.learning import trees
from specmap_cli.recognition.learning.boosting import TreeBoost
from specmap_cli.recognition.learning.trees import (
    BINS,
    CodeArray,
    Forest,
    Quantiser,
    Question,
    grown,
    shares,
)
from tests.recognition.learning import made_up
from tests.recognition.watching import watched
from tests.strategies import few, seeds
from tests.turning import turn

NAMES = ("a", "b", "c")


def data(seed: int, n: int = 120) -> tuple[FloatArray, FloatArray]:
    """Samples of three features; the label depends on two of them, with some noise."""
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(n, len(NAMES)))
    y = np.where(X[:, 0] + (X[:, 1] > 0.0) + 0.5 * rng.normal(size=n) > 0.5, 1.0, -1.0)
    return X, y


def trees_of(X: FloatArray, y: FloatArray, rounds: int, share: float = 1.0) -> TreeBoost:
    """Trees of which each is of a share of the features."""
    turn("recognition", feature_share=share)
    found = made_up.trees(NAMES, X, y, rounds)
    assert isinstance(found, TreeBoost)
    return found


def test_edges_of_many_different_values_are_their_quantiles() -> None:
    X = np.random.default_rng(0).permutation(3200.0 * np.linspace(0, 1, 3201))[:, None]
    edges = Quantiser.of(X).edges[0]
    assert edges == pytest.approx(3200.0 / BINS * np.arange(1, BINS), abs=1.0)
    counts = np.bincount(Quantiser.of(X).codes(X)[0], minlength=BINS)
    assert counts.min() >= 3200 // BINS - 1


def test_a_constant_feature_has_one_bin_and_is_never_a_reason() -> None:
    X, y = data(0)
    X[:, 2] = 7.0
    model = trees_of(X, y, 30)
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
    forest = trees_of(X, y, 1).forest_
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

    def first_tree(rows: IntArray) -> Forest:
        question = Question(np.arange(len(rows)), y[rows] > 0.0)
        codes = quantiser.codes(X[rows])
        return grown(codes, quantiser, [question], 1, np.random.default_rng(0))[0]

    turn("recognition", feature_share=1.0)

    once, often = first_tree(np.arange(len(y))), first_tree(many)
    assert often.features.tolist() == once.features.tolist()
    assert often.thresholds.tolist() == once.thresholds.tolist()


def test_a_smaller_share_of_the_features_is_drawn_anew_each_round() -> None:
    X, y = data(5)
    third = trees_of(X, y, 40, share=0.34).forest_.features
    assert (third == third[:, :1]).all()  # one of three features a round: all nodes ask for it
    assert len(np.unique(third)) == 3


@given(seeds)
@few(10)
def test_the_order_of_the_samples_changes_no_bit(seed: int) -> None:
    """Sums of weights are exact. Equal columns are equally good: the first of them is taken."""
    X, y = data(seed)
    X[:, 2] = X[:, 0]
    order = np.random.default_rng(seed).permutation(len(y))
    one = trees_of(X, y, 8).to_dict()
    assert trees_of(X[order], y[order], 8).to_dict() == one
    asked = {part["feature"] for k in one["rounds"] for part in (k["root"], k["below"], k["above"])}
    assert "c" not in asked


def world(seed: int = 0) -> tuple[CodeArray, Quantiser, list[Question]]:
    """Samples of five places, and a question of different size for each: is it this one?"""
    rng = np.random.default_rng(seed)
    owner = np.repeat(np.arange(5), [20, 35, 50, 8, 41])
    X = rng.normal(rng.normal(size=(5, 6))[owner], 0.8)
    quantiser = Quantiser.of(X)
    questions = []
    for place in range(5):
        others = rng.permutation(np.flatnonzero(owner != place))[: 30 + 10 * place]
        samples = np.concatenate([np.flatnonzero(owner == place), others])
        questions.append(Question(samples, owner[samples] == place))
    return quantiser.codes(X), quantiser, questions


def same(first: Forest, second: Forest) -> bool:
    kept = "features", "thresholds", "votes"
    return all(np.array_equal(getattr(first, k), getattr(second, k)) for k in kept)


@pytest.mark.parametrize(("at_once", "batches"), [(1, 5), (140, 3), (1 << 15, 1)])
def test_a_classifier_is_the_same_alone_and_with_others(
    at_once: int, batches: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    codes, quantiser, questions = world()

    def answers(asked: list[Question]) -> list[Forest]:
        return grown(codes, quantiser, asked, 12, np.random.default_rng(3))

    turn("recognition", feature_share=0.5)
    alone = [answers([question])[0] for question in questions]
    turn("recognition", samples_at_once=at_once)
    calls = watched(monkeypatch, trees, "_boosted")
    assert all(map(same, alone, answers(questions)))
    assert not same(alone[0], alone[1])
    # together all of them, in order, and hardly more samples at once than wanted
    assert [question for _, batch, _ in calls for question in batch] == questions
    assert len(calls) == batches
    held = [sum(len(question.samples) for question in batch[1:]) for _, batch, _ in calls]
    assert max(held) <= at_once
    assert answers([]) == []


def test_what_is_left_out_of_a_search_holds_little_of_each_question_s_weight() -> None:
    questions = world()[2]
    counts = np.array([len(question.samples) for question in questions])
    asked = np.repeat(np.arange(len(questions)), counts)
    raw = np.random.default_rng(1).random(len(asked)) ** 6
    weights = shares(raw, asked, len(questions))
    kept = trees._heavy(weights, counts)
    held = np.bincount(asked[kept], weights[kept])
    assert held.min() >= 0.98 - 1e-9
    assert len(kept) < 0.8 * len(raw)
    for k in range(len(questions)):
        left = np.setdiff1d(np.flatnonzero(asked == k), kept)
        assert weights[left].max() < weights[kept[asked[kept] == k]].min()
    alike = shares(np.ones(len(asked)), asked, len(questions))
    assert len(trees._heavy(alike, counts)) == len(asked)
