"""Boosted stumps by brute force (eq. 2) and scikit-learn (eq. 3); trees; one class a classifier."""

from __future__ import annotations

import json
from collections.abc import Callable
from itertools import product
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.ensemble import AdaBoostClassifier

from specmap_cli.core.arrays import evenly
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import BoolArray, IntArray
from specmap_cli.core.settings import RecognitionConfig
from specmap_cli.recognition.features.sets import feature_names
from specmap_cli.recognition.learning import trees
from specmap_cli.recognition.learning.boosting import Booster, OneVsAll, StumpBoost, TreeBoost
from specmap_cli.recognition.learning.trees import (
    BINS,
    CodeArray,
    Forest,
    Quantiser,
    Question,
    grown,
    shares,
)
from tests.recognition.learning.made_up import PAPER, SMALL, samples_of
from tests.recognition.watching import watched
from tests.strategies import few, seeds
from tests.turning import turn

NAMES = tuple(f"f{k}" for k in range(6))


def blobs(seed: int, n: int = 240) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(n, len(NAMES)))
    return X, np.where(X[:, 0] + 0.7 * X[:, 1] ** 2 + rng.normal(size=n) > 0.5, 1.0, -1.0)


def stumps_of(X: FloatArray, y: FloatArray) -> Booster:
    return StumpBoost(NAMES, 15).fit(X, y)


def trees_of(X: FloatArray, y: FloatArray, rounds: int = 15, share: float = 0.1) -> Any:
    """The trees, each of a share of the features, that tell samples of label +1 from the others."""
    turn("recognition", feature_share=share)
    quantiser, question = Quantiser.of(X), Question(np.arange(len(X)), y > 0.0)
    names, rng = NAMES[: X.shape[1]], np.random.default_rng(0)
    return TreeBoost(names, *grown(quantiser.codes(X), quantiser, [question], rounds, rng))


of_both_kinds = pytest.mark.parametrize("fitted", [stumps_of, trees_of])
Fitted = Callable[[FloatArray, FloatArray], Booster]


def weak(X: Any, feature: int, threshold: float, polarity: int) -> Any:
    """The labels (n,) that the paper's weak classifier gives samples X (n, F)."""
    return np.where(polarity * X[:, feature] < polarity * threshold, 1, -1)


class BruteStump(ClassifierMixin, BaseEstimator):  # type: ignore[misc]
    """The weak classifier of the paper for scikit-learn: every threshold and sign is tried."""

    def fit(self, X: Any, y: Any, sample_weight: Any = None) -> BruteStump:
        self.classes_ = np.unique(y)
        w = np.full(len(y), 1.0 / len(y)) if sample_weight is None else sample_weight
        best = np.inf
        for feature in range(X.shape[1]):
            values = np.unique(X[:, feature])
            for split in product([feature], (values[1:] + values[:-1]) / 2.0, (1, -1)):
                error = w[weak(X, *split) != y].sum()
                if error < best - 1e-12:
                    best, self.split_ = error, split
        return self

    def predict(self, X: Any) -> Any:
        return weak(X, *self.split_)


@given(st.integers(0, 1000))
@few(8)
def test_the_first_round_is_the_best_of_all_weak_classifiers(seed: int) -> None:
    X, y = blobs(seed, n=40)
    stump = StumpBoost(NAMES, 1).fit(X, y).rounds_[0]
    brute = BruteStump().fit(X, y.astype(int))
    ours = weak(X, stump.feature, stump.threshold, stump.polarity)
    assert (ours != y).mean() == pytest.approx((brute.predict(X) != y).mean())


def test_the_rounds_are_scikit_learn_s_discrete_adaboost() -> None:
    X, y = blobs(1, n=60)
    ours = StumpBoost(NAMES, 8).fit(X, y)
    theirs = AdaBoostClassifier(BruteStump(), n_estimators=8).fit(X, y.astype(int))
    splits = [(s.feature, pytest.approx(s.threshold), s.polarity) for s in ours.rounds_]
    assert splits == [e.split_ for e in theirs.estimators_]
    # its votes are twice alpha, and its decision for two classes is twice the normalised sum
    assert [2.0 * s.votes for s in ours.rounds_] == pytest.approx(theirs.estimator_weights_)
    fresh, _ = blobs(2)
    total = sum(s.votes for s in ours.rounds_)
    assert 2.0 * ours.margins(fresh) / total == pytest.approx(theirs.decision_function(fresh))


def test_a_separable_set_ends_early_and_chance_ends_at_once() -> None:
    X = np.arange(20.0)[:, None]
    assert len(StumpBoost(("f0",), 30).fit(X, np.where(X[:, 0] < 7, 1.0, -1.0)).rounds_) == 1
    constant = StumpBoost(("f0",), 30).fit(np.ones((8, 1)), np.array([1.0, -1.0] * 4))
    assert constant.rounds_ == []
    assert (constant.margins(X) < 0.0).all()


@given(st.integers(0, 1000), st.integers(1, 12))
@few(10)
def test_weights_sum_to_one_and_make_the_last_classifier_worthless(seed: int, rounds: int) -> None:
    """Eq. 3 by a loop: after its round every weak classifier is as good as a coin."""
    X, y = blobs(seed, n=50)
    weights = np.full(len(y), 1.0 / len(y))
    for stump in StumpBoost(NAMES, rounds).fit(X, y).rounds_:
        h = weak(X, stump.feature, stump.threshold, stump.polarity)
        error = float(weights[h != y].sum())
        assert stump.votes == pytest.approx(0.5 * np.log((1.0 - error) / error))
        weights = weights * np.exp(-y * stump.votes * h)
        weights = weights / weights.sum()
        assert weights.sum() == pytest.approx(1.0)
        assert weights[h != y].sum() == pytest.approx(0.5)


@of_both_kinds
def test_a_monotone_change_of_the_features_changes_no_label(fitted: Fitted) -> None:
    """Only the order of the values counts, but for where between two of them a threshold stands."""
    X, y = blobs(8)
    assert fitted(np.exp(X), y).margins(np.exp(X)) == pytest.approx(fitted(X, y).margins(X))


@of_both_kinds
def test_margins_are_what_a_reader_of_the_file_would_add_up(fitted: Fitted) -> None:
    booster = fitted(*blobs(9))
    rounds = json.loads(json.dumps(booster.to_dict()))["rounds"]
    fresh, _ = blobs(10, n=30)
    for row, margin in zip(fresh, booster.margins(fresh).tolist(), strict=True):
        sample = dict(zip(NAMES, row.tolist(), strict=True))
        assert margin == pytest.approx(sum(vote_of(entry, sample) for entry in rounds))


def vote_of(entry: dict[str, Any], sample: dict[str, float]) -> float:
    """The vote of one round of a file on a sample by name."""
    if "polarity" in entry:
        sign = entry["polarity"]
        claims = sign * sample[entry["feature"]] < sign * entry["threshold"]
        return float(entry["votes"] if claims else -entry["votes"])
    upper = sample[entry["root"]["feature"]] >= entry["root"]["threshold"]
    node = entry["above" if upper else "below"]
    return float(entry["votes"][2 * upper + (sample[node["feature"]] >= node["threshold"])])


def test_trees_learn_what_no_sum_of_stumps_can() -> None:
    rng = np.random.default_rng(0)
    X = rng.uniform(-1.0, 1.0, (400, 6))
    y = np.where(X[:, 0] * X[:, 1] > 0.0, 1.0, -1.0)
    fresh = rng.uniform(-1.0, 1.0, (400, 6))
    truth = fresh[:, 0] * fresh[:, 1] > 0.0
    stumps = StumpBoost(NAMES, 120).fit(X, y)
    assert ((trees_of(X, y, 120, share=0.5).margins(fresh) > 0) == truth).mean() > 0.85
    assert ((stumps.margins(fresh) > 0) == truth).mean() < 0.7


@pytest.mark.parametrize("shrinkage", [1.0, 0.5])
def test_the_vote_of_a_tree_s_leaf_is_half_the_log_odds_shrunk(shrinkage: float) -> None:
    X = np.array([[0.0], [0.0], [0.0], [1.0], [1.0], [1.0], [1.0], [1.0]])
    y = np.array([1.0, 1.0, -1.0, -1.0, -1.0, -1.0, -1.0, 1.0])
    turn("recognition", shrinkage=shrinkage)
    booster = trees_of(X, y, rounds=1)
    # half a sample more on either side: of three that are claimed, and of five that are not
    low = 0.5 * shrinkage * np.log((2.5 / 3) / (1.5 / 5))
    high = 0.5 * shrinkage * np.log((1.5 / 3) / (4.5 / 5))
    assert booster.margins(np.array([[0.0], [1.0]])) == pytest.approx([low, high], abs=1e-5)


def test_each_booster_is_one_fitted_against_an_even_choice_of_the_others() -> None:
    config = RecognitionConfig(feature_set="table1", booster="stumps", rounds=6, negatives=40)
    made = samples_of(PAPER)
    model = OneVsAll("table1", config).fit(made, np.random.default_rng(0))
    for own, booster in model.boosters_.items():
        chosen = evenly(np.vstack([X for i, X in made.items() if i != own]), 40)
        y = np.repeat([1.0, -1.0], [len(made[own]), len(chosen)])
        alone = StumpBoost(feature_names("table1"), 6).fit(np.vstack([made[own], chosen]), y)
        assert booster.to_dict() == alone.to_dict()


def test_one_class_is_enough_and_fitting_again_forgets_it() -> None:
    made = samples_of(SMALL)
    model = OneVsAll("pairs", SMALL.recognition)
    model.fit({7: made[0]}, np.random.default_rng(0))
    assert list(model.classes_) == [7]
    assert (model.margins(made[0]) > 0.0).all()
    model.fit({9: made[0], 5: made[2]}, np.random.default_rng(1))
    assert model.classes_ == tuple(model.boosters_) == (5, 9)
    assert model.margins(made[0]).shape == (90, 2)


def test_edges_of_many_different_values_are_their_quantiles() -> None:
    X = np.random.default_rng(0).permutation(3200.0 * np.linspace(0, 1, 3201))[:, None]
    assert Quantiser.of(X).edges[0] == pytest.approx(3200.0 / BINS * np.arange(1, BINS), abs=1.0)
    assert np.bincount(Quantiser.of(X).codes(X)[0], minlength=BINS).min() >= 3200 // BINS - 1


def test_a_constant_feature_has_one_bin_and_is_never_a_reason() -> None:
    X, y = blobs(0)
    X[:, 2] = 7.0
    model = trees_of(X, y, 30, share=1.0)
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
    X, y = blobs(seed, n=60)
    positive = y > 0.0
    codes = Quantiser.of(X).codes(X)
    weights = np.where(positive, 0.5 / positive.sum(), 0.5 / (~positive).sum())
    forest = trees_of(X, y, 1, share=1.0).forest_
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
    X, y = blobs(3)
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
    X, y = blobs(5)
    sixth = trees_of(X, y, 40, share=0.17).forest_.features
    assert (sixth == sixth[:, :1]).all()  # one of six features a round: all nodes ask for it
    assert len(np.unique(sixth)) == 6


@given(seeds)
@few(10)
def test_the_order_of_the_samples_changes_no_bit(seed: int) -> None:
    """Sums of weights are exact. Equal columns are equally good: the first of them is taken."""
    X, y = blobs(seed)
    X[:, 2] = X[:, 0]
    order = np.random.default_rng(seed).permutation(len(y))
    one = trees_of(X, y, 8, share=1.0).to_dict()
    assert trees_of(X[order], y[order], 8, share=1.0).to_dict() == one
    asked = {part["feature"] for k in one["rounds"] for part in (k["root"], k["below"], k["above"])}
    assert "f2" not in asked


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
    assert np.bincount(asked[kept], weights[kept]).min() >= 0.98 - 1e-9
    assert len(kept) < 0.8 * len(raw)
    for k in range(len(questions)):
        left = np.setdiff1d(np.flatnonzero(asked == k), kept)
        assert weights[left].max() < weights[kept[asked[kept] == k]].min()
    alike = shares(np.ones(len(asked)), asked, len(questions))
    assert len(trees._heavy(alike, counts)) == len(asked)
