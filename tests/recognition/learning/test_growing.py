"""Classifiers grown together: the same as each alone, whatever the batches; weights are trimmed."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.recognition.learning import trees
from specmap_cli.recognition.learning.trees import (
    CodeArray,
    Forest,
    Growth,
    Quantiser,
    Question,
    grown,
    shares,
)
from tests.strategies import few, seeds

GROWTH = Growth(rounds=12, shrinkage=0.5, feature_share=0.5, seed=3)


def world(seed: int = 0) -> tuple[CodeArray, Quantiser, list[Question]]:
    """Samples of five places, and a question of different size for each: is it this one?"""
    rng = np.random.default_rng(seed)
    owner = np.repeat(np.arange(5), [20, 35, 50, 8, 41])
    X = rng.normal(rng.normal(size=(5, 6))[owner], 0.8)
    quantiser = Quantiser.of(X)
    questions = []
    for place in range(5):
        others = rng.permutation(np.flatnonzero(owner != place))[: 30 + 10 * place]
        samples = np.concatenate([np.flatnonzero(owner == place), others])
        questions.append(Question(samples, owner[samples] == place))
    return quantiser.codes(X), quantiser, questions


def same(first: Forest, second: Forest) -> bool:
    return (
        np.array_equal(first.features, second.features)
        and np.array_equal(first.thresholds, second.thresholds)
        and np.array_equal(first.votes, second.votes)
    )


@pytest.mark.parametrize("at_once", [1, 100, 200, 1 << 15])
def test_a_classifier_is_the_same_alone_and_with_others(
    at_once: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    codes, quantiser, questions = world()
    alone = [grown(codes, quantiser, [question], GROWTH)[0] for question in questions]
    monkeypatch.setattr(trees, "_SAMPLES_AT_ONCE", at_once)
    together = grown(codes, quantiser, questions, GROWTH)
    assert all(map(same, alone, together))
    assert not same(alone[0], alone[1])


def test_batches_hold_all_questions_in_order_and_no_more_samples_than_allowed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    questions = world()[2]
    monkeypatch.setattr(trees, "_SAMPLES_AT_ONCE", 140)
    batches = list(trees._batches(questions))
    assert [question for batch in batches for question in batch] == questions
    assert len(batches) > 1
    for batch in batches:
        assert len(batch) == 1 or sum(len(question.samples) for question in batch) <= 140


def test_no_question_has_no_answer_and_no_round_leaves_a_bare_forest() -> None:
    codes, quantiser, questions = world()
    assert grown(codes, quantiser, [], GROWTH) == []
    idle = Growth(rounds=0, shrinkage=0.5, feature_share=0.5, seed=3)
    assert all(same(f, Forest.bare()) for f in grown(codes, quantiser, questions, idle))


@given(seeds, st.integers(1, 4))
@few(20)
def test_shares_sum_to_one_for_each_owner_and_sums_are_exact(seed: int, owners: int) -> None:
    rng = np.random.default_rng(seed)
    owner = rng.permutation(np.repeat(np.arange(owners), 50))
    weights = shares(rng.random(len(owner)) * 10.0 ** rng.integers(-3, 3), owner, owners)
    assert np.bincount(owner, weights) == pytest.approx(np.ones(owners))
    order = rng.permutation(len(owner))
    for k in range(owners):
        mixed = weights[order][owner[order] == k]
        assert mixed.cumsum()[-1] == weights[owner == k].cumsum()[-1]


def test_what_is_left_out_of_a_search_holds_little_of_each_question_s_weight() -> None:
    questions = world()[2]
    asked = trees._Asked.of(questions)
    rng = np.random.default_rng(1)
    raw = rng.random(len(asked.samples)) ** 6
    weights = shares(raw, asked.question, len(questions))
    kept = asked.heavy(weights)
    held = np.bincount(asked.question[kept], weights[kept])
    assert held.min() >= 0.98 - 1e-9
    assert len(kept) < 0.8 * len(raw)
    for k in range(len(questions)):
        left = np.setdiff1d(np.flatnonzero(asked.question == k), kept)
        assert weights[left].max() < weights[kept[asked.question[kept] == k]].min()
    assert len(asked.heavy(asked.even_weights())) == len(asked.samples)
