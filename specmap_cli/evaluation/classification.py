"""Scores of predicted submaps against true ones: recall, precision, confusion (Table II)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class ClassificationScores:
    """Predictions against truth over the classes `ids`.

    `confusion` (m, m + 1) counts scans by true class (row) and predicted one (column), the last
    column those called unknown, or given a label that is no class.
    """

    ids: tuple[int, ...]
    confusion: NDArray[np.int64]

    @property
    def scans(self) -> int:
        """How many scans were scored."""
        return int(self.confusion.sum())

    @property
    def recall_of(self) -> dict[int, float]:
        """Share of each class's scans that were labelled so; classes with scans only."""
        rows = self.confusion.sum(axis=1)
        return {
            i: float(self.confusion[k, k] / rows[k]) for k, i in enumerate(self.ids) if rows[k] > 0
        }

    @property
    def precision_of(self) -> dict[int, float]:
        """Share of the scans labelled so that are of the class; nought when it was never called.

        Of the classes with scans only: another cannot be right.
        """
        called = self.confusion.sum(axis=0)
        return {
            i: float(self.confusion[k, k] / called[k]) if called[k] else 0.0
            for k, i in enumerate(self.ids)
            if self.confusion[k].any()
        }

    @property
    def recall(self) -> float:
        """Macro average: every class counts alike, as in the paper's Table II."""
        return _mean(self.recall_of.values())

    @property
    def precision(self) -> float:
        """Macro average: every class counts alike, as in the paper's Table II."""
        return _mean(self.precision_of.values())

    @property
    def accuracy(self) -> float:
        """Share of all scans that were labelled right."""
        return float(np.trace(self.confusion)) / self.scans if self.scans else 0.0

    def as_dict(self) -> dict[str, Any]:
        """The macro averages and the count of scans."""
        return {
            "recall": round(self.recall, 6),
            "precision": round(self.precision, 6),
            "accuracy": round(self.accuracy, 6),
            "scans": self.scans,
        }


def classification_scores(
    truth: Sequence[int] | NDArray[Any],
    predicted: Sequence[int | None] | NDArray[Any],
    ids: Iterable[int],
) -> ClassificationScores:
    """Score `predicted` (n,) against `truth` (n,); scans whose truth is no class are left out.

    A prediction of None, or of anything that is no class, counts as unknown: wrong, but no other
    class's fault.
    """
    classes = tuple(sorted(ids))
    number = {submap: k for k, submap in enumerate(classes)}
    confusion = np.zeros((len(classes), len(classes) + 1), dtype=np.int64)
    for true, guess in zip(truth, predicted, strict=True):
        row = number.get(int(true))
        if row is not None:
            column = len(classes) if guess is None else number.get(int(guess), len(classes))
            confusion[row, column] += 1
    return ClassificationScores(classes, confusion)


def score_lines(scores: ClassificationScores) -> list[str]:
    """A table of recall and precision per class."""
    lines = [f"{'submap':>8} {'scans':>7} {'recall':>7} {'precision':>10}"]
    precision = scores.precision_of
    counts = dict(zip(scores.ids, scores.confusion.sum(axis=1).tolist(), strict=True))
    for submap, recall in scores.recall_of.items():
        lines.append(f"{submap:>8} {counts[submap]:7,} {recall:7.3f} {precision[submap]:10.3f}")
    lines.append(f"{'mean':>8} {scores.scans:7,} {scores.recall:7.3f} {scores.precision:10.3f}")
    return lines


def _mean(values: Iterable[float]) -> float:
    listed = list(values)
    return sum(listed) / len(listed) if listed else 0.0
