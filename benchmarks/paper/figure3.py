"""Figure 3: eigenvalues while the robot moves, and where they split its way."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from benchmarks.closure_truth import true_poses
from benchmarks.online import Tour, score
from benchmarks.paper import pictures
from benchmarks.paper.blocks import Block, Chart, Gallery, Picture, Row, Series, Table, figure
from benchmarks.paper.cases import FREIBURG, Case
from benchmarks.paper.workshop import OURS, PAPER, PRESETS, WORDS, Built, Workshop
from specmap_cli.drawing.split_tests import draw_test
from specmap_cli.segmentation.online import Occasion, OnlineSegmenter
from specmap_cli.segmentation.splitting import SplitTest

_SHOWN = 6  # tests up to the first split
_SECONDS = 180.0  # of the chart

Shown = tuple[SplitTest, bool, Occasion]


def make(workshop: Workshop) -> list[Block]:
    """The tests up to the first split, the eigenvalues of the first minutes, and all tours."""
    drawn = [case for case in workshop.cases.found if case.drawing is not None]
    first = [case for case in drawn if case.manner == FREIBURG][-1]  # the sample office
    blocks: list[Block] = []
    for preset in PRESETS:
        built = workshop.built(first, preset)
        threshold = built.config.segmentation.split_eigenvalue
        blocks.append(Gallery(_pictures(built, preset, threshold), across=3))
    blocks.append(_chart(first, workshop))
    rows = [_row(case, preset, workshop) for case in drawn for preset in PRESETS]
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


def _row(case: Case, preset: str, workshop: Workshop) -> Row:
    assert case.drawing is not None
    built = workshop.built(case, preset)
    truth = true_poses(case.truth, built.store, of_laser=False)
    tour = Tour(built.store, truth, sorted(built.explored.breaks))
    found = score(case.name, "", tour, case.drawing.rooms, built.config)
    return Row(
        (
            case.name,
            WORDS[preset],
            figure(found.homogeneity),
            figure(found.completeness),
            figure(found.segments_per_visit, 2),
            str(found.tests),
        )
    )
