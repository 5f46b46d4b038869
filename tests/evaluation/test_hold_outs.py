"""The rows that the benchmark of Table II prints: of one draw, and of several."""

from __future__ import annotations

import numpy as np

from benchmarks.hold_outs import mean_of, one_draw
from specmap_cli.evaluation.classification import classification_scores
from specmap_cli.evaluation.protocols import HoldOutResult


def drawn(wrong: int) -> HoldOutResult:
    """Ten scans of either submap, the first of which are told wrong in the test."""
    truth = np.repeat([0, 3], 10)
    said = truth.copy()
    said[:wrong] = 3
    perfect, tested = (classification_scores(truth, labels, [0, 3]) for labels in (truth, said))
    return HoldOutResult(train=perfect, test=tested, filtered=perfect)


def test_a_draw_is_a_row() -> None:
    row = "1.000 1.000 | 0.900 0.917 | 1.000 (2 submaps, 20 scans)"
    assert one_draw(drawn(2)) == row


def test_several_draws_are_their_mean_and_what_one_is_off() -> None:
    told = mean_of([drawn(0), drawn(2), drawn(4)])
    training, tested, filtered = told.split(" | ")
    assert training == "1.000 1.000"
    assert tested.startswith("0.900 (one draw +- 0.100) 0.9")
    assert filtered == "1.000 (one draw +- 0.000)"
