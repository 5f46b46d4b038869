"""Segmentation scores against hand-made cases and scikit-learn."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.metrics import completeness_score, homogeneity_score

from specmap_cli.evaluation.scores import (
    homogeneity,
    overlap_table,
    room_scores,
    stay_scores,
    visits_of,
)

ROOMS = np.repeat([0, 0, 0, 0, 1, 1, 1, 1, -1, -1], 10).reshape(10, 10).T


def test_equal_labels_score_one() -> None:
    scores = room_scores(ROOMS, ROOMS)
    assert (scores.recall, scores.precision, scores.iou) == (1.0, 1.0, 1.0)
    assert scores.segments_per_room == 1.0


def test_one_segment_for_two_rooms() -> None:
    scores = room_scores(ROOMS, np.zeros_like(ROOMS))
    assert scores.recall == 1.0
    assert scores.precision == 0.5
    assert scores.iou == 0.5
    assert scores.segments_per_room == 0.5


def test_a_room_in_three_pieces_and_one_half_found() -> None:
    segments = np.full_like(ROOMS, -1)
    segments[:5, 4:8] = 0
    segments[0:5, :4], segments[5:8, :4], segments[8:, :4] = 1, 2, 3
    scores = room_scores(ROOMS, segments)
    assert scores.recall == pytest.approx((0.5 + 0.5) / 2)
    assert scores.precision == 1.0
    assert scores.segments_per_room == 2.0


def test_segments_outside_every_room_are_not_counted() -> None:
    segments = np.where(ROOMS < 0, 2, ROOMS)
    assert room_scores(ROOMS, segments) == room_scores(ROOMS, ROOMS)


def test_nothing_found_scores_zero() -> None:
    assert room_scores(ROOMS, np.full_like(ROOMS, -1)).recall == 0.0


def test_overlap_table_counts_cells() -> None:
    table = overlap_table(ROOMS, np.where(ROOMS == 1, 0, 1))
    np.testing.assert_array_equal(table, [[0, 40], [40, 0]])


labels = st.lists(st.integers(0, 4), min_size=1, max_size=40)


@given(truth=labels, seed=st.integers(0, 1000))
@settings(derandomize=True, max_examples=50)
def test_homogeneity_and_completeness_are_those_of_scikit_learn(
    truth: list[int], seed: int
) -> None:
    rooms = np.array(truth)
    found = np.random.default_rng(seed).integers(0, 4, len(rooms))
    assert homogeneity(rooms, found) == pytest.approx(homogeneity_score(rooms, found), abs=1e-9)
    scores = stay_scores(rooms, rooms, found, found)
    assert scores.completeness == pytest.approx(completeness_score(rooms, found), abs=1e-9)


def test_short_stays_belong_to_the_one_before() -> None:
    rooms = np.array([3] * 20 + [5] * 5 + [3] * 20 + [5] * 20)
    visits = visits_of(rooms, np.full(len(rooms), 0.1))
    np.testing.assert_array_equal(visits, [0] * 45 + [1] * 20)


def test_coming_back_after_a_long_stay_elsewhere_is_another_visit() -> None:
    rooms = np.array([3] * 20 + [5] * 20 + [3] * 20)
    assert visits_of(rooms, np.full(60, 0.1)).max() == 2


def test_regions_over_visits() -> None:
    visits = np.array([0, 0, 1, 1, 2, 2])
    scores = stay_scores(np.array([0, 0, 1, 1, 0, 0]), visits, np.array([0, 0, 1, 1, 0, 0]), visits)
    assert scores.segments_per_visit == 1.0
    assert scores.homogeneity == 1.0
    assert scores.completeness == 1.0
