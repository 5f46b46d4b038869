"""Figure 6: the scans of another way through the building, labelled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.paper import pictures
from benchmarks.paper.blocks import (
    Block,
    Found,
    Gallery,
    Picture,
    Row,
    Table,
    figure,
    gallery,
)
from benchmarks.paper.cases import Case
from benchmarks.paper.samples import Samples, fitted, of_keyframes, scored, the_papers
from benchmarks.paper.workshop import OURS, PAPER, PRESETS, WORDS, Built, Workshop
from benchmarks.real.closure_truth import true_poses
from specmap_cli.core.geometry import FloatArray, Pose2, compose, nearest_motion
from specmap_cli.core.records import NO_SUBMAP, IntArray
from specmap_cli.drawing.overview import render_labels
from specmap_cli.evaluation.protocols import (
    ClassificationScores,
    RevisitResult,
    localizer_over,
    revisit,
)
from specmap_cli.evaluation.trajectories import associate
from specmap_cli.maps.text_files import read_tum
from specmap_cli.recognition.features.sets import scans_features
from specmap_cli.recognition.localization.localizer import Label

_HEAD = ("tour", "choices", "labels", "submaps", "recall", "precision", "right")


_WHY = (
    "On another way the laser sees the rooms from elsewhere. specmap also learns from views of "
    "the full circle, cast from everywhere in its grids, and a hidden Markov model over the "
    "topology, which the paper names as future work, takes care that labels do not jump."
)


@dataclass(frozen=True, slots=True)
class Asked:
    """The labels of another way, and their scores; `places` (n, 2) are true ones in the map."""

    labels: list[Label]
    result: RevisitResult
    places: FloatArray


@dataclass(frozen=True, slots=True)
class Toured:
    """A building with a second way through it: its rows of the table, its pictures.

    The rows are single scans and filtered labels of the paper's choices, the same of ours, and the
    paper's classifiers asked for our submaps.
    """

    rows: tuple[Row, Row, Row, Row, Row]
    pictures: Gallery

    def told(self) -> str:
        """The shares of scans that are labelled right."""
        papers, _, _, ours, classifiers = (row.cells for row in self.rows)
        return (
            f"{papers[0]}: right are {papers[6]} of the scans with the paper's choices "
            f"({papers[3]} submaps), {classifiers[6]} with its classifiers on specmap's submaps "
            f"({classifiers[3]}), {ours[6]} with specmap's filter."
        )


def make(workshop: Workshop) -> list[Block]:
    """Every building with a second way through it, with both presets."""
    tours = [
        _toured(case, case.again, workshop)
        for case in workshop.cases.found
        if case.again is not None
    ]
    rows = [row for tour in tours for row in tour.rows]
    caption = (
        "The robot drives through the building again, another way. Its line has the colour of the "
        "submap that was told, and a red rim where that is wrong. The truth of a scan is the "
        "submap of the map's keyframe nearest to where it was taken, by true poses. The paper "
        "shows its Figure 6 without figures. With few submaps, one of them large, most scans are "
        "right by themselves: look at their number; the last row of each tour asks the paper's "
        "classifiers for specmap's submaps."
    )
    return [
        Found("\n".join(tour.told() for tour in tours), _WHY),
        *(tour.pictures for tour in tours),
        Table(_HEAD, rows, caption),
    ]


def _toured(case: Case, again: Case, workshop: Workshop) -> Toured:
    built = {preset: workshop.built(case, preset) for preset in PRESETS}
    asked = {preset: ask(built[preset], case, again, workshop) for preset in PRESETS}
    papers, ours = asked[PAPER].result, asked[OURS].result
    alone = _classifiers_alone(case, again, asked[OURS], workshop)
    rows = (
        _row(case, PAPER, "single scans", papers.raw),
        _row(case, PAPER, "filtered", papers.filtered),
        _row(case, OURS, "single scans", ours.raw),
        _row(case, OURS, "filtered", ours.filtered),
        _row(case, OURS, "single scans, the paper's classifiers", alone),
    )
    shown = [_picture(case, preset, built[preset], asked[preset]) for preset in PRESETS]
    return Toured(rows, gallery(shown))


def ask(built: Built, case: Case, again: Case, workshop: Workshop) -> Asked:
    """Label the scans of another way by the map of the first, and score them by true poses."""
    finished = built.finished
    reference = read_tum(again.ready().truth)
    localizer = localizer_over(finished, built.store, built.config)
    labels = [localizer.add(scan).label for scan in workshop.recording(again).scans]
    given = true_poses(case.truth, built.store, of_laser=False)
    known = np.isfinite(given[:, 0])
    moved: Pose2 = nearest_motion(given[known, :2], finished.laid.labels.poses[known, :2])
    stamps = np.array([label.stamp_ns for label in labels])
    joined, rows = associate(reference.stamps_ns, stamps, 5_000_000)
    places = np.full((len(labels), 3), np.nan)
    places[joined] = compose(np.array(moved), reference.poses[rows])
    return Asked(labels, revisit(labels, reference, finished.laid.labels, moved), places)


def _classifiers_alone(
    case: Case, again: Case, asked: Asked, workshop: Workshop
) -> ClassificationScores:
    """The paper's classifiers asked for our own submaps, whose truth is that of `asked`."""
    config = the_papers()
    train = of_keyframes(workshop.built(case, OURS), config.feature_set)
    scans = (scan.planar for scan in workshop.recording(again).scans)
    test = Samples(scans_features(scans, config.feature_set), asked.result.truth)
    return scored(fitted(train, config), test)


def _picture(case: Case, preset: str, built: Built, asked: Asked) -> Picture:
    """The raw labels of the paper, the filtered ones of ours."""
    told = [x.filtered_submap if preset == OURS else x.submap for x in asked.labels]
    submaps: IntArray = np.array([NO_SUBMAP if x is None else x for x in told], dtype=np.int64)
    kind = "filtered labels" if preset == OURS else "labels of single scans"
    finished = built.finished
    image = render_labels(
        asked.places,
        submaps,
        f"{case.name}: {WORDS[preset]}, {kind}",
        map_with_regions=(finished.topology, finished.laid.regions),
        truth=asked.result.truth,
    )
    return Picture(pictures.shrunk(image), f"{case.name}: {WORDS[preset]}, {kind}")


def _row(case: Case, preset: str, kind: str, scores: ClassificationScores) -> Row:
    figures = map(figure, (scores.recall, scores.precision, scores.accuracy))
    return Row((case.name, WORDS[preset], kind, str(len(scores.ids)), *figures))
