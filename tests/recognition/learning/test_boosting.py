"""Boosting: eq. 2 by brute force, eq. 3 and the votes by scikit-learn; one classifier a class."""

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
from specmap_cli.core.settings import RecognitionConfig
from specmap_cli.recognition.features.sets import feature_names
from specmap_cli.recognition.learning.boosting import Booster, OneVsAll, StumpBoost
from tests.recognition.learning.made_up import PAPER, SMALL, samples_of, trees
from tests.strategies import few
from tests.turning import turn

NAMES = tuple(f"f{k}" for k in range(6))


def blobs(seed: int = 0, n: int = 240, noise: float = 1.0) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(n, len(NAMES)))
    y = np.where(X[:, 0] + 0.7 * X[:, 1] ** 2 + noise * rng.normal(size=n) > 0.5, 1.0, -1.0)
    return X, y


def stumps_of(X: FloatArray, y: FloatArray) -> Booster:
    return StumpBoost(NAMES, 15).fit(X, y)


def trees_of(X: FloatArray, y: FloatArray) -> Booster:
    return trees(NAMES, X, y)


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
    plain = fitted(X, y).margins(X)
    stretched = fitted(np.exp(X), y).margins(np.exp(X))
    assert stretched == pytest.approx(plain)


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
    leaf = 2 * upper + (sample[node["feature"]] >= node["threshold"])
    return float(entry["votes"][leaf])


def test_trees_learn_what_no_sum_of_stumps_can() -> None:
    rng = np.random.default_rng(0)
    X = rng.uniform(-1.0, 1.0, (400, 6))
    y = np.where(X[:, 0] * X[:, 1] > 0.0, 1.0, -1.0)
    fresh = rng.uniform(-1.0, 1.0, (400, 6))
    truth = fresh[:, 0] * fresh[:, 1] > 0.0
    turn("recognition", feature_share=0.5)
    stumps = StumpBoost(NAMES, 120).fit(X, y)
    assert ((trees(NAMES, X, y, 120).margins(fresh) > 0) == truth).mean() > 0.85
    assert ((stumps.margins(fresh) > 0) == truth).mean() < 0.7


@pytest.mark.parametrize("shrinkage", [1.0, 0.5])
def test_the_vote_of_a_tree_s_leaf_is_half_the_log_odds_shrunk(shrinkage: float) -> None:
    X = np.array([[0.0], [0.0], [0.0], [1.0], [1.0], [1.0], [1.0], [1.0]])
    y = np.array([1.0, 1.0, -1.0, -1.0, -1.0, -1.0, -1.0, 1.0])
    turn("recognition", shrinkage=shrinkage)
    booster = trees(("f0",), X, y, rounds=1)
    # half a sample more on either side: of three that are claimed, and of five that are not
    low = 0.5 * shrinkage * np.log((2.5 / 3) / (1.5 / 5))
    high = 0.5 * shrinkage * np.log((1.5 / 3) / (4.5 / 5))
    assert booster.margins(np.array([[0.0], [1.0]])) == pytest.approx([low, high], abs=1e-5)


def test_each_booster_is_one_fitted_against_an_even_choice_of_the_others() -> None:
    config = RecognitionConfig(feature_set="table1", booster="stumps", rounds=6, negatives=40)
    made = samples_of(PAPER)
    model = OneVsAll("table1", config).fit(made, np.random.default_rng(0))
    for own, booster in model.boosters_.items():
        others = np.vstack([X for i, X in made.items() if i != own])
        chosen = evenly(others, 40)
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
