"""Are the probabilities of labels what they say?

    OMP_NUM_THREADS=1 python -m benchmarks.calibration [--only NAME ...] [--bins]

On held-out scans of the recordings of benchmarks.paper, one by one and in blocks of 100, and on
another way through the simulated buildings. Of 100 labels with a probability of 0.8, 80 should be
right: the expected calibration error is the mean difference between probability and share of right
labels, over ten bins, weighted by the labels in each (Guo et al., ICML 2017). `single` are single
scans: the softmax of margins times `localization.sharpness`; beside it stands the error with the
sharpness that fits these very scans best, which no calibration by one factor can be better than.
`filtered` are the probabilities that `specmap localize` writes. `--bins` prints the bins.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.paper.cases import Case, cases
from benchmarks.paper.figure6 import ask
from benchmarks.paper.workshop import OURS, Built, Workshop
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import IntArray
from specmap_cli.evaluation.protocols import HoldOut, labels_of, nearest_labels, poses_at
from specmap_cli.recognition.features.sets import scans_features
from specmap_cli.recognition.localization.localizer import Label

BINS = 10
_SHARPNESS = tuple(0.01 * 1.25**k for k in range(24))  # 0.01 to 1.7


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
    """Labels of some scans with a truth: the margins (n, m), the column (n,) that is right.

    `filtered` (n,) are the probabilities of the filtered labels, `right` (n,) whether these are.
    """

    margins: FloatArray
    column: IntArray
    filtered: FloatArray
    right: NDArray[np.bool_]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--only", nargs="+", default=[""], help="recordings whose name holds this")
    parser.add_argument("--bins", action="store_true", help="print the reliability of every bin")
    arguments = parser.parse_args()
    print(f"{'recording':34} {'scans':>6} | single: right  error | best fit, error | filtered")
    with (
        tempfile.TemporaryDirectory(prefix="specmap-") as folder,
        Workshop(cases(Path(folder))) as workshop,
    ):
        for case in workshop.cases.found:
            if any(name in case.name for name in arguments.only):
                for name, told, sharpness in told_of(case, workshop):
                    print(line(name, told, sharpness), flush=True)
                    if arguments.bins:
                        print(bins(told, sharpness))


def told_of(case: Case, workshop: Workshop) -> Iterator[tuple[str, Told, float]]:
    """What is told of held-out scans of a recording, and of another way; with the sharpness."""
    for name, held_out in (("single", HoldOut(seed=0)), ("blocks", HoldOut("blocks", seed=0))):
        built = workshop.built(case, OURS, held_out)
        if len(built.held_out):
            yield f"{case.name}, {name}", of_held_out(built), built.config.localization.sharpness
    if case.again is not None:
        built = workshop.built(case, OURS)
        told = of_another_way(built, case, case.again, workshop)
        yield f"{case.name}, another way", told, built.config.localization.sharpness


def of_held_out(built: Built) -> Told:
    """The labels of the scans that were held out of a map."""
    finished, held_out = built.finished, built.held_out
    keyframes = finished.labels.poses, finished.labels.submaps
    truth = nearest_labels(poses_at(finished, held_out.stamps_ns), *keyframes)
    scans = (held_out.scan(k) for k in range(len(held_out)))
    return _told(built, scans, truth, labels_of(finished, held_out, built.config))


def of_another_way(built: Built, case: Case, again: Case, workshop: Workshop) -> Told:
    """The labels of another way through the building."""
    asked = ask(built, case, again, workshop)
    scans = (scan.planar for scan in workshop.recording(again).scans)
    return _told(built, scans, asked.result.truth, asked.labels)


def _told(built: Built, scans: Any, truth: IntArray, labels: list[Label]) -> Told:
    raw = built.finished.classifiers.raw
    margins = raw.margins(scans_features(scans, raw.feature_set))
    column = {submap: k for k, submap in enumerate(raw.ids)}
    known = np.isin(truth, raw.ids)
    filtered = np.array([label.filtered_probability for label in labels])
    right = np.array([label.filtered_submap for label in labels]) == truth
    columns = np.array([column[i] for i in truth[known].tolist()], dtype=np.int64)
    return Told(margins[known], columns, filtered[known], right[known])


def line(name: str, told: Told, sharpness: float) -> str:
    """One row for reading."""
    probability, right = singles(told, sharpness)
    best = best_sharpness(told)
    return (
        f"{name:34} {len(told.column):6,} |       {right.mean():.3f}  "
        f"{reliability(probability, right).error:.3f} |   {best:5.3f}, "
        f"{reliability(*singles(told, best)).error:.3f}  | {told.right.mean():.3f}  "
        f"{reliability(told.filtered, told.right).error:.3f}"
    )


def bins(told: Told, sharpness: float) -> str:
    """The reliability of single and of filtered labels, a row a bin."""
    rows = []
    for kind, found in (
        ("single", reliability(*singles(told, sharpness))),
        ("filtered", reliability(told.filtered, told.right)),
    ):
        for count, probability, right in zip(
            found.labels.tolist(), found.probability.tolist(), found.right.tolist(), strict=True
        ):
            if count:
                rows.append(f"    {kind:9} says {probability:.3f}, right {right:.3f}, {count:6,}")
    return "\n".join(rows)


def singles(told: Told, sharpness: float) -> tuple[FloatArray, NDArray[np.bool_]]:
    """(n,) probability of the submap that the most votes go to, and whether it is right."""
    probabilities = softmax(sharpness * told.margins)
    winner = probabilities.argmax(axis=1)
    return probabilities[np.arange(len(winner)), winner], winner == told.column


def best_sharpness(told: Told) -> float:
    """The factor of the margins by which the truth is likeliest."""
    rows = np.arange(len(told.column))
    worth = [
        float(np.log(np.maximum(softmax(s * told.margins)[rows, told.column], 1e-300)).mean())
        for s in _SHARPNESS
    ]
    return _SHARPNESS[int(np.argmax(worth))]


def softmax(margins: FloatArray) -> FloatArray:
    """(n, m) probabilities, each row's sum one."""
    raised = np.exp(margins - margins.max(axis=1, keepdims=True))
    return np.asarray(raised / raised.sum(axis=1, keepdims=True))


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


if __name__ == "__main__":
    main()
