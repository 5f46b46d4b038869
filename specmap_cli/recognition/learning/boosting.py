"""AdaBoost on one-threshold weak classifiers, exactly as in the paper (Section III-A, eq. 2, 3).

`StumpBoost` is the paper's own; `TreeBoost`, of `learning.trees`, is the default: the same idea
with quantised features and weak classifiers of two levels. Both are estimators: the constructor
stores, `fit` learns, `margins` is the sum of votes, whose sign is the label.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.recognition.learning.growing import shares
from specmap_cli.recognition.learning.json_fields import field, number, objects
from specmap_cli.recognition.learning.trees import TreeBoost

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
