"""Reliability of probabilities: labels that keep their word, and labels that do not."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.calibration import Told, best_sharpness, line, reliability, singles, softmax


def test_labels_that_keep_their_word_have_no_error() -> None:
    probability = np.repeat([0.65, 0.95], [20, 20])
    right = np.concatenate([np.arange(20) < 13, np.arange(20) < 19])
    found = reliability(probability, right)
    assert found.error == pytest.approx(0.0, abs=1e-12)
    assert found.labels.tolist() == [0, 0, 0, 0, 0, 0, 20, 0, 0, 20]


def test_the_error_is_weighted_by_the_labels_of_a_bin() -> None:
    probability = np.array([1.0, 1.0, 1.0, 0.5])
    right = np.array([True, True, False, True])
    assert reliability(probability, right).error == pytest.approx((3 * (1 / 3) + 0.5) / 4)
    assert reliability(np.zeros(0), np.zeros(0, dtype=bool)).error == 0.0


def test_the_best_sharpness_is_the_one_the_labels_were_drawn_with() -> None:
    rng = np.random.default_rng(3)
    margins = rng.normal(0.0, 10.0, (4000, 3))
    chance = softmax(0.2 * margins)
    column = (rng.random(4000)[:, None] > chance.cumsum(axis=1)).sum(axis=1)
    told = Told(margins, column, np.ones(4000), np.ones(4000, dtype=bool))
    best = best_sharpness(told)
    assert best == pytest.approx(0.2, rel=0.25)
    errors = [reliability(*singles(told, s)).error for s in (0.02, best, 2.0)]
    assert errors[1] < min(errors[0], errors[2])
    assert "4,000" in line("a recording", told, best)
