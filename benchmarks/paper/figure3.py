"""Figure 3: eigenvalues while the robot moves, and where they split its way."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from benchmarks.paper import pictures
from benchmarks.paper.blocks import (
    Block,
    Chart,
    Found,
    Gallery,
    Picture,
    Row,
    Series,
    Table,
    figure,
)
from benchmarks.paper.cases import FREIBURG, STATA, Case, Drawing
from benchmarks.paper.workshop import OURS, PAPER, PRESETS, WORDS, Built, Workshop, beside
from benchmarks.real.closure_truth import true_poses
from benchmarks.scores import VisitScores
from benchmarks.simulated.online import Tour, scored
from specmap_cli.drawing.split_tests import draw_test
from specmap_cli.segmentation.online import Occasion, OnlineSegmenter, SplitTest

_SHOWN = 6  # tests up to the first split
_SECONDS = 180.0  # of the chart

Shown = tuple[SplitTest, bool, Occasion]


def make(workshop: Workshop) -> list[Block]:
    """The tests up to the first split, the eigenvalues of the first minutes, and all tours."""
    first, _ = workshop.drawn(FREIBURG)[-1]  # the sample office
    tours = [drawn for manner in (FREIBURG, STATA) for drawn in workshop.drawn(manner)]
    scores = {
        preset: [_score(case, drawing, preset, workshop) for case, drawing in tours]
        for preset in PRESETS
    }
    blocks: list[Block] = [_found(scores)]
    for preset in PRESETS:
        built = workshop.built(first, preset)
        threshold = built.config.segmentation.split_eigenvalue
        blocks.append(Gallery(_pictures(built, preset, threshold), across=3))
    blocks.append(_chart(first, workshop))
    rows = [_row(preset, scores[preset][k]) for k in range(len(tours)) for preset in PRESETS]
    head = ("tour", "choices", "homogeneity", "completeness", "segments per visit", "tests")
    caption = (
        "Homogeneity is 1 when no submap lies in two rooms, completeness when no visit of a room "
        "is cut in two; poses by scan matching."
    )
    return [*blocks, Table(head, rows, caption)]


def _pictures(built: Built, preset: str, threshold: float) -> list[Picture]:
    return [
        Picture(
            pictures.shrunk(draw_test(test, threshold, split, occasion), 480),
            f"{WORDS[preset]}: eigenvalue {figure(test.eigenvalue)}{', split' if split else ''}",
        )
        for test, split, occasion in _up_to_the_first_split(built)
    ]


def _up_to_the_first_split(built: Built) -> Sequence[Shown]:
    """The last tests of the first submap, the one that split it the last of them."""
    last: deque[Shown] = deque(maxlen=_SHOWN)
    config = built.config
    segmenter = OnlineSegmenter(
        config.segmentation, config.grid, built.store, lambda *test: last.append(test)
    )
    for keyframe in range(len(built.store)):
        segmenter.add(keyframe)
        if last and last[-1][1]:
            break
    return list(last)


def _chart(case: Case, workshop: Workshop) -> Chart:
    series = []
    for preset, name in ((PAPER, "second eigenvalue"), (OURS, "first that divides the way")):
        built = workshop.built(case, preset)
        tests = [test for test in built.tests if test.occasion.seconds <= _SECONDS]
        series.append(
            Series(
                f"{WORDS[preset]}: {name}",
                [(test.occasion.seconds, test.eigenvalue) for test in tests],
                frozenset(k for k, test in enumerate(tests) if test.split),
                built.config.segmentation.split_eigenvalue,
            )
        )
    caption = (
        f"{case.name}, the first three minutes. Full dots are tests that split the submap; the "
        "dashed lines are the thresholds (0.8 is the paper's)."
    )
    return Chart(series, "seconds", "eigenvalue", caption, top=1.0)


class Score(NamedTuple):
    """How a tour was split while the robot moved, in so many tests."""

    plan: str
    scores: VisitScores
    tests: int


def _score(case: Case, drawing: Drawing, preset: str, workshop: Workshop) -> Score:
    built = workshop.built(case, preset)
    truth = true_poses(case.truth, built.store, of_laser=False)
    tour = Tour(built.store, truth, sorted(built.explored.breaks))
    found, durations = scored(tour, drawing.rooms, built.config)
    return Score(case.name, found, len(durations))


def _row(preset: str, found: Score) -> Row:
    figures = figure(found.scores.homogeneity), figure(found.scores.completeness)
    visits = figure(found.scores.segments_per_visit, 2)
    return Row((found.plan, WORDS[preset], *figures, visits, str(found.tests)))


def _found(scores: Mapping[str, Sequence[Score]]) -> Found:
    means = {
        preset: (
            f"{float(np.mean([each.scores.homogeneity for each in found])):.3f} and "
            f"{float(np.mean([each.scores.completeness for each in found])):.3f}"
        )
        for preset, found in scores.items()
    }
    return Found(
        f"Mean homogeneity and completeness of {len(scores[PAPER])} simulated tours. "
        + beside(means),
        "A look through a door shows a piece of the next room, a cluster with weak links: the "
        "second eigenvalue is high before the robot goes in. specmap takes the first eigenvector "
        "that divides the robot's own way, on nodes near the way. It splits more often; what is "
        "cut too often is put right when the whole map is divided at the end.",
    )
