"""Boosting: eq. 2 by brute force, eq. 3 and the votes against scikit-learn, files and back."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.ensemble import AdaBoostClassifier
from sklearn.tree import DecisionTreeClassifier

from specmap_cli.core.errors import MapError
from specmap_cli.core.geometry import FloatArray
from specmap_cli.recognition.learning.boosting import StumpBoost, TreeBoost, booster_from_dict
from specmap_cli.recognition.learning.trees import Quantiser
from tests.strategies import few

NAMES = tuple(f"f{k}" for k in range(6))


def blobs(seed: int = 0, n: int = 240, noise: float = 1.0) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(n, len(NAMES)))
    y = np.where(X[:, 0] + 0.7 * X[:, 1] ** 2 + noise * rng.normal(size=n) > 0.5, 1.0, -1.0)
    return X, y


class BruteStump(ClassifierMixin, BaseEstimator):  # type: ignore[misc]
    """The weak classifier of the paper for scikit-learn: every threshold and sign is tried."""

    def fit(self, X: Any, y: Any, sample_weight: Any = None) -> BruteStump:
        self.classes_ = np.unique(y)
        w = np.full(len(y), 1.0 / len(y)) if sample_weight is None else sample_weight
        best = np.inf
        for feature in range(X.shape[1]):
            values = np.unique(X[:, feature])
            for threshold in (values[1:] + values[:-1]) / 2.0:
                for polarity in (1, -1):
                    h = np.where(polarity * X[:, feature] < polarity * threshold, 1, -1)
                    error = w[h != y].sum()
                    if error < best - 1e-12:
                        best, self.split_ = error, (feature, threshold, polarity)
        return self

    def predict(self, X: Any) -> Any:
        feature, threshold, polarity = self.split_
        return np.where(polarity * X[:, feature] < polarity * threshold, 1, -1)


@given(st.integers(0, 1000))
@few(8)
def test_the_first_round_is_the_best_of_all_weak_classifiers(seed: int) -> None:
    X, y = blobs(seed, n=40)
    stump = StumpBoost(NAMES, 1).fit(X, y).rounds_[0]
    brute = BruteStump().fit(X, y.astype(int))
    ours = np.where(stump.polarity * X[:, stump.feature] < stump.polarity * stump.threshold, 1, -1)
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


def test_as_accurate_as_scikit_learn_s_stumps() -> None:
    X, y = blobs(3, n=400)
    fresh, truth = blobs(4, n=400)
    ours = StumpBoost(NAMES, 60).fit(X, y)
    stump = DecisionTreeClassifier(max_depth=1)
    theirs = AdaBoostClassifier(stump, n_estimators=60, random_state=0).fit(X, y)
    mine = ((ours.margins(fresh) > 0) == (truth > 0)).mean()
    assert mine == pytest.approx((theirs.predict(fresh) == truth).mean(), abs=0.04)


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
        h = np.where(stump.polarity * X[:, stump.feature] < stump.polarity * stump.threshold, 1, -1)
        error = float(weights[h != y].sum())
        assert stump.votes == pytest.approx(0.5 * np.log((1.0 - error) / error))
        weights = weights * np.exp(-y * stump.votes * h)
        weights = weights / weights.sum()
        assert weights.sum() == pytest.approx(1.0)
        assert weights[h != y].sum() == pytest.approx(0.5)


@given(st.integers(0, 1000))
@few(10)
def test_the_training_error_keeps_its_bound(seed: int) -> None:
    """At most the product of 2 sqrt(error (1 - error)) over the rounds (Freund and Schapire)."""
    X, y = blobs(seed, n=60)
    model = StumpBoost(NAMES, 20).fit(X, y)
    errors = 1.0 / (1.0 + np.exp(2.0 * np.array([s.votes for s in model.rounds_])))
    bound = np.prod(2.0 * np.sqrt(errors * (1.0 - errors)))
    assert (np.sign(model.margins(X)) != y).mean() <= bound + 1e-9


@pytest.mark.parametrize("booster", [StumpBoost(NAMES, 15), TreeBoost(NAMES, 15)])
def test_a_monotone_change_of_the_features_changes_no_label(
    booster: StumpBoost | TreeBoost,
) -> None:
    """Only the order of the values counts, but for where between two of them a threshold stands."""
    X, y = blobs(8)
    plain = booster.fit(X, y).margins(X)
    stretched = booster.fit(np.exp(X), y).margins(np.exp(X))
    assert stretched == pytest.approx(plain)


@pytest.mark.parametrize("booster", [StumpBoost(NAMES, 25), TreeBoost(NAMES, 25)])
def test_margins_are_what_a_reader_of_the_file_would_add_up(
    booster: StumpBoost | TreeBoost,
) -> None:
    X, y = blobs(9)
    rounds = json.loads(json.dumps(booster.fit(X, y).to_dict()))["rounds"]
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


@pytest.mark.parametrize("booster", [StumpBoost(NAMES, 5), TreeBoost(NAMES, 5)])
def test_no_sample_has_no_margin(booster: StumpBoost | TreeBoost) -> None:
    booster.fit(*blobs(11))
    assert booster.margins(np.zeros((0, len(NAMES)))).shape == (0,)


@pytest.mark.parametrize(("booster", "margin"), [(StumpBoost(NAMES), -1.0), (TreeBoost(NAMES), 0)])
def test_a_booster_without_rounds_claims_nothing(
    booster: StumpBoost | TreeBoost, margin: float
) -> None:
    back = booster_from_dict(booster.to_dict(), NAMES)
    assert back.margins(np.ones((3, len(NAMES)))).tolist() == [margin] * 3


@pytest.mark.parametrize("booster", [StumpBoost(NAMES, 9), TreeBoost(NAMES, 9, seed=4)])
def test_fitting_again_forgets_the_first_time(booster: StumpBoost | TreeBoost) -> None:
    once = booster.fit(*blobs(12)).to_dict()
    booster.fit(*blobs(13))
    assert booster.fit(*blobs(12)).to_dict() == once


def test_trees_learn_what_no_sum_of_stumps_can() -> None:
    rng = np.random.default_rng(0)
    X = rng.uniform(-1.0, 1.0, (400, 6))
    y = np.where(X[:, 0] * X[:, 1] > 0.0, 1.0, -1.0)
    fresh = rng.uniform(-1.0, 1.0, (400, 6))
    truth = fresh[:, 0] * fresh[:, 1] > 0.0
    trees = TreeBoost(NAMES, 120, 0.3, 0.5).fit(X, y)
    stumps = StumpBoost(NAMES, 120).fit(X, y)
    assert ((trees.margins(fresh) > 0) == truth).mean() > 0.85
    assert ((stumps.margins(fresh) > 0) == truth).mean() < 0.7


def test_trees_are_the_same_for_a_seed_and_differ_for_another() -> None:
    X, y = blobs(5)
    first = TreeBoost(NAMES, 20, seed=3).fit(X, y)
    again = TreeBoost(NAMES, 20, seed=3).fit(X, y)
    other = TreeBoost(NAMES, 20, seed=4).fit(X, y)
    assert first.to_dict() == again.to_dict()
    assert first.to_dict() != other.to_dict()


def test_the_vote_of_a_tree_s_leaf_is_half_the_log_odds() -> None:
    X = np.array([[0.0], [0.0], [0.0], [1.0], [1.0], [1.0], [1.0], [1.0]])
    y = np.array([1.0, 1.0, -1.0, -1.0, -1.0, -1.0, -1.0, 1.0])
    booster = TreeBoost(("f0",), 1, 1.0, 1.0).fit(X, y)
    # half a sample more on either side: of three that are claimed, and of five that are not
    low = 0.5 * np.log((2.5 / 3) / (1.5 / 5))
    high = 0.5 * np.log((1.5 / 3) / (4.5 / 5))
    assert booster.margins(np.array([[0.0], [1.0]])) == pytest.approx([low, high], abs=1e-5)


@given(st.integers(0, 1000), st.integers(2, 300))
def test_bins_are_as_full_as_they_can_be_and_keep_the_order(seed: int, n: int) -> None:
    X = np.random.default_rng(seed).normal(size=(n, 3)).round(1)
    codes = Quantiser.of(X).codes(X)
    for k in range(3):
        order = np.argsort(X[:, k], kind="stable")
        assert (np.diff(codes[k][order].astype(int)) >= 0).all()
        if len(np.unique(X[:, k])) > 1:
            assert len(np.unique(codes[k])) > 1


@pytest.mark.parametrize("booster", [StumpBoost(NAMES, 12), TreeBoost(NAMES, 12)])
def test_a_file_gives_the_same_classifier_back(booster: StumpBoost | TreeBoost) -> None:
    X, y = blobs(6)
    booster.fit(X, y)
    text = json.dumps(booster.to_dict(), allow_nan=False)
    back = booster_from_dict(json.loads(text), NAMES)
    assert back.to_dict() == booster.to_dict()
    assert (back.margins(X) == booster.margins(X)).all()


STUMP = {"feature": "f1", "threshold": 0.5, "polarity": 1, "votes": 0.3}
SPLIT = {"feature": "f1", "threshold": 0.5}
TREE = {"root": SPLIT, "below": SPLIT, "above": SPLIT, "votes": [0.1, 0.2, 0.3, 0.4]}


@pytest.mark.parametrize(
    ("kind", "entry", "told"),
    [
        ("stumps", STUMP | {"feature": "f9"}, "f9"),
        ("stumps", STUMP | {"threshold": "high"}, "high"),
        ("stumps", STUMP | {"threshold": float("nan")}, "finite"),
        ("stumps", STUMP | {"polarity": 0}, "polarity"),
        ("stumps", STUMP | {"polarity": True}, "polarity"),
        ("stumps", {"feature": "f1"}, "threshold"),
        ("stumps", 7, "no object"),
        ("trees", TREE | {"votes": [1.0, 2.0]}, "4 numbers"),
        ("trees", TREE | {"votes": [1.0, 2.0, 3.0, None]}, "finite"),
        ("trees", TREE | {"below": "f1"}, "below"),
        ("trees", TREE | {"root": {"feature": ["f1"], "threshold": 1}}, "not known"),
        ("forests", TREE, "forests"),
    ],
)
def test_nonsense_is_refused_in_one_line(kind: str, entry: Any, told: str) -> None:
    with pytest.raises(MapError, match=told) as error:
        booster_from_dict({"kind": kind, "rounds": [entry]}, NAMES)
    assert "\n" not in str(error.value)


def test_trees_are_read_alike_at_once_and_one_by_one() -> None:
    """Whole numbers in a file, which people write, are read one by one."""
    X, y = blobs()
    written = TreeBoost(NAMES, 7).fit(X, y).to_dict()
    by_hand = json.loads(json.dumps(written))
    by_hand["rounds"][3]["above"]["threshold"] = 2
    by_hand["rounds"][5]["votes"][1] = -1
    found = booster_from_dict(by_hand, NAMES).to_dict()["rounds"]
    assert found[3]["above"]["threshold"] == 2.0
    assert found[5]["votes"] == [-1.0 if k == 1 else v for k, v in enumerate(found[5]["votes"])]
    same = [k for k in range(7) if k not in (3, 5)]
    assert [found[k] for k in same] == [written["rounds"][k] for k in same]
