"""Are the probabilities of labels what they say?

Of 100 labels with a probability of 0.8, 80 should be right: the expected calibration error is the
mean difference between probability and share of right labels, over ten bins, weighted by the labels
in each (Guo et al., ICML 2017). `single` are labels of single scans, `filtered` those of all scans
so far, with the probabilities that `specmap localize` writes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.paper.workshop import Built
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import IntArray
from specmap_cli.evaluation.protocols import labels_of, nearest_labels, poses_at
from specmap_cli.recognition.localization.localizer import Label

BINS = 10
_WIDTH = 40  # characters of a row of the diagram


@dataclass(frozen=True, slots=True)
class Reliability:
    """Per bin of probability: how many labels, their mean probability, the share that is right."""

    labels: IntArray
    probability: FloatArray
    right: FloatArray

    @property
    def error(self) -> float:
        """The expected calibration error."""
        off = np.abs(self.probability - self.right)
        return float((off * self.labels).sum() / max(1, self.labels.sum()))


@dataclass(frozen=True, slots=True)
class Told:
    """Probabilities (n,) of the labels of scans with a truth, and whether these are right."""

    single: FloatArray
    single_right: NDArray[np.bool_]
    filtered: FloatArray
    filtered_right: NDArray[np.bool_]

    @classmethod
    def of(cls, labels: Sequence[Label], truth: IntArray) -> Told:
        """Labels held against the truth; scans without one, of -1, are left out."""
        known = np.asarray(truth) >= 0
        asked = [label for label, is_known in zip(labels, known.tolist(), strict=True) if is_known]
        true = np.asarray(truth)[known]
        return cls(
            np.array([label.probability for label in asked]),
            np.array([label.submap for label in asked]) == true,
            np.array([label.filtered_probability for label in asked]),
            np.array([label.filtered_submap for label in asked]) == true,
        )


def of_held_out(built: Built) -> Told:
    """The labels of the scans that were held out of a map."""
    finished, held_out = built.finished, built.held_out
    truth = nearest_labels(poses_at(finished, held_out.stamps_ns), finished.laid.labels)
    return Told.of(labels_of(finished, built.store, held_out, built.config), truth)


def line(name: str, told: Told) -> str:
    """One row for reading."""
    single = reliability(told.single, told.single_right)
    filtered = reliability(told.filtered, told.filtered_right)
    return (
        f"{name:44} {len(told.single):6,} |       {told.single_right.mean():.3f}, "
        f"{single.error:.3f} |         {told.filtered_right.mean():.3f}, {filtered.error:.3f}"
    )


def diagram(told: Told) -> str:
    """The reliability of single and of filtered labels: a row a bin, # right, | as said."""
    rows = []
    for kind, found in (
        ("single", reliability(told.single, told.single_right)),
        ("filtered", reliability(told.filtered, told.filtered_right)),
    ):
        for count, probability, right in zip(
            found.labels.tolist(), found.probability.tolist(), found.right.tolist(), strict=True
        ):
            if count:
                words = f"    {kind:9} says {probability:.3f}, right {right:.3f}, {count:6,}"
                rows.append(f"{words}  {_bar(probability, right)}")
    return "\n".join(rows)


def _bar(probability: float, right: float) -> str:
    bar = ("#" * round(_WIDTH * right)).ljust(_WIDTH + 1)
    said = round(_WIDTH * probability)
    return (bar[:said] + "|" + bar[said + 1 :]).rstrip()


def reliability(probability: FloatArray, right: NDArray[np.bool_]) -> Reliability:
    """Labels (n,) in bins of equal width; one of probability 1 is in the last."""
    number = np.minimum((probability * BINS).astype(np.int64), BINS - 1)
    count = np.bincount(number, minlength=BINS)
    some = np.maximum(count, 1)
    return Reliability(
        count,
        np.bincount(number, probability, BINS) / some,
        np.bincount(number, right.astype(np.float64), BINS) / some,
    )
