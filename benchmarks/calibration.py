"""Are the probabilities of labels what they say?

    OMP_NUM_THREADS=1 python -m benchmarks.calibration [--only NAME ...] [--plans] [--bins]

On held-out scans of the recordings of benchmarks.paper, one by one and in blocks of 100 (several
choices of them, as a block is one room or two: `--seeds`), and on another way through the simulated
buildings. `--plans` adds tours of furnished plans with lasers of 180 and 360 degrees, whose
submaps are the rooms, and another way through each. Of 100 labels with a probability of 0.8, 80
should be right: the expected calibration error is the mean difference between probability and
share of right labels, over ten bins, weighted by the labels in each (Guo et al., ICML 2017).
`single` are labels of single scans, `filtered` those of all scans so far, with the probabilities
that `specmap localize` writes. `--bins` prints the reliability diagram.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.data import plan, rooms_of
from benchmarks.paper.cases import Case, cases
from benchmarks.paper.figure6 import ask
from benchmarks.paper.workshop import OURS, Built, Workshop
from benchmarks.recognition import localizer_of_tour, tour_of
from specmap_cli.core.config import load_config
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import IntArray
from specmap_cli.evaluation.protocols import HoldOut, labels_of, nearest_labels, poses_at
from specmap_cli.recognition.localization.localizer import Label

BINS = 10
# The plans that no constant of the calibration was fitted on stand last.
PLANS = (
    ("Freiburg79_scan_furnitures", 180.0),
    ("lab_c_scan_furnitures", 180.0),
    ("Freiburg52_scan_furnitures", 180.0),
    ("lab_intel", 180.0),
    ("office_e_furnitures", 360.0),
)
_LONGEST_S = 900.0
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

    @classmethod
    def joined(cls, parts: Sequence[Told]) -> Told:
        """What was told of several logs."""
        return cls(
            np.concatenate([part.single for part in parts]),
            np.concatenate([part.single_right for part in parts]),
            np.concatenate([part.filtered for part in parts]),
            np.concatenate([part.filtered_right for part in parts]),
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--only", nargs="+", default=[""], help="recordings whose name holds this")
    parser.add_argument("--seeds", type=int, default=1, help="choices of held-out scans")
    parser.add_argument("--plans", action="store_true", help="tours of furnished plans, too")
    parser.add_argument("--bins", action="store_true", help="print the reliability diagrams")
    arguments = parser.parse_args()
    print(f"{'labels of':44} {'scans':>6} | single: right, error | filtered: right, error")

    def show(name: str, told: Told) -> None:
        print(line(name, told), flush=True)
        if arguments.bins:
            print(diagram(told))

    with (
        tempfile.TemporaryDirectory(prefix="specmap-") as folder,
        Workshop(cases(Path(folder))) as workshop,
    ):
        for case in workshop.cases.found:
            if any(name in case.name for name in arguments.only):
                for name, told in told_of(case, workshop, range(arguments.seeds)):
                    show(name, told)
    if arguments.plans:
        for name, view in PLANS:
            show(f"{name}, {view:.0f} degrees", of_plan(name, view))


def told_of(case: Case, workshop: Workshop, seeds: Sequence[int]) -> Iterator[tuple[str, Told]]:
    """What is told of held-out scans of a recording, and of another way."""
    for split in ("random", "blocks"):
        built = [workshop.built(case, OURS, HoldOut(split, seed=seed)) for seed in seeds]
        told = [of_held_out(each) for each in built if len(each.held_out)]
        if told:
            yield f"{case.name}, {split}", Told.joined(told)
    if case.again is not None:
        asked = ask(workshop.built(case, OURS), case, case.again, workshop)
        yield f"{case.name}, another way", Told.of(asked.labels, asked.result.truth)


def of_held_out(built: Built) -> Told:
    """The labels of the scans that were held out of a map."""
    finished, held_out = built.finished, built.held_out
    keyframes = finished.labels.poses, finished.labels.submaps
    truth = nearest_labels(poses_at(finished, held_out.stamps_ns), *keyframes)
    return Told.of(labels_of(finished, held_out, built.config), truth)


def of_plan(name: str, view: float) -> Told:
    """The labels of another way through a plan, whose submaps are its rooms."""
    world, rooms = plan(name), rooms_of(name.removesuffix("_furnitures"))
    first, again = (
        tour_of(world, view, seed, max_duration_s=_LONGEST_S, spacing_m=spacing_m)
        for seed, spacing_m in ((1, 3.0), (11, 2.6))
    )
    localizer = localizer_of_tour(first, rooms, load_config())()
    labels = [localizer.update(scan) for scan in again]
    truth = rooms.at(np.array([scan.map_from_base for scan in again]))
    return Told.of(labels, np.where(np.isin(truth, localizer.classifiers.ids), truth, -1))


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


if __name__ == "__main__":
    main()
