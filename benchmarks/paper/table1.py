"""Table I: what each group of features is worth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import count

import numpy as np

from benchmarks.paper.blocks import Block, Row, Table, Words, figure
from benchmarks.paper.cases import FREIBURG, STATA, Case
from benchmarks.paper.samples import Samples, fitted, samples_of, scored, the_papers
from benchmarks.paper.workshop import OURS, Workshop
from specmap_cli.core.config import load_config
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.settings import RecognitionConfig
from specmap_cli.evaluation.protocols import HoldOut
from specmap_cli.recognition.features import point_pairs, profile, shape, table1
from specmap_cli.recognition.learning.boosting import StumpBoost
from specmap_cli.recognition.learning.looks import feature_shares
from specmap_cli.recognition.learning.one_vs_all import OneVsAll

ROUNDS = 100  # of classifiers learned without a group: all of them together take a minute
_GROUPS = (
    "mean and deviation of the difference of consecutive readings",
    "number of gaps",
    "mean, deviation, skew and kurtosis of the readings",
    "longest less shortest reading, and the angle between them",
    "area, perimeter, and the convexity of both",
    "circularity, compactness",
    "seven moment invariants",
    "number of readings at maximum range",
    "ratio of the eigenvalues (aspect)",
    "mean distance to the centroid",
    "sign flips of the second derivative",
    "distribution of distances between two points",
)

Columns = Mapping[str, Sequence[int]]


@dataclass(frozen=True, slots=True)
class Worth:
    """Of a group: its share of weak classifiers, of votes, and the recall without it."""

    chosen: float
    votes: float
    without: float


def make(workshop: Workshop) -> list[Block]:
    """The paper's twelve groups by its own classifiers; our families of features by ours."""
    shown = [cases[0] for manner in (FREIBURG, STATA) if (cases := workshop.of_manner(manner))]
    ours = load_config().recognition
    papers = _columns(dict(zip(_GROUPS, ([g] for g in table1.GROUPS), strict=True)))
    families = _columns(
        {
            "Table I, all twelve groups": table1.GROUPS,
            "finer distances, pieces of the outline, cut ranges": shape.GROUPS,
            "pairs of wall points by distance and angle": point_pairs.GROUPS,
            "quantiles, rings and harmonics of the ranges": profile.GROUPS,
        }
    )
    return [
        _table(shown, workshop, papers, the_papers(ROUNDS), numbered=True),
        _table(shown, workshop, families, ours, numbered=False),
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


def _table(
    cases: Sequence[Case],
    workshop: Workshop,
    columns: Columns,
    config: RecognitionConfig,
    *,
    numbered: bool,
) -> Table:
    found = {case.name: _worths(case, workshop, columns, config) for case in cases}
    heads = [f"{name}: {what}" for name in found for what in ("chosen", "votes", "without")]
    rows = []
    for number, group in enumerate(columns, start=1):
        cells = [
            text for recall, worths in found.values() for text in _cells(worths[group], recall)
        ]
        rows.append(Row((f"{number}. {group}" if numbered else group, *cells)))
    recalls = [text for recall, _ in found.values() for text in ("", "", figure(recall))]
    rows.append(Row(("recall with all of them", *recalls)))
    kind = "stumps, as in the paper" if config.booster == "stumps" else "trees of two levels"
    return Table(("features", *heads), rows, f"Classifiers: {kind}.")


def _cells(worth: Worth, recall: float) -> tuple[str, str, str]:
    shares = (f"{100.0 * share:.1f} %" for share in (worth.chosen, worth.votes))
    return (*shares, f"{worth.without - recall:+.3f}".replace("-", "−"))  # type: ignore[return-value]


def _worths(
    case: Case, workshop: Workshop, columns: Columns, config: RecognitionConfig
) -> tuple[float, dict[str, Worth]]:
    """The recall of held-out scans, and what each group is worth."""
    train, test = samples_of(workshop.built(case, OURS, HoldOut(seed=0)), config.feature_set)
    whole = fitted(train, config)
    chosen, votes = _chosen(whole, train.X.shape[1]), _votes(whole)
    return scored(whole, test).recall, {
        name: Worth(
            float(chosen[list(own)].sum()),
            float(votes[list(own)].sum()),
            _recall_without(own, train, test, config),
        )
        for name, own in columns.items()
    }


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
