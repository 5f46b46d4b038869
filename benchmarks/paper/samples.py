"""Features and submaps of the scans of a map, and of those held out of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.paper.workshop import Built
from specmap_cli.core.config import load_config
from specmap_cli.core.records import IntArray
from specmap_cli.core.settings import RecognitionConfig
from specmap_cli.evaluation.protocols import (
    ClassificationScores,
    classification_scores,
    nearest_labels,
    poses_at,
)
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.recognition.features.sets import FeatureArray, scans_features
from specmap_cli.recognition.learning.boosting import OneVsAll


@dataclass(frozen=True, slots=True)
class Samples:
    """Features X (n, F) and submaps y (n,) of some scans; -1 for a scan without a submap."""

    X: FeatureArray
    y: IntArray

    def without(self, columns: Sequence[int]) -> Samples:
        """The same scans, some columns of their features taken away: nothing can be told by one."""
        X = self.X.copy()
        X[:, list(columns)] = 0.0
        return replace(self, X=X)


def samples_of(built: Built, feature_set: str) -> tuple[Samples, Samples]:
    """The scans of a map and those held out of it, whose truth is the nearest keyframe's submap."""
    poses = poses_at(built.finished, built.held_out.stamps_ns)
    truth = nearest_labels(poses, built.finished.laid.labels)
    held_out = Samples(_features(built.held_out, feature_set), truth)
    return of_keyframes(built, feature_set), held_out


def the_papers(rounds: int | None = None) -> RecognitionConfig:
    """What the paper says of its classifiers: stumps on Table I, all scans of all others."""
    config = load_config(preset="paper").recognition
    return config if rounds is None else config.model_copy(update={"rounds": rounds})


def fitted(train: Samples, config: RecognitionConfig) -> OneVsAll:
    """One classifier a submap, learned from the scans of a map."""
    own = {int(i): train.X[train.y == i] for i in np.unique(train.y[train.y >= 0])}
    return OneVsAll(config.feature_set, config).fit(own, np.random.default_rng(0))


def scored(classifiers: OneVsAll, asked: Samples) -> ClassificationScores:
    """Recall and precision of the submap that the most votes go to, scan by scan."""
    ids = np.array(classifiers.classes_)
    told = ids[classifiers.margins(asked.X).argmax(axis=1)]
    return classification_scores(asked.y, told, classifiers.classes_)


def of_keyframes(built: Built, feature_set: str) -> Samples:
    """The scans of a map."""
    return Samples(_features(built.store, feature_set), built.finished.laid.labels.submaps)


def _features(store: KeyframeStore, feature_set: str) -> FeatureArray:
    return scans_features((store.scan(k) for k in range(len(store))), feature_set)
