"""Growing the trees of many classifiers at once: Real AdaBoost on quantised features.

A round draws a share of the features, the same for all classifiers, and finds the best root split
and the best split below it for each of them from weighted histograms. Leaves vote half the log
odds of their weights (Schapire and Singer, 1999), shrunk; half a sample of either side is added, so
that what few samples do not show is not ruled out. Classifiers share nothing but the draws:
each is the same whether it is learned alone or with others.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import BoolArray

BINS = 16  # more of them learn no better, and cost a round in proportion
CodeArray = NDArray[np.uint8]
VOTE_DECIMALS = 6  # of votes, which are of the order of one: readable, and safe from rounding
IndexArray = NDArray[np.intp]
_FEATURE_SHARE = 0.1  # share of the features that are drawn for a round
_SHRINKAGE = 0.5  # scale of every vote
# Weight trimming (Friedman, Hastie and Tibshirani, 2000): every few rounds the samples that hold
# the last 2 % of the weight are left out of the search for splits, which they hardly change.
_TRIM_EVERY = 8
_LIGHT_SHARE = 0.02
_NO_EDGE = 1e300  # a threshold that no value reaches, as JSON knows no infinity
_WHOLE = 2.0**52  # weights are whole multiples of 2^-52: sums of them below 2 are exact
_ROWS_AT_ONCE = 64  # samples that all trees are asked about at once: bounds the memory
_SAMPLES_AT_ONCE = 1 << 15  # about, of classifiers grown together: bounds the memory, some 10 MB


@dataclass(frozen=True, slots=True)
class Quantiser:
    """Cuts every feature at its quantiles: `edges` (F, BINS - 1), padded with +inf."""

    edges: FloatArray

    @classmethod
    def of(cls, X: NDArray[Any]) -> Quantiser:
        """The quantiser of samples X (n, F)."""
        at = np.linspace(0, len(X) - 1, BINS + 1)[1:-1]
        low = np.floor(at).astype(np.intp)
        high = np.minimum(low + 1, len(X) - 1)
        edges = np.full((X.shape[1], len(at)), np.inf)
        for row, values in zip(edges, X.T, strict=True):  # one by one: no second copy of all
            ordered = np.sort(np.asarray(values, dtype=np.float64))
            distinct = np.unique(0.5 * (ordered[low] + ordered[high]))
            row[: len(distinct)] = distinct
        return cls(edges)

    def codes(self, X: NDArray[Any]) -> CodeArray:
        """(F, n) bin of every value: how many edges it reaches."""
        codes = np.empty((X.shape[1], len(X)), dtype=np.uint8)
        for row, edges, values in zip(codes, self.edges, X.T, strict=True):
            row[:] = np.searchsorted(edges, np.asarray(values, dtype=np.float64), side="right")
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

    def margins(self, X: NDArray[Any], classes: int) -> FloatArray:
        """(n, m) sums of the votes on samples X (n, F) of each of `classes` forests in a row.

        Rounded as the votes are: so the order of summation does not show.
        """
        trees, sums = np.arange(len(self.votes)), np.empty((len(X), classes))
        for first in range(0, len(X), _ROWS_AT_ONCE):
            some = X[first : first + _ROWS_AT_ONCE]
            upper = some[:, self.features[:, 0]] >= self.thresholds[:, 0]
            node = trees * 3 + 1 + upper
            feature = self.features.ravel()[node]
            value = X[0][feature] if len(X) == 1 else np.take_along_axis(some, feature, axis=1)
            above = value >= self.thresholds.ravel()[node]
            votes = self.votes.ravel()[trees * 4 + 2 * upper + above]
            sums[first : first + len(some)] = votes.reshape(len(some), classes, -1).sum(axis=2)
        return np.round(sums, VOTE_DECIMALS)


@dataclass(frozen=True, slots=True)
class Question:
    """What a classifier learns: the columns (n,) of the codes that it sees, and which it claims."""

    samples: IndexArray
    positive: BoolArray


def grown(
    codes: CodeArray,
    quantiser: Quantiser,
    questions: Sequence[Question],
    rounds: int,
    rng: np.random.Generator,
) -> list[Forest]:
    """The forest of every question, from the bins (F, N) of all samples by `quantiser`.

    The two sides of each question start with equal total weight.
    """
    drawing = np.random.default_rng(int(rng.integers(2**31)))
    drawn = max(1, round(_FEATURE_SHARE * len(codes)))
    draws = [np.sort(drawing.choice(len(codes), drawn, replace=False)) for _ in range(rounds)]
    held = np.cumsum([len(question.samples) for question in questions])
    forests: list[Forest] = []
    for _, batch in groupby(range(len(questions)), lambda k: held[k] // _SAMPLES_AT_ONCE):
        features, cuts, votes = _boosted(codes, [questions[k] for k in batch], draws)
        # where no edge stands, the feature has fewer distinct values, and nothing lies above
        edges = quantiser.edges[features, cuts]
        thresholds = np.where(np.isfinite(edges), edges, _NO_EDGE)
        forests += map(Forest, features, thresholds, votes)
    return forests


def shares(weights: FloatArray, owner: IndexArray, owners: int) -> FloatArray:
    """Weights (S,) scaled to a sum of one for each owner, such that any sum of some is exact.

    So two splits that part the samples alike are equally good to the last bit, whatever the order
    of summation, and the first one is taken on every processor.
    """
    whole = np.rint(weights * _WHOLE)
    totals = np.bincount(owner, whole, minlength=owners)
    return np.asarray(np.rint(whole / totals[owner] * _WHOLE) / _WHOLE)


@dataclass(frozen=True, slots=True)
class _Asked:
    """The samples of C questions in a row: their columns, question and side (S,) each."""

    samples: IndexArray
    question: IndexArray
    positive: BoolArray
    counts: IndexArray  # (C,) samples of each question


def _boosted(
    codes: CodeArray, questions: Sequence[Question], draws: Sequence[IndexArray]
) -> tuple[IndexArray, IndexArray, FloatArray]:
    """The trees of C questions, one a round: features and cuts (C, T, 3), votes (C, T, 4)."""
    count = len(questions)
    counts = np.array([len(question.samples) for question in questions], dtype=np.intp)
    asked = _Asked(
        np.concatenate([question.samples for question in questions]),
        np.repeat(np.arange(count), counts),
        np.concatenate([question.positive for question in questions]),
        counts,
    )
    # to either side half of the weight; of a side without samples each has that of one of all
    positive = np.bincount(asked.question, asked.positive, minlength=count)
    sides = np.column_stack([counts - positive, positive])
    each = 0.5 / np.where(sides > 0.0, sides, counts[:, None])
    smooth = 0.5 * each[:, :, None]  # half a sample of either side
    side_of = asked.positive.astype(np.intp)
    weights = shares(each[asked.question, side_of], asked.question, count)
    bins = codes.ravel()
    trees = []
    for k, drawn in enumerate(draws):
        if k % _TRIM_EVERY == 0:
            heavy = _heavy(weights, counts)
            searched = _Asked(
                asked.samples[heavy],
                asked.question[heavy],
                asked.positive[heavy],
                np.bincount(asked.question[heavy], minlength=count),
            )
        features, cuts = _split(codes[drawn], searched, weights[heavy])
        features = drawn[features]
        # the leaf of every sample in the tree of its question
        starts, passed = (features * codes.shape[1]).ravel(), cuts.ravel().astype(np.uint8)
        node = 3 * asked.question
        upper = bins[starts[node] + asked.samples] > passed[node]
        node += 1 + upper
        above = bins[starts[node] + asked.samples] > passed[node]
        leaf = 8 * asked.question + 4 * side_of + 2 * upper + above
        sums = np.bincount(leaf, weights, minlength=8 * count).reshape(count, 2, 4)
        odds = (sums[:, 1] + smooth[:, 1]) / (sums[:, 0] + smooth[:, 0])
        votes = np.round(0.5 * _SHRINKAGE * np.log(odds), VOTE_DECIMALS)
        trees.append((features, cuts, votes))
        growth = np.exp(np.stack([votes, -votes], axis=1))  # eq. 3, a leaf and side at a time
        weights = shares(weights * growth.ravel()[leaf], asked.question, count)
    features, cuts, votes = (np.stack(part, axis=1) for part in zip(*trees, strict=True))
    return features, cuts, votes


def _heavy(weights: FloatArray, counts: IndexArray) -> IndexArray:
    """The samples that remain without the lightest of each question, ascending."""
    kept = []
    first = 0
    for count in counts.tolist():
        own = weights[first : first + count]
        ordered = np.sort(own)
        summed = np.cumsum(ordered)
        least = ordered[np.searchsorted(summed, _LIGHT_SHARE * summed[-1], side="right")]
        kept.append(first + np.flatnonzero(own >= least))
        first += count
    return np.concatenate(kept)


def _split(codes: CodeArray, asked: _Asked, weights: FloatArray) -> tuple[IndexArray, IndexArray]:
    """The best tree of each question on bins `codes` (K, N): feature and cut (C, 3) a node."""
    count, drawn = len(asked.counts), len(codes)
    shape = (count, drawn, 2, BINS)
    own = codes.take(asked.samples, axis=1)
    first = asked.question * (drawn * 2 * BINS) + BINS * asked.positive.astype(np.intp)
    cell = np.asarray(own + first, dtype=np.intp)
    cell += (np.arange(drawn) * (2 * BINS))[:, None]
    whole = _weigh(cell, weights, shape)
    root, root_cut = _best_splits(whole)
    upper = own[root[asked.question], np.arange(len(weights))] > root_cut[asked.question]
    # the histogram of the smaller side is summed, that of the larger one is the rest
    fewer_above = 2 * np.bincount(asked.question, upper, minlength=count) <= asked.counts
    fewer = np.flatnonzero(upper == fewer_above[asked.question])
    smaller = _weigh(cell.take(fewer, axis=1), weights[fewer], shape)
    found, cut = _best_splits(np.concatenate([whole - smaller, smaller]))
    below = np.arange(count) + np.where(fewer_above, 0, count)
    above = np.arange(count) + np.where(fewer_above, count, 0)
    features = np.column_stack([root, found[below], found[above]])
    return features, np.column_stack([root_cut, cut[below], cut[above]])


def _weigh(cells: IndexArray, weights: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """The histograms of weights (S,) in the cells (K, S) of each feature."""
    spread = np.broadcast_to(weights, cells.shape).ravel()
    summed = np.bincount(cells.ravel(), spread, minlength=math.prod(shape))
    return np.asarray(summed, dtype=np.float64).reshape(shape)


def _best_splits(histograms: FloatArray) -> tuple[IndexArray, IndexArray]:
    """Feature and cut (N,) of least sum of sqrt(W+ W-) over both sides, for each of N nodes.

    `histograms` (N, K, 2, BINS): weights by feature, side of the question and bin. Single precision
    is enough: sums are exact before they are rounded to it.
    """
    summed = np.cumsum(histograms, axis=3)
    below = summed[..., :-1].astype(np.float32)
    above = (summed[..., -1:] - summed[..., :-1]).astype(np.float32)
    impurity = np.sqrt(below[:, :, 0] * below[:, :, 1])
    impurity += np.sqrt(above[:, :, 0] * above[:, :, 1])
    best = impurity.reshape(len(histograms), -1).argmin(axis=1)
    return np.divmod(best, BINS - 1)
