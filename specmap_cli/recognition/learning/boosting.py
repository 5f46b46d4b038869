"""Boosted classifiers of features, one a submap against all others (Section III-A, eq. 2, 3).

`StumpBoost` is the paper's own AdaBoost on one-threshold weak classifiers; `TreeBoost` is the
default: the same idea with quantised features and weak classifiers of two levels. Both are
estimators: the constructor stores, `fit` learns, `margins` is the sum of votes, whose sign is the
label. `OneVsAll` has one of them for every submap.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.arrays import evenly
from specmap_cli.core.errors import MapError
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.settings import RecognitionConfig
from specmap_cli.recognition.features.sets import feature_names, feature_sets
from specmap_cli.recognition.learning.json_fields import (
    field,
    mapping,
    number,
    numbers,
    objects,
    refuse,
    text,
)
from specmap_cli.recognition.learning.trees import (
    CodeArray,
    Forest,
    Growth,
    Quantiser,
    Question,
    grown,
    shares,
)

FEATURE_SHARE = 0.1  # share of the features that are drawn for a round of trees
_NODES = ("root", "below", "above")
_LEAVES = 4


class TreeBoost:
    """Real AdaBoost on trees of two levels; the two classes start with equal total weight.

    `names` are the columns' names; `shrinkage` scales every leaf; `feature_share` of the features
    is drawn each round by a generator seeded with `seed`. `forest_` holds the fitted trees.
    `growing.grown` learns many classifiers of the same samples at once, faster than one by one.
    """

    kind = "trees"

    def __init__(
        self,
        names: Sequence[str],
        rounds: int = 300,
        shrinkage: float = 0.3,
        feature_share: float = 0.2,
        seed: int = 0,
    ) -> None:
        self.names = tuple(names)
        self.growth = Growth(rounds, shrinkage, feature_share, seed)
        self.forest_ = Forest.bare()

    @classmethod
    def of(cls, names: Sequence[str], forest: Forest) -> TreeBoost:
        """The booster of trees that were grown elsewhere."""
        booster = cls(names, len(forest.votes))
        booster.forest_ = forest
        return booster

    def fit(self, X: NDArray[Any], y: NDArray[Any]) -> TreeBoost:
        """Learn from features X (n, F) and labels y (n,) of +1 and -1; returns self."""
        quantiser = Quantiser.of(X)
        return self.fit_codes(quantiser.codes(X), quantiser, y)

    def fit_codes(self, codes: CodeArray, quantiser: Quantiser, y: NDArray[Any]) -> TreeBoost:
        """The same from features that are cut already: `codes` (F, n) of `quantiser`."""
        everything = Question(np.arange(codes.shape[1]), np.asarray(y) > 0)
        (self.forest_,) = grown(codes, quantiser, [everything], self.growth)
        return self

    def margins(self, X: NDArray[Any]) -> FloatArray:
        """(n,) sums of votes: positive where the samples X (n, F) are claimed."""
        return self.forest_.margins(np.asarray(X, dtype=np.float64), classes=1)[:, 0]

    def to_dict(self) -> dict[str, Any]:
        """The fitted rounds by name, ready for JSON."""
        rounds = []
        forest = self.forest_
        for features, thresholds, votes in zip(
            forest.features.tolist(), forest.thresholds.tolist(), forest.votes.tolist(), strict=True
        ):
            split = [
                {"feature": self.names[f], "threshold": t}
                for f, t in zip(features, thresholds, strict=True)
            ]
            rounds.append({"root": split[0], "below": split[1], "above": split[2], "votes": votes})
        return {"kind": self.kind, "rounds": rounds}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], names: Sequence[str]) -> TreeBoost:
        """The booster that `to_dict` described; MapError names the entry that makes no sense."""
        column = {name: k for k, name in enumerate(names)}
        rounds = objects(data, "rounds")
        forest = _read_at_once(rounds, column)
        return cls.of(names, _read_one_by_one(rounds, column) if forest is None else forest)


def _read_at_once(rounds: Sequence[Any], column: Mapping[str, int]) -> Forest | None:
    """The trees of `to_dict`, quickly; None for anything that needs a closer look."""
    try:
        parts = [entry[node] for entry in rounds for node in _NODES]
        features = [column[part["feature"]] for part in parts]
        thresholds = [part["threshold"] for part in parts]
        votes = [vote for entry in rounds for vote in entry["votes"]]
        if any(len(entry["votes"]) != _LEAVES for entry in rounds):
            return None
    except (TypeError, KeyError):
        return None
    if {*map(type, thresholds), *map(type, votes)} - {float}:
        return None
    forest = Forest(
        np.array(features, dtype=np.intp).reshape(-1, len(_NODES)),
        np.array(thresholds, dtype=np.float64).reshape(-1, len(_NODES)),
        np.array(votes, dtype=np.float64).reshape(-1, _LEAVES),
    )
    finite = np.isfinite(forest.thresholds).all() and np.isfinite(forest.votes).all()
    return forest if finite else None


def _read_one_by_one(rounds: Sequence[Any], column: Mapping[str, int]) -> Forest:
    """The same, value by value; MapError names the first entry that makes no sense."""
    features = np.zeros((len(rounds), len(_NODES)), dtype=np.intp)
    thresholds, votes = np.zeros(features.shape), np.zeros((len(rounds), _LEAVES))
    for k, entry in enumerate(rounds):
        for j, node in enumerate(_NODES):
            where = f"round {k}, {node}"
            split = mapping(entry, node, where)
            features[k, j] = field(split, "feature", column, where)
            thresholds[k, j] = number(split, "threshold", where)
        votes[k] = numbers(entry, "votes", _LEAVES, f"round {k}")
    return Forest(features, thresholds, votes)


__all__ = ["Booster", "Stump", "StumpBoost", "TreeBoost", "booster_from_dict"]

_SMALLEST_ERROR = 1e-10  # below it a round separates the samples: its votes stay finite
_VOTE_DECIMALS = 9  # of votes: the last bits of a logarithm are not the same on every processor
_CHANCE = 0.5 - 1e-12  # the error of a coin, but for rounding


@dataclass(frozen=True, slots=True)
class Stump:
    """h(x) = 1 if polarity * x[feature] < polarity * threshold else -1, with `votes` alpha."""

    feature: int
    threshold: float
    polarity: int
    votes: float


class StumpBoost:
    """Discrete AdaBoost; each round takes the one feature, threshold and sign of least error.

    `names` are the columns' names, used by `to_dict`; `rounds_` holds the fitted stumps.
    """

    kind = "stumps"

    def __init__(self, names: Sequence[str], rounds: int = 60) -> None:
        self.names = tuple(names)
        self.rounds = rounds
        self.rounds_: list[Stump] = []

    def fit(self, X: NDArray[Any], y: NDArray[Any]) -> StumpBoost:
        """Learn from features X (n, F) and labels y (n,) of +1 and -1; returns self.

        Stops early when a round separates the samples or does no better than chance.
        """
        X, y = np.asarray(X, dtype=np.float64), np.asarray(y, dtype=np.float64)
        order = np.argsort(X, axis=0, kind="stable").T
        values = np.take_along_axis(X.T, order, axis=1)
        splits = values[:, 1:] > values[:, :-1]  # a threshold stands between different values only
        everyone = np.zeros(len(y), dtype=np.intp)  # of one question
        weights = shares(np.ones(len(y)), everyone, 1)
        self.rounds_ = []
        for _ in range(self.rounds):
            feature, threshold, polarity, error = _best_stump(values, splits, (weights * y)[order])
            if error >= _CHANCE:
                break
            bounded = max(error, _SMALLEST_ERROR)
            votes = round(0.5 * math.log((1.0 - bounded) / bounded), _VOTE_DECIMALS)
            self.rounds_.append(Stump(feature, threshold, polarity, votes))
            if error < _SMALLEST_ERROR:
                break
            h = np.where(polarity * X[:, feature] < polarity * threshold, 1.0, -1.0)
            weights = shares(weights * np.exp(-votes * y * h), everyone, 1)  # eq. 3
        return self

    def margins(self, X: NDArray[Any]) -> FloatArray:
        """(n,) sums of votes: positive where the samples X (n, F) are claimed."""
        X = np.asarray(X, dtype=np.float64)
        if not self.rounds_:
            return np.full(len(X), -1.0)
        feature = [s.feature for s in self.rounds_]
        threshold = np.array([s.threshold for s in self.rounds_])
        polarity = np.array([s.polarity for s in self.rounds_])
        votes = np.array([s.votes for s in self.rounds_])
        claims = polarity * X[:, feature] < polarity * threshold
        return np.asarray(np.where(claims, votes, -votes).sum(axis=1), dtype=np.float64)

    def to_dict(self) -> dict[str, Any]:
        """The fitted rounds by name, ready for JSON."""
        return {
            "kind": self.kind,
            "rounds": [
                {
                    "feature": self.names[s.feature],
                    "threshold": s.threshold,
                    "polarity": s.polarity,
                    "votes": s.votes,
                }
                for s in self.rounds_
            ],
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], names: Sequence[str]) -> StumpBoost:
        """The booster that `to_dict` described; MapError names the entry that makes no sense."""
        column = {name: k for k, name in enumerate(names)}
        rounds = objects(data, "rounds")
        booster = cls(names, len(rounds))
        booster.rounds_ = [_stump(entry, column, f"round {k}") for k, entry in enumerate(rounds)]
        return booster


def _stump(entry: Any, column: Mapping[str, int], where: str) -> Stump:
    """One round as `StumpBoost.to_dict` wrote it."""
    return Stump(
        feature=field(entry, "feature", column, where),
        threshold=number(entry, "threshold", where),
        polarity=field(entry, "polarity", {1: 1, -1: -1}, where),
        votes=number(entry, "votes", where),
    )


Booster = StumpBoost | TreeBoost


def booster_from_dict(data: Mapping[str, Any], names: Sequence[str]) -> Booster:
    """The booster of the kind that `data` names; raises MapError for nonsense."""
    kinds = {"stumps": StumpBoost, "trees": TreeBoost}
    booster: Booster = field(data, "kind", kinds, "classifier").from_dict(data, names)
    return booster


def _best_stump(
    values: FloatArray, splits: NDArray[np.bool_], signed: FloatArray
) -> tuple[int, float, int, float]:
    """The feature, threshold, polarity and weighted error of the best weak classifier, eq. 2.

    `values` (F, n) ascending per feature, `splits` (F, n - 1) where a threshold may stand, `signed`
    (F, n) weight times label in the same order.
    """
    # all below the threshold claimed: error = weight of the positives above and negatives below
    below = np.cumsum(signed, axis=1)[:, :-1]
    positive = float(np.maximum(signed[0], 0.0).sum())
    error = np.where(splits, positive - below, 0.5)
    flipped = np.where(splits, 1.0 - error, 0.5)
    best = [np.unravel_index(int(np.argmin(e)), e.shape) for e in (error, flipped)]
    errors = [float(error[best[0]]), float(flipped[best[1]])]
    side = 0 if errors[0] <= errors[1] else 1
    feature, at = (int(k) for k in best[side])
    threshold = 0.5 * float(values[feature, at] + values[feature, at + 1])
    return feature, threshold, 1 - 2 * side, max(0.0, errors[side])  # eq. 2


def feature_shares(booster: Booster) -> FloatArray:
    """(F,) of the features of a booster: the share of its votes that each decides; sums to one.

    All zero when it asks for none. A split decides by how much the votes on its two sides differ; a
    lower split of a tree does so for every second scan.
    """
    weights = np.zeros(len(booster.names))
    if isinstance(booster, StumpBoost):
        for stump in booster.rounds_:
            weights[stump.feature] += abs(stump.votes)
    else:
        np.add.at(weights, booster.forest_.features, _decided(booster.forest_))
    total = weights.sum()
    return np.asarray(weights / total if total > 0.0 else weights)


def _decided(forest: Forest) -> FloatArray:
    """(T, 3) how far apart the votes on both sides of each node are: root, below, above."""
    a, b, c, d = forest.votes.T
    return np.column_stack([np.abs(a + b - c - d) / 2.0, np.abs(a - b) / 2.0, np.abs(c - d) / 2.0])


_SHRINKAGE = 0.5  # scale of every vote of trees
_ID_DIGITS = 18  # of a submap's id in a file: those of 64 bits


class OneVsAll:
    """A booster for each class, each against all others; the label is that of the largest margin.

    `fit` learns `classes_`, ascending, and `boosters_` by class; `forest_` holds the trees of all
    of them where they are as many each, to ask them together.
    """

    def __init__(self, feature_set: str, config: RecognitionConfig) -> None:
        self.feature_set = feature_set
        self.config = config
        self.classes_: tuple[int, ...] = ()
        self.boosters_: dict[int, Booster] = {}
        self.forest_: Forest | None = None

    def fit(self, samples: Mapping[int, FloatArray], rng: np.random.Generator) -> OneVsAll:
        """Learn from features (n, F) of every class; returns self."""
        ids = sorted(samples)
        X = np.vstack([samples[i] for i in ids])
        owner = np.repeat(ids, [len(samples[i]) for i in ids])
        questions = {i: self._question(owner, i) for i in ids}
        if self.config.booster == "trees":
            return self._of(self._trees(X, questions, int(rng.integers(2**31))))
        return self._of({i: self._stumps(X, question) for i, question in questions.items()})

    def margins(self, X: NDArray[Any]) -> FloatArray:
        """(n, m) margin of every class, columns in the order of `classes_`."""
        X = np.asarray(X, dtype=np.float64)
        if self.forest_ is None:
            return np.column_stack([b.margins(X) for b in self.boosters_.values()])
        return self.forest_.margins(X, len(self.classes_))

    def to_dict(self) -> dict[str, Any]:
        """Feature set and classifiers by class, ready for JSON."""
        return {
            "feature_set": self.feature_set,
            "classifiers": {str(i): b.to_dict() for i, b in self.boosters_.items()},
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> OneVsAll:
        """The fitted classifiers that `to_dict` described.

        MapError names the entry that makes no sense, and a feature set that is not installed.
        """
        feature_set = text(data, "feature_set", "file")
        if feature_set not in feature_sets():
            raise MapError(
                f"classifiers: file: its feature set {feature_set!r} is not installed: install "
                "the package that offers it, or build the map again"
            )
        names = feature_names(feature_set)
        entries = mapping(data, "classifiers")
        boosters: dict[int, Booster] = {}
        for key in sorted(entries, key=_submap_id):
            try:
                boosters[_submap_id(key)] = booster_from_dict(entries[key], names)
            except MapError as error:
                raise MapError(str(error).replace("classifiers:", f"submap {key}:", 1)) from None
        if not boosters:
            raise refuse("file", "it holds no classifier")
        return cls(feature_set, RecognitionConfig())._of(boosters)

    def _of(self, boosters: Mapping[int, Booster]) -> OneVsAll:
        """These classifiers, fitted, become this one's own."""
        self.boosters_ = dict(boosters)
        self.classes_ = tuple(boosters)
        trees = [b.forest_ for b in boosters.values() if isinstance(b, TreeBoost)]
        alike = len(trees) == len(boosters) and len({len(f.votes) for f in trees}) == 1
        self.forest_ = Forest.joined(trees) if alike else None
        return self

    def _question(self, owner: NDArray[Any], class_: int) -> Question:
        """Which samples (n,) the classifier of a class learns from: its own, and some others."""
        own, others = np.flatnonzero(owner == class_), np.flatnonzero(owner != class_)
        chosen = np.concatenate([own, evenly(others, self.config.negatives)])
        return Question(chosen, owner[chosen] == class_)

    def _trees(
        self, X: FloatArray, questions: Mapping[int, Question], seed: int
    ) -> dict[int, Booster]:
        names, config = feature_names(self.feature_set), self.config
        growth = Growth(config.rounds, _SHRINKAGE, FEATURE_SHARE, seed)
        quantiser = Quantiser.of(X)
        forests = grown(quantiser.codes(X), quantiser, list(questions.values()), growth)
        return {i: TreeBoost.of(names, f) for i, f in zip(questions, forests, strict=True)}

    def _stumps(self, X: FloatArray, question: Question) -> StumpBoost:
        booster = StumpBoost(feature_names(self.feature_set), self.config.rounds)
        return booster.fit(X[question.samples], np.where(question.positive, 1, -1))


def _submap_id(key: str) -> int:
    if not key.isdecimal() or len(key) > _ID_DIGITS:
        raise refuse("file", f"{key!r:.60} is no submap id")
    return int(key)
