"""Scores of a map against the rooms of its plan, on rooms of a few cells."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.metrics.cluster import contingency_matrix

from benchmarks.scores import MapScores, map_scores
from specmap_cli.core.errors import InputError
from specmap_cli.simulation.worlds import RoomTruth


def scores(rooms: list[int], labels: list[int]) -> MapScores:
    """Keyframes in the given rooms, one cell of 1 m a room, with the given submaps."""
    truth = RoomTruth(np.arange(1, 7, dtype=np.int32)[None, :], 1.0)
    places = np.array([[room - 0.5, 0.5] for room in rooms])
    return map_scores(truth, places, np.array(labels))


def test_a_submap_a_room_is_perfect_and_a_room_opened_again_on_the_second_lap_is_counted() -> None:
    found = scores([1, 1, 2, 2, 1, 1, 2, 2], [0, 0, 1, 1, 0, 0, 1, 1])
    assert (found.whole, found.recognised, found.purity) == (1.0, 1.0, 1.0)
    assert (found.doors, found.found, found.invented) == (1, 1, 0)
    found = scores([1, 1, 2, 2, 1, 1, 2, 2], [0, 0, 1, 1, 2, 2, 1, 1])
    assert found.reopened == (1,)
    assert found.recognised == 0.5
    assert found.pieces == {1: 2, 2: 1}
    assert scores([1, 1, 1, 1, 2, 2], [0, 0, 0, 0, 1, 1]).reopened == (), "first seen late"


tours = st.lists(st.tuples(st.integers(1, 6), st.integers(0, 4)), min_size=1, max_size=40)


@given(tours, st.permutations(range(5)))
def test_scores_are_those_counted_by_hand(tour: list[tuple[int, int]], numbers: list[int]) -> None:
    """The numbers of submaps do not matter."""
    rooms, labels = [room for room, _ in tour], [label for _, label in tour]
    found = scores(rooms, labels)
    assert scores(rooms, [numbers[label] for label in labels]) == found
    table = contingency_matrix(rooms, labels)
    assert found.purity == pytest.approx(table.max(axis=0).sum() / len(tour))
    assert dict(found.pieces) == {
        room: sum(
            tour.count((room, label)) >= 0.1 * rooms.count(room)
            for label in set(labels)
            if (room, label) in tour
        )
        for room in set(rooms)
    }
    pairs = {frozenset(pair) for pair in pairwise(rooms)} - {frozenset([room]) for room in rooms}
    assert found.doors == len(pairs)
    assert found.found + found.invented <= 15
    assert found.found <= found.doors
    assert set(found.reopened) <= set(rooms)
    assert 0.0 <= found.recognised <= 1.0


def test_a_glance_into_a_room_makes_no_piece() -> None:
    rooms = [1] * 30 + [2] * 30
    assert scores(rooms, [0] * 28 + [1] * 32).pieces == {1: 1, 2: 1}
    assert scores(rooms, [0] * 27 + [1] * 33).pieces == {1: 2, 2: 1}


def test_a_submap_that_leaps_invents_a_door() -> None:
    """Room 2 lies between, but its keyframes went to the submaps of its neighbours."""
    found = scores([1, 1, 1, 2, 2, 3, 3, 3], [0, 0, 0, 0, 1, 1, 1, 1])
    assert (found.doors, found.found, found.invented) == (2, 0, 1)


def test_keyframes_outside_the_rooms_or_in_no_submap_are_left_out() -> None:
    truth = RoomTruth(np.array([[1, 2]], dtype=np.int32), 1.0)
    places = np.array([[0.5, 0.5], [9.0, 9.0], [1.5, 0.5], [1.5, 0.5], [-7.0, 0.5]])
    with_strays = map_scores(truth, places, np.array([0, 4, 1, -1, 5]))
    without = map_scores(truth, places[[0, 2]], np.array([0, 1]))
    assert with_strays == without
    assert without.purity == 1.0


@pytest.mark.parametrize("places", [np.zeros((0, 2)), np.full((3, 3), 50.0)])
def test_poses_of_another_frame_are_refused(places: np.ndarray[tuple[int, int]]) -> None:
    truth = RoomTruth(np.array([[1, 2]], dtype=np.int32), 1.0)
    with pytest.raises(InputError, match="no keyframe lies in a painted room: are the true poses"):
        map_scores(truth, places, np.zeros(len(places), dtype=np.int64))
