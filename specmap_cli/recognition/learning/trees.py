"""Real AdaBoost on trees of two levels over quantised features: the default classifier."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.recognition.learning.forest import Forest
from specmap_cli.recognition.learning.growing import Growth, Question, grown
from specmap_cli.recognition.learning.json_fields import field, mapping, number, numbers, objects
from specmap_cli.recognition.learning.quantiser import CodeArray, Quantiser

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
