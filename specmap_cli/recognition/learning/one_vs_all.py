"""One classifier a submap, one against all others (Section III-A)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.arrays import evenly
from specmap_cli.core.errors import MapError
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.settings import RecognitionConfig
from specmap_cli.recognition.features.sets import feature_names, feature_sets
from specmap_cli.recognition.learning.boosting import Booster, StumpBoost, booster_from_dict
from specmap_cli.recognition.learning.forest import Forest
from specmap_cli.recognition.learning.growing import Growth, Question, grown
from specmap_cli.recognition.learning.json_fields import mapping, refuse, text
from specmap_cli.recognition.learning.quantiser import Quantiser
from specmap_cli.recognition.learning.trees import FEATURE_SHARE, TreeBoost

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
