"""Reliability of probabilities: labels that keep their word, and labels that do not."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.real.reliability import Told, diagram, line, reliability
from specmap_cli.core.records import IntArray
from specmap_cli.recognition.localization.localizer import Label


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


def test_labels_without_a_truth_are_left_out() -> None:
    truth: IntArray = np.array([3, -1, 5, 5])
    told = Told.of([label(3, 3), label(1, 1), label(5, None), label(2, 5)], truth)
    assert told.single_right.tolist() == [True, True, False]
    assert told.filtered_right.tolist() == [True, False, True]
    assert "     3 |       0.667, 0.133 |         0.667, 0.267" in line("a recording", told)


def test_the_diagram_draws_what_is_right_beside_what_is_said() -> None:
    told = Told(*(2 * (np.array([0.5, 0.5]), np.array([True, False]))))
    rows = diagram(told).splitlines()
    assert len(rows) == 2
    assert rows[0].endswith("says 0.500, right 0.500,      2  " + 20 * "#" + "|")
    sure = Told(*(2 * (np.array([0.99, 0.99]), np.array([True, False]))))
    assert diagram(sure).splitlines()[1].endswith("  " + 20 * "#" + 20 * " " + "|")


def label(submap: int | None, filtered: int | None) -> Label:
    of = {"stamp_ns": 0, "margin": 1.0, "filtered_probability": 0.4, "probability": 0.8}
    return Label(submap=submap, runner_up=None, filtered_submap=filtered, **of)  # type: ignore[arg-type]
