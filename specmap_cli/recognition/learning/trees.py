"""Real AdaBoost on trees of two levels over quantised features: the default classifier.

Features are cut once into at most 32 bins at their quantiles; a round draws a share of the
features and finds the best root split and the best split below it from weighted histograms.
Leaves vote half the log odds of their weights (Schapire and Singer, 1999), shrunk.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.recognition.learning.json_fields import field, mapping, number, numbers, objects

BINS = 32  # more of them learn no better, and cost a round in proportion
CodeArray = NDArray[np.uint8]
# Weight trimming (Friedman, Hastie and Tibshirani, 2000): every few rounds the samples that hold
# the last 2 % of the weight are left out of the search for splits, which they hardly change.
_TRIM_EVERY = 8
_HEAVY_SHARE = 0.98
_NO_EDGE = 1e300  # a threshold that no value reaches, as JSON knows no infinity
_VOTE_DECIMALS = 6  # of votes, which are of the order of one: readable, and safe from rounding
_SHARE_BITS = 52  # weights are whole multiples of 2^-52: sums of them below 2 are exact


@dataclass(frozen=True, slots=True)
class Quantiser:
    """Cuts every feature at its quantiles: `edges` (F, 31), padded with +inf."""

    edges: FloatArray

    @classmethod
    def of(cls, X: NDArray[Any]) -> Quantiser:
        """The quantiser of samples X (n, F)."""
        ordered = np.sort(np.asarray(X, dtype=np.float64), axis=0)
        at = np.linspace(0, len(ordered) - 1, BINS + 1)[1:-1]
        low = ordered[np.floor(at).astype(np.intp)]
        high = ordered[np.minimum(np.floor(at).astype(np.intp) + 1, len(ordered) - 1)]
        cuts = 0.5 * (low + high).T
        edges = np.full(cuts.shape, np.inf)
        for row, values in zip(edges, cuts, strict=True):
            distinct = np.unique(values)
            row[: len(distinct)] = distinct
        return cls(edges)

    def codes(self, X: NDArray[Any]) -> CodeArray:
        """(F, n) bin of every value: how many edges it reaches."""
        X = np.asarray(X, dtype=np.float64)
        codes = np.empty((X.shape[1], len(X)), dtype=np.uint8)
        for row, edges, values in zip(codes, self.edges, X.T, strict=True):
            row[:] = np.searchsorted(edges, values, side="right")
        return codes


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


class TreeBoost:
    """Real AdaBoost on trees of two levels; the two classes start with equal total weight.

    `names` are the columns' names; `shrinkage` scales every leaf; `feature_share` of the features
    is drawn each round by a generator seeded with `seed`. `forest_` holds the fitted trees.
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
        self.rounds = rounds
        self.shrinkage = shrinkage
        self.feature_share = feature_share
        self.seed = seed
        self.forest_ = Forest(np.zeros((0, 3), dtype=np.intp), np.zeros((0, 3)), np.zeros((0, 4)))

    def fit(self, X: NDArray[Any], y: NDArray[Any]) -> TreeBoost:
        """Learn from features X (n, F) and labels y (n,) of +1 and -1; returns self."""
        quantiser = Quantiser.of(X)
        return self.fit_codes(quantiser.codes(X), quantiser, y)

    def fit_codes(self, codes: CodeArray, quantiser: Quantiser, y: NDArray[Any]) -> TreeBoost:
        """The same from features that are cut already: `codes` (F, n) of `quantiser`."""
        positive = np.asarray(y) > 0
        counts = max(1, int(positive.sum())), max(1, int((~positive).sum()))
        weights = shares(np.where(positive, 0.5 / counts[0], 0.5 / counts[1]))
        smooth = 0.5 / len(positive)  # half a sample in each class: no leaf's odds are infinite
        rng = np.random.default_rng(self.seed)
        drawn = max(1, round(self.feature_share * len(codes)))
        active = np.arange(len(positive))
        trees: list[tuple[NDArray[np.intp], NDArray[np.intp], FloatArray]] = []
        for k in range(self.rounds):
            if k and k % _TRIM_EVERY == 0:
                active = _heavy(weights)
            subset = np.sort(rng.choice(len(codes), drawn, replace=False))
            nodes, cuts = _grow(
                codes[np.ix_(subset, active)], weights[active], positive[active], subset
            )
            leaf = _leaves(codes, nodes, cuts)
            sums = np.bincount(leaf + 4 * positive, weights, minlength=8)
            odds = (sums[4:] + smooth) / (sums[:4] + smooth)
            votes = np.round(0.5 * self.shrinkage * np.log(odds), _VOTE_DECIMALS)
            trees.append((nodes, cuts, votes))
            grown = weights * np.exp(np.where(positive, -votes[leaf], votes[leaf]))  # eq. 3
            weights = shares(grown)
        self.forest_ = _forest(trees, quantiser)
        return self

    def margins(self, X: NDArray[Any]) -> FloatArray:
        """(n,) sums of votes: positive where the samples X (n, F) are claimed."""
        votes = self.forest_.tree_votes(np.asarray(X, dtype=np.float64))
        return np.asarray(votes.sum(axis=1), dtype=np.float64)

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
        booster = cls(names, len(rounds))
        features = np.zeros((len(rounds), 3), dtype=np.intp)
        thresholds, votes = np.zeros((len(rounds), 3)), np.zeros((len(rounds), 4))
        for k, entry in enumerate(rounds):
            for j, part in enumerate(("root", "below", "above")):
                where = f"round {k}, {part}"
                split = mapping(entry, part, where)
                features[k, j] = field(split, "feature", column, where)
                thresholds[k, j] = number(split, "threshold", where)
            votes[k] = numbers(entry, "votes", 4, f"round {k}")
        booster.forest_ = Forest(features, thresholds, votes)
        return booster


def shares(weights: FloatArray) -> FloatArray:
    """Weights (n,) scaled to a sum of one, such that any sum of some of them is exact.

    So two splits that part the samples alike are equally good to the last bit, whatever the order
    of summation, and the first one is taken on every processor.
    """
    whole = np.round(np.ldexp(weights, _SHARE_BITS))
    return np.asarray(np.ldexp(np.round(np.ldexp(whole / whole.sum(), _SHARE_BITS)), -_SHARE_BITS))


def _grow(
    codes: CodeArray,
    weights: FloatArray,
    positive: NDArray[np.bool_],
    subset: NDArray[np.intp],
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """The best tree on features `subset`: feature (3,) and cut (3,) of its nodes.

    `codes` (K, n) are those features' bins. A sample goes above where its bin passes the cut.
    """
    offsets = (2 * BINS * np.arange(len(codes)))[:, None]
    flat = codes + (offsets + BINS * positive)  # feature, class, bin
    tiled = np.tile(weights, len(codes))
    shape, size = (len(codes), 2, BINS), 2 * BINS * len(codes)
    whole = _weigh(flat.ravel(), tiled, size).reshape(shape)
    (root,), (root_cut,) = _best_splits(whole[None])
    upper = codes[root] > root_cut
    tiled = np.tile(weights[upper], len(codes))
    above = _weigh(flat[:, upper].ravel(), tiled, size).reshape(shape)
    below_above, child_cuts = _best_splits(np.stack([whole - above, above]))
    nodes = subset[[root, *below_above]]
    return nodes, np.array([root_cut, *child_cuts])


def _weigh(bins: NDArray[Any], weights: FloatArray, size: int) -> FloatArray:
    """(size,) sum of the weights (n,) in each bin."""
    return np.asarray(np.bincount(bins, weights, minlength=size), dtype=np.float64)


def _best_splits(histograms: FloatArray) -> tuple[list[int], list[int]]:
    """Feature and cut of least sum of sqrt(W+ W-) over both sides, for each of N nodes.

    `histograms` (N, K, 2, BINS): weights by feature, class and bin.
    """
    below = np.cumsum(histograms, axis=3)
    above = below[..., -1:] - below
    # rounding can leave a weight of nought slightly negative
    impurity = np.sqrt(np.abs(below[:, :, 0] * below[:, :, 1]))
    impurity += np.sqrt(np.abs(above[:, :, 0] * above[:, :, 1]))
    best = impurity[..., :-1].reshape(len(histograms), -1).argmin(axis=1)
    features, cuts = np.divmod(best, BINS - 1)
    return features.tolist(), cuts.tolist()


def _leaves(codes: CodeArray, nodes: NDArray[np.intp], cuts: NDArray[np.intp]) -> NDArray[np.intp]:
    """(n,) number of the leaf of every sample."""
    upper = codes[nodes[0]] > cuts[0]
    above = np.where(upper, codes[nodes[2]] > cuts[2], codes[nodes[1]] > cuts[1])
    return np.asarray(2 * upper + above, dtype=np.intp)


def _heavy(weights: FloatArray) -> NDArray[np.intp]:
    """The heaviest samples, which hold 98 % of the weight, ascending; the others wait."""
    order = np.argsort(-weights, kind="stable")
    enough = int(np.searchsorted(np.cumsum(weights[order]), _HEAVY_SHARE * weights.sum())) + 1
    return np.sort(order[:enough])


def _forest(
    trees: Sequence[tuple[NDArray[np.intp], NDArray[np.intp], FloatArray]], quantiser: Quantiser
) -> Forest:
    """The trees with thresholds in the features' units."""
    features = np.array([t[0] for t in trees], dtype=np.intp).reshape(-1, 3)
    cuts = np.array([t[1] for t in trees], dtype=np.intp).reshape(-1, 3)
    thresholds = quantiser.edges[features, cuts]
    # no edge stands there: the feature has fewer distinct values, and nothing lies above
    thresholds = np.where(np.isfinite(thresholds), thresholds, _NO_EDGE)
    return Forest(features, thresholds, np.array([t[2] for t in trees]).reshape(-1, 4))
