"""Boosted classifiers of features, one a submap against all others (Section III-A, eq. 2, 3).

`StumpBoost` is the paper's own AdaBoost on one-threshold weak classifiers; `TreeBoost` is the
default: the same idea with quantised features and weak classifiers of two levels, grown for many
submaps at once. `margins` is the sum of votes, whose sign is the label. `OneVsAll` has one of them
for every submap. Their `...Part` is how they stand in JSON.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import chain
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, field_validator, with_config

from specmap_cli.core.arrays import evenly
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.settings import RecognitionConfig
from specmap_cli.core.text import quoted
from specmap_cli.recognition.features.sets import feature_names
from specmap_cli.recognition.learning.trees import (
    Forest,
    Quantiser,
    Question,
    grown,
    shares,
)

_SMALLEST_ERROR = 1e-10  # below it a round separates the samples: its votes stay finite
_VOTE_DECIMALS = 9  # of votes: the last bits of a logarithm are not the same on every processor
_CHANCE = 0.5 - 1e-12  # the error of a coin, but for rounding


class WrongPartError(Exception):
    """A part of classifiers.json has the right form, and yet does not belong there: which, why."""


class Part(BaseModel):
    """A part of classifiers.json. Unknown keys are left out; a key that is there has a value."""

    model_config = ConfigDict(strict=True, frozen=True, allow_inf_nan=False)

    @field_validator("*")
    @classmethod
    def _is_no_null(cls, value: Any) -> Any:
        if value is None:  # only what is not there at all is None
            raise ValueError("null is not what belongs here")
        return value


# The same for a dataclass that is read as such a part.
as_part = with_config(ConfigDict(strict=True, allow_inf_nan=False))


@as_part
@dataclass(frozen=True, slots=True)
class SplitPart:
    """A node of a tree: samples below the threshold go one way, all others the other way."""

    feature: str
    threshold: float


@as_part
@dataclass(frozen=True, slots=True)
class TreePart:
    """A tree of two levels; votes are those of `Forest`."""

    root: SplitPart
    below: SplitPart
    above: SplitPart
    votes: tuple[float, float, float, float]


@as_part
@dataclass(frozen=True, slots=True)
class StumpPart(SplitPart):
    """A `Stump` by the name of its feature."""

    polarity: Literal[1, -1]
    votes: float


class TreesPart(Part):
    """The rounds of a `TreeBoost`."""

    kind: Literal["trees"]
    rounds: list[TreePart]


class StumpsPart(Part):
    """The rounds of a `StumpBoost`."""

    kind: Literal["stumps"]
    rounds: list[StumpPart]


BoosterPart = Annotated[TreesPart | StumpsPart, Field(discriminator="kind")]


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
        rounds = [asdict(stump) | {"feature": self.names[stump.feature]} for stump in self.rounds_]
        return {"kind": "stumps", "rounds": rounds}


@dataclass(frozen=True, slots=True)
class TreeBoost:
    """Real AdaBoost on trees of two levels; `names` are the columns' names."""

    names: tuple[str, ...]
    forest_: Forest

    def margins(self, X: NDArray[Any]) -> FloatArray:
        """(n,) sums of votes: positive where the samples X (n, F) are claimed."""
        return self.forest_.margins(np.asarray(X, dtype=np.float64), classes=1)[:, 0]

    def to_dict(self) -> dict[str, Any]:
        """The rounds by name, ready for JSON."""
        rounds = []
        columns = self.forest_.features.tolist(), self.forest_.thresholds.tolist()
        for features, thresholds, votes in zip(*columns, self.forest_.votes.tolist(), strict=True):
            root, below, above = (
                {"feature": self.names[feature], "threshold": threshold}
                for feature, threshold in zip(features, thresholds, strict=True)
            )
            rounds.append({"root": root, "below": below, "above": above, "votes": votes})
        return {"kind": "trees", "rounds": rounds}


Booster = StumpBoost | TreeBoost


def booster_of(part: TreesPart | StumpsPart, names: Sequence[str], where: str) -> Booster:
    """The booster that `to_dict` described. Raises WrongPartError for a feature that is none."""
    column = {name: k for k, name in enumerate(names)}
    asked = [
        (one,) if isinstance(one, StumpPart) else (one.root, one.below, one.above)
        for one in part.rounds
    ]
    for k, splits in enumerate(asked):
        for split in splits:
            if split.feature not in column:
                what = f"{quoted(split.feature)} is no feature of the set"
                raise WrongPartError(f"{where}.rounds.{k}: {what}")
    if isinstance(part, StumpsPart):
        stumps = StumpBoost(names, len(part.rounds))
        stumps.rounds_ = [
            Stump(column[one.feature], one.threshold, one.polarity, one.votes)
            for one in part.rounds
        ]
        return stumps
    nodes = list(chain.from_iterable(asked))
    forest = Forest(
        np.array([column[node.feature] for node in nodes], dtype=np.intp).reshape(-1, 3),
        np.array([node.threshold for node in nodes], dtype=np.float64).reshape(-1, 3),
        np.array([one.votes for one in part.rounds], dtype=np.float64).reshape(-1, 4),
    )
    return TreeBoost(tuple(names), forest)


def boosted(
    names: Sequence[str], X: NDArray[Any], questions: Sequence[Question], rounds: int
) -> list[Booster]:
    """The stumps that answer each question about features X (n, F)."""
    return [
        StumpBoost(names, rounds).fit(X[asked.samples], np.where(asked.positive, 1.0, -1.0))
        for asked in questions
    ]


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

    def fit(self, samples: Mapping[int, NDArray[Any]], rng: np.random.Generator) -> OneVsAll:
        """Learn from features (n, F) of every class; returns self."""
        ids, names, rounds = sorted(samples), feature_names(self.feature_set), self.config.rounds
        X = np.vstack([samples[i] for i in ids])
        owner = np.repeat(ids, [len(samples[i]) for i in ids])
        questions = []
        for i in ids:
            others = evenly(np.flatnonzero(owner != i), self.config.negatives)
            chosen = np.concatenate([np.flatnonzero(owner == i), others])
            questions.append(Question(chosen, owner[chosen] == i))
        boosters: list[Booster]
        if self.config.booster == "trees":
            quantiser = Quantiser.of(X)
            codes = quantiser.codes(X)
            del X  # of many scans it is most of the memory
            forests = grown(codes, quantiser, questions, rounds, rng)
            boosters = [TreeBoost(names, forest) for forest in forests]
        else:
            boosters = boosted(names, X, questions, rounds)
        return self.become(dict(zip(ids, boosters, strict=True)))

    def become(self, boosters: Mapping[int, Booster]) -> OneVsAll:
        """Fitted classifiers, by class in ascending order, become this one's own; returns self."""
        self.boosters_ = dict(boosters)
        self.classes_ = tuple(boosters)
        trees = [b.forest_ for b in boosters.values() if isinstance(b, TreeBoost)]
        alike = len(trees) == len(boosters) and len({len(f.votes) for f in trees}) == 1
        self.forest_ = None
        if alike:
            self.forest_ = Forest(
                np.vstack([forest.features for forest in trees]),
                np.vstack([forest.thresholds for forest in trees]),
                np.vstack([forest.votes for forest in trees]),
            )
        return self

    def margins(self, X: NDArray[Any]) -> FloatArray:
        """(n, m) margin of every class, columns in the order of `classes_`."""
        X = np.asarray(X, dtype=np.float64)
        if self.forest_ is None:
            return np.column_stack([b.margins(X) for b in self.boosters_.values()])
        return self.forest_.margins(X, len(self.classes_))


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
        a, b, c, d = booster.forest_.votes.T
        apart = [np.abs(a + b - c - d) / 2.0, np.abs(a - b) / 2.0, np.abs(c - d) / 2.0]
        np.add.at(weights, booster.forest_.features, np.column_stack(apart))
    total = weights.sum()
    return np.asarray(weights / total if total > 0.0 else weights)
