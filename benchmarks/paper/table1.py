"""Table I: what each group of features is worth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, count

import numpy as np

from benchmarks.paper.blocks import Block, Found, Row, Table, Words, figure
from benchmarks.paper.cases import FREIBURG, STATA, Case
from benchmarks.paper.samples import Samples, fitted, samples_of, scored, the_papers
from benchmarks.paper.workshop import OURS, Workshop
from specmap_cli.core.config import load_config
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.settings import RecognitionConfig
from specmap_cli.evaluation.protocols import HoldOut
from specmap_cli.recognition.features import shape, table1
from specmap_cli.recognition.learning.boosting import OneVsAll, StumpBoost, feature_shares

ROUNDS = 100  # of classifiers learned without a group: all of them together take a minute
_GROUPS = (
    "1. mean and deviation of the difference of consecutive readings",
    "2. number of gaps",
    "3. mean, deviation, skew and kurtosis of the readings",
    "4. longest less shortest reading, and the angle between them",
    "5. area, perimeter, and the convexity of both",
    "6. circularity, compactness",
    "7. seven moment invariants",
    "8. number of readings at maximum range",
    "9. ratio of the eigenvalues (aspect)",
    "10. mean distance to the centroid",
    "11. sign flips of the second derivative",
    "12. distribution of distances between two points",
)

Columns = Mapping[str, Sequence[int]]


@dataclass(frozen=True, slots=True)
class Worth:
    """Of a group: its share of weak classifiers, of votes, and the recall without it."""

    chosen: float
    votes: float
    without: float


@dataclass(frozen=True, slots=True)
class Tried:
    """The recall of held-out scans of a recording, and what each group is worth."""

    recall: float
    worths: Mapping[str, Worth]


def make(workshop: Workshop) -> list[Block]:
    """The paper's twelve groups by its own classifiers; our families of features by ours."""
    shown = [cases[0] for manner in (FREIBURG, STATA) if (cases := workshop.of_manner(manner))]
    ours = load_config().recognition
    papers = _columns({name: [group] for name, group in zip(_GROUPS, table1.GROUPS, strict=True)})
    families = _columns(
        {
            "Table I, all twelve groups": table1.GROUPS,
            "finer distances, pieces of the outline, cut ranges": shape.GROUPS,
            "pairs of wall points by distance and angle": shape.PAIR_GROUPS,
            "quantiles, rings and harmonics of the ranges": shape.PROFILE_GROUPS,
        }
    )
    by_the_paper = {c.name: _tried(c, workshop, papers, the_papers(ROUNDS)) for c in shown}
    by_ours = {case.name: _tried(case, workshop, families, ours) for case in shown}
    return [
        _found(by_the_paper, by_ours),
        _table(by_the_paper, papers, "Classifiers: stumps on Table I, as in the paper."),
        _table(by_ours, families, "Classifiers: specmap's, trees of two levels."),
        Words(
            "Submaps are specmap's own in both tables, so that only features and classifiers "
            "differ. Chosen: the share of weak classifiers that look at a column of the group (of "
            "trees, the share of their splits). Votes: the share of all votes that they decide. "
            "Without: how the recall of held-out scans changes when every classifier is learned "
            f"anew without the group. The first table's classifiers have {ROUNDS} stumps each."
        ),
    ]


def _columns(groups: Mapping[str, Sequence[object]]) -> Columns:
    """The numbers of the columns of each group, which follow each other."""
    numbers = count()
    return {
        name: [next(numbers) for group in some for _ in group.columns]  # type: ignore[attr-defined]
        for name, some in groups.items()
    }


def _found(papers: Mapping[str, Tried], ours: Mapping[str, Tried]) -> Found:
    """Which group is chosen most, and which is missed most."""
    told = []
    for name, tried in papers.items():
        chosen = max(tried.worths, key=lambda group: tried.worths[group].chosen)
        missed = min(tried.worths, key=lambda group: tried.worths[group].without)
        told.append(
            f"On {name}, stumps choose “{chosen}” most often "
            f"({100.0 * tried.worths[chosen].chosen:.0f} %), and recall falls most without "
            f"“{missed}” ({_change(tried.worths[missed].without - tried.recall)}). All twelve "
            f"groups give a recall of {tried.recall:.3f}, specmap's features and trees "
            f"{ours[name].recall:.3f}."
        )
    return Found(
        "\n".join(told),
        "A group that is missed little is not worthless: others say nearly the same, and are "
        "chosen in its place.",
    )


def _table(tried: Mapping[str, Tried], columns: Columns, caption: str) -> Table:
    heads = [f"{name}: {what}" for name in tried for what in ("chosen", "votes", "without")]
    cells = [
        [_cells(worth, each.recall) for worth in each.worths.values()] for each in tried.values()
    ]
    rows = [
        Row((group, str(len(own)), *chain.from_iterable(of_group)))
        for (group, own), of_group in zip(columns.items(), zip(*cells, strict=True), strict=True)
    ]
    recalls = [text for each in tried.values() for text in ("", "", figure(each.recall))]
    rows.append(Row(("recall with all of them", "", *recalls)))
    return Table(("features", "columns", *heads), rows, caption)


def _cells(worth: Worth, recall: float) -> tuple[str, str, str]:
    chosen, votes = (f"{100.0 * share:.1f} %" for share in (worth.chosen, worth.votes))
    return chosen, votes, _change(worth.without - recall)


def _change(value: float) -> str:
    return f"{round(value, 3) or 0.0:+.3f}".replace("-", "−")


def _tried(case: Case, workshop: Workshop, columns: Columns, config: RecognitionConfig) -> Tried:
    train, test = samples_of(workshop.built(case, OURS, HoldOut(seed=0)), config.feature_set)
    whole = fitted(train, config)
    chosen, votes = _chosen(whole, train.X.shape[1]), _votes(whole)
    worths = {
        name: Worth(
            float(chosen[list(own)].sum()),
            float(votes[list(own)].sum()),
            _recall_without(own, train, test, config),
        )
        for name, own in columns.items()
    }
    return Tried(scored(whole, test).recall, worths)


def _recall_without(
    columns: Sequence[int], train: Samples, test: Samples, config: RecognitionConfig
) -> float:
    return scored(fitted(train.without(columns), config), test).recall


def _chosen(classifiers: OneVsAll, features: int) -> FloatArray:
    """(F,) the share of weak classifiers that ask for each feature."""
    asked = np.concatenate(
        [
            [stump.feature for stump in booster.rounds_]
            if isinstance(booster, StumpBoost)
            else booster.forest_.features.reshape(-1)
            for booster in classifiers.boosters_.values()
        ]
    ).astype(np.intp)
    return np.asarray(np.bincount(asked, minlength=features) / max(1, len(asked)))


def _votes(classifiers: OneVsAll) -> FloatArray:
    """(F,) the share of votes that each feature decides, over all classifiers."""
    shares = [feature_shares(booster) for booster in classifiers.boosters_.values()]
    return np.asarray(np.mean(shares, axis=0))
