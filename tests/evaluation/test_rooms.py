"""Scores of a map against the rooms of its plan, on rooms of a few cells."""

from __future__ import annotations

import numpy as np

from specmap_cli.evaluation.rooms import MapScores, map_scores
from specmap_cli.simulation.worlds import RoomTruth


def scores(rooms: list[int], labels: list[int]) -> MapScores:
    """Keyframes in the given rooms, one cell of 1 m a room, with the given submaps."""
    truth = RoomTruth(np.arange(1, 7, dtype=np.int32)[None, :], 1.0)
    places = np.array([[room - 0.5, 0.5] for room in rooms])
    return map_scores(truth, places, np.array(labels))


def test_a_submap_a_room_is_perfect() -> None:
    found = scores([1, 1, 2, 2, 1, 1, 2, 2], [0, 0, 1, 1, 0, 0, 1, 1])
    assert (found.whole, found.recognised, found.purity) == (1.0, 1.0, 1.0)
    assert (found.doors, found.found, found.invented) == (1, 1, 0)


def test_a_room_opened_again_on_the_second_lap_is_counted() -> None:
    found = scores([1, 1, 2, 2, 1, 1, 2, 2], [0, 0, 1, 1, 2, 2, 1, 1])
    assert found.reopened == [1]
    assert found.recognised == 0.5
    assert found.pieces == {1: 2, 2: 1}


def test_a_room_first_seen_late_is_not_reopened() -> None:
    assert scores([1, 1, 1, 1, 2, 2], [0, 0, 0, 0, 1, 1]).reopened == []


def test_a_room_in_three_pieces_is_not_whole() -> None:
    assert scores([1, 1, 1, 2], [0, 1, 2, 3]).whole == 0.5


def test_edges_between_rooms_without_a_door_are_invented() -> None:
    found = scores([1, 2, 3, 1, 1, 3, 3], [0, 0, 1, 0, 0, 1, 1])
    assert found.doors == 3
    assert found.found == 1
    assert found.invented == 0
    assert found.purity < 1.0
