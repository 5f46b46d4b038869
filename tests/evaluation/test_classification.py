"""Confusion, recall and precision of every class, and what counts as unknown."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.metrics import confusion_matrix, precision_recall_fscore_support

from specmap_cli.evaluation.protocols import classification_scores, score_lines

guesses = st.lists(st.tuples(st.integers(0, 4), st.integers(-1, 6)), min_size=1, max_size=60)


@given(guesses)
def test_the_confusion_is_scikit_learn_s_with_a_column_for_unknown(
    pairs: list[tuple[int, int]],
) -> None:
    truth, said = (np.array(column) for column in zip(*pairs, strict=True))
    ours = classification_scores(truth, said, range(5))
    unknown = np.where(said > 4, -1, said)
    theirs = confusion_matrix(truth, unknown, labels=[0, 1, 2, 3, 4, -1])
    np.testing.assert_array_equal(ours.confusion, theirs[:5])


@given(guesses)
def test_recall_and_precision_of_every_class_are_scikit_learn_s(
    pairs: list[tuple[int, int]],
) -> None:
    truth, said = (np.array(column) for column in zip(*pairs, strict=True))
    ours = classification_scores(truth, said, range(5))
    precision, recall, _, support = precision_recall_fscore_support(
        truth, said, labels=range(5), zero_division=0
    )
    visited = [k for k in range(5) if support[k]]
    assert ours.recall_of == {k: pytest.approx(recall[k]) for k in visited}
    assert ours.precision_of == {k: pytest.approx(precision[k]) for k in visited}


@given(guesses, st.integers(0, 1000))
def test_scores_depend_neither_on_names_nor_on_the_order_of_scans(
    pairs: list[tuple[int, int]], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    names = np.append(rng.permutation(100)[:7] + 10, -1)  # of 0..6, and of -1
    shuffled = [pairs[k] for k in rng.permutation(len(pairs))]
    truth, said = zip(*pairs, strict=True)
    plain = classification_scores(truth, said, range(5))
    renamed = classification_scores(
        [int(names[room]) for room, _ in shuffled],
        [int(names[guess]) for _, guess in shuffled],
        names[:5].tolist(),
    )
    assert renamed.as_dict() == plain.as_dict()
    assert renamed.ids == tuple(sorted(names[:5].tolist()))


@pytest.mark.parametrize("unknown", [None, -1, 99])
def test_there_is_one_unknown(unknown: int | None) -> None:
    found = classification_scores([7, 7, 3], [7, unknown, 3], [7, 3])
    assert found.ids == (3, 7)
    assert found.confusion.tolist() == [[1, 0, 0], [0, 1, 1]]
    assert (found.recall, found.precision) == (0.75, 1.0)
    assert found.accuracy == pytest.approx(2 / 3)


def test_a_class_never_called_has_no_precision_and_one_never_visited_has_no_score() -> None:
    found = classification_scores([0, 0, 1], [1, 1, 1], [0, 1, 2])
    assert found.precision_of == {0: 0.0, 1: pytest.approx(1 / 3)}
    assert found.recall_of == {0: 0.0, 1: 1.0}
    assert found.recall == 0.5


@pytest.mark.parametrize("ids", [[], [0, 1]])
def test_nothing_scored_scores_nought(ids: list[int]) -> None:
    found = classification_scores([], [], ids)
    assert found.confusion.shape == (len(ids), len(ids) + 1)
    assert found.as_dict() == {"recall": 0.0, "precision": 0.0, "accuracy": 0.0, "scans": 0}
    assert len(score_lines(found)) == 2


def test_every_scan_needs_a_prediction() -> None:
    with pytest.raises(ValueError, match="shorter"):
        classification_scores([0, 1], [0], [0, 1])


def test_figures_have_six_decimals_and_are_json() -> None:
    found = classification_scores([0, 0, 0], [0, 1, 1], [0, 1]).as_dict()
    assert json.loads(json.dumps(found)) == {
        "recall": 0.333333,
        "precision": 1.0,
        "accuracy": 0.333333,
        "scans": 3,
    }


def test_the_table_is_aligned() -> None:
    truth = np.repeat([3, 12], [1200, 2])
    assert score_lines(classification_scores(truth, [3] * 1201 + [12], [3, 12])) == [
        "  submap   scans  recall  precision",
        "       3   1,200   1.000      0.999",
        "      12       2   0.500      1.000",
        "    mean   1,202   0.750      1.000",
    ]
