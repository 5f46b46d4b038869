"""What a classifier looks at: how much of its votes hangs on each feature."""

from __future__ import annotations

import numpy as np

from specmap_cli.core.geometry import FloatArray
from specmap_cli.recognition.learning.boosting import Booster, StumpBoost
from specmap_cli.recognition.learning.forest import Forest


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
