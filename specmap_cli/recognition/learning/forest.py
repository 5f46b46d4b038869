"""Trees of two levels in arrays, and the votes of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray

VOTE_DECIMALS = 6  # of votes, which are of the order of one: readable, and safe from rounding


@dataclass(frozen=True, slots=True)
class Forest:
    """Trees of two levels in arrays: node 0 the root, 1 below its threshold, 2 above.

    `features` and `thresholds` (T, 3); `votes` (T, 4): below-below, below-above, above-below,
    above-above.
    """

    features: NDArray[np.intp]
    thresholds: FloatArray
    votes: FloatArray

    @classmethod
    def bare(cls) -> Forest:
        """A forest without trees."""
        return cls(np.zeros((0, 3), dtype=np.intp), np.zeros((0, 3)), np.zeros((0, 4)))

    @classmethod
    def joined(cls, forests: Sequence[Forest]) -> Forest:
        """The trees of several forests, one forest after the other."""
        return cls(
            np.vstack([forest.features for forest in forests]),
            np.vstack([forest.thresholds for forest in forests]),
            np.vstack([forest.votes for forest in forests]),
        )

    def tree_votes(self, X: NDArray[Any]) -> FloatArray:
        """(n, T) vote of each tree on samples X (n, F)."""
        trees = np.arange(len(self.votes))
        upper = X[:, self.features[:, 0]] >= self.thresholds[:, 0]
        node = trees * 3 + 1 + upper
        feature = self.features.ravel()[node]
        value = X[0][feature] if len(X) == 1 else np.take_along_axis(X, feature, axis=1)
        above = value >= self.thresholds.ravel()[node]
        return np.asarray(self.votes.ravel()[trees * 4 + 2 * upper + above])

    def margins(self, X: NDArray[Any], classes: int) -> FloatArray:
        """(n, m) sums of the votes of each of `classes` forests that were joined.

        Rounded as the votes are: so the order of summation does not show.
        """
        votes = self.tree_votes(X)
        sums = votes.reshape(len(X), classes, votes.shape[1] // classes).sum(axis=2)
        return np.asarray(np.round(sums, VOTE_DECIMALS))
