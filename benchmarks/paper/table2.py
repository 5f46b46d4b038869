"""Table II: recall and precision of single scans, of the map's own and of held-out ones."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain

from benchmarks.paper.blocks import Block, Found, Row, Table, figure
from benchmarks.paper.cases import FREIBURG, STATA, Case
from benchmarks.paper.samples import fitted, samples_of, scored, the_papers
from benchmarks.paper.workshop import OURS, PAPER, WORDS, Workshop
from specmap_cli.evaluation.protocols import ClassificationScores, HoldOut

_HEAD = (
    "recording",
    "choices",
    "submaps",
    "training recall",
    "training precision",
    "test recall",
    "test precision",
    "filtered, right",
)
_ALONE, _BLOCKS = HoldOut(seed=0), HoldOut("blocks", seed=0)
# Recall and precision of training and of test scans.
PUBLISHED = {
    FREIBURG: (0.9728, 0.9818, 0.9089, 0.9212),
    STATA: (0.9689, 0.9739, 0.83, 0.8458),
}


_WHY = (
    "With the paper's choices throughout, wrong merges leave one large submap and a few tiny ones, "
    "over which a mean says little: the second row of each recording asks the paper's classifiers "
    "for the submaps of the third. What specmap's add are features of the outline and of pairs of "
    "wall points, and trees, which can say “and”."
)


def make(workshop: Workshop) -> list[Block]:
    """The published figures of each building, and ours on every recording in its manner."""
    rows, told = [], []
    for manner, published in PUBLISHED.items():
        figures = tuple(f"{value:.4f}" for value in published)
        rows.append(Row((f"{manner} (published)", "the paper", "–", *figures, "–"), published=True))
        ours = [_rows(case, workshop) for case in workshop.of_manner(manner)]
        rows += chain.from_iterable(ours)
        told += [_told(manner, figures[2], ours[0])] if ours else []
    caption = (
        "A fifth of the keyframes is held out, one by one; the last row of each recording holds "
        "out blocks of 100 in a row, so that the test is no interpolation. Macro averages over the "
        "submaps, as in the paper: each counts the same, however small. Filtered: the share of "
        "held-out scans that the hidden Markov model labels right."
    )
    return [Found("\n".join(told), _WHY), Table(_HEAD, rows, caption)]


def _told(manner: str, published: str, rows: Sequence[Row]) -> str:
    """The test recalls of a recording with the paper's choices, its classifiers, and ours."""
    figures = "; ".join(
        f"{row.cells[1]} {row.cells[5]} ({row.cells[2]} submaps)" for row in rows[:3]
    )
    return f"{manner}: test recall {published} in the paper; {rows[0].cells[0]}: {figures}."


def _rows(case: Case, workshop: Workshop) -> list[Row]:
    rows = []
    for preset, held_out, words in (
        (PAPER, _ALONE, f"{WORDS[PAPER]} throughout"),
        (OURS, _ALONE, WORDS[OURS]),
        (OURS, _BLOCKS, f"{WORDS[OURS]}, blocks of 100"),
    ):
        built = workshop.built(case, preset, held_out)
        if not len(built.held_out):
            continue  # the recording is shorter than a block
        found = built.scores()
        filtered = figure(found.filtered.accuracy)
        rows.append(_row(case, words, found.train, found.test, filtered))
    return [rows[0], _classifiers_alone(case, workshop), *rows[1:]]


def _classifiers_alone(case: Case, workshop: Workshop) -> Row:
    """The paper's classifiers on the submaps that our own are asked for."""
    train, test = samples_of(workshop.built(case, OURS, _ALONE), the_papers().feature_set)
    classifiers = fitted(train, the_papers())
    words = "the paper's classifiers, specmap's submaps"
    return _row(case, words, scored(classifiers, train), scored(classifiers, test), "–")


def _row(
    case: Case, words: str, train: ClassificationScores, test: ClassificationScores, filtered: str
) -> Row:
    figures = [train.recall, train.precision, test.recall, test.precision]
    return Row((case.name, words, str(len(test.ids)), *map(figure, figures), filtered))
