"""The hidden Markov filter against sums over all paths."""

from __future__ import annotations

from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.recognition.localization.filtering import HiddenMarkovFilter

LINE = {0: [1], 1: [0, 2], 2: [1], 5: []}


@given(st.integers(0, 10_000), st.integers(1, 4))
def test_filter_and_smoother_are_sums_over_all_paths(seed: int, steps: int) -> None:
    evidence = np.random.default_rng(seed).normal(0.0, 2.0, (steps, 5))
    model = HiddenMarkovFilter(LINE, stay=0.8)
    weights = np.zeros((steps, 5))
    ends = np.zeros(5)
    for path in product(range(5), repeat=steps):
        weight = 0.2 * np.exp(sum(evidence[t, s] for t, s in enumerate(path)))
        for a, b in pairwise(path):
            weight *= model.transition_[a, b]
        ends[path[-1]] += weight
        for t, s in enumerate(path):
            weights[t, s] += weight
    for row in evidence:
        filtered = model.update(row)
    assert filtered == pytest.approx(ends / ends.sum())
    smoothed = weights / weights.sum(axis=1, keepdims=True)
    assert model.smooth(evidence) == pytest.approx(smoothed)


def test_transitions_follow_the_topology() -> None:
    model = HiddenMarkovFilter(LINE, stay=0.9)
    transition = model.transition_
    assert transition.sum(axis=1) == pytest.approx(np.ones(5))
    assert model.ids == [0, 1, 2, 5]
    assert transition[1, 0] == pytest.approx(transition[1, 2])
    assert transition[0, 1] > 50 * transition[0, 2]
    assert (transition > 0.0).all() or (transition[:4, :4] > 0.0).all()


def test_a_stray_scan_does_not_move_the_robot() -> None:
    model = HiddenMarkovFilter(LINE)
    stay, stray = np.array([2.0, 0, 0, 0, -5.0]), np.array([0, 0, 2.0, 0, -5.0])
    for _ in range(5):
        model.update(stay)
    assert int(model.update(stray).argmax()) == 0
    for _ in range(12):
        belief = model.update(stray)
    assert int(belief.argmax()) == 2
    model.reset()
    assert int(model.update(stray).argmax()) == 2


def test_unknown_wins_when_it_explains_the_scans_better() -> None:
    model = HiddenMarkovFilter({3: []})
    assert int(model.update(np.array([1.0, 0.0])).argmax()) == 0
    for _ in range(15):
        belief = model.update(np.array([0.0, 1.0]))
    assert int(belief.argmax()) == 1


def test_impossible_evidence_for_unknown_keeps_it_out() -> None:
    model = HiddenMarkovFilter({0: [1], 1: [0]})
    belief = model.update(np.array([-3.0, -40.0, -np.inf]))
    assert belief[2] == 0.0
    assert np.isfinite(model.smooth(np.array([[0.0, 1.0, -np.inf]] * 3))).all()


def test_smoothing_leaves_the_filter_as_it_was() -> None:
    model = HiddenMarkovFilter(LINE)
    model.update(np.array([5.0, 0, 0, 0, 0]))
    model.smooth(np.array([[0.0, 0, 5.0, 0, 0]] * 4))
    assert int(model.update(np.zeros(5)).argmax()) == 0


def test_unknown_is_weighed_against_what_the_submaps_explain_together() -> None:
    model = HiddenMarkovFilter({0: [1], 1: [0]})
    known = np.array([-1.0, -9.0])
    prior = model.predicted()
    together = (prior[:2] @ np.exp(known)) / prior[:2].sum()
    assert model.with_unknown(known, 0.3)[2] == pytest.approx(np.log(together) + 0.3)
    # with no worth of its own unknown neither gains nor loses, whatever the submaps say
    belief = model.update(model.with_unknown(known, 0.0))
    assert belief[2] == pytest.approx(prior[2])
