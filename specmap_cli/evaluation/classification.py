"""Scores of predicted submaps against true ones: recall, precision, confusion (Table II)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

UNKNOWN = -1

_CELL_PIXELS = 28
_MARGIN_PIXELS = 60
_INK = (40, 40, 40)


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


def confusion_picture(scores: ClassificationScores) -> NDArray[np.uint8]:
    """(H, W, 3) picture of the confusion matrix: rows the truth, columns the label, last unknown.

    Dark is a large share of the row; the number in a cell is the percentage.
    """
    rows, columns = scores.confusion.shape
    height = _MARGIN_PIXELS + rows * _CELL_PIXELS + 10
    width = _MARGIN_PIXELS + columns * _CELL_PIXELS + 10
    picture = np.full((height, width, 3), 255, dtype=np.uint8)
    shares = scores.confusion / np.maximum(scores.confusion.sum(axis=1, keepdims=True), 1)
    for r in range(rows):
        for c in range(columns):
            _draw_cell(picture, r, c, float(shares[r, c]), on_diagonal=r == c)
    for k, name in enumerate([*map(str, scores.ids), "?"]):
        at = _MARGIN_PIXELS + k * _CELL_PIXELS
        _write(picture, name, at + 4, _MARGIN_PIXELS - 8)
        if k < rows:
            _write(picture, name, _MARGIN_PIXELS - 28, at + 18)
    _write(picture, "label", _MARGIN_PIXELS, 18)
    _write(picture, "true", 4, _MARGIN_PIXELS - 8)
    return picture


def _draw_cell(picture: NDArray[Any], r: int, c: int, share: float, on_diagonal: bool) -> None:
    x, y = _MARGIN_PIXELS + c * _CELL_PIXELS, _MARGIN_PIXELS + r * _CELL_PIXELS
    tint = np.array((150, 90, 20) if on_diagonal else (40, 60, 200))
    colour = (255 + share * (tint - 255)).tolist()
    cv2.rectangle(picture, (x, y), (x + _CELL_PIXELS - 2, y + _CELL_PIXELS - 2), colour, -1)
    if share >= 0.005:
        ink = (255, 255, 255) if share > 0.6 else _INK
        _write(picture, f"{100 * share:.0f}", x + 3, y + 18, ink, 0.32)


def _write(
    picture: NDArray[Any],
    text: str,
    x: int,
    y: int,
    colour: tuple[int, int, int] = _INK,
    size: float = 0.4,
) -> None:
    cv2.putText(picture, text, (x, y), cv2.FONT_HERSHEY_SIMPLEX, size, colour, 1, cv2.LINE_AA)


def _mean(values: Iterable[float]) -> float:
    listed = list(values)
    return sum(listed) / len(listed) if listed else 0.0
