"""Old submaps keep their keyframes, ids and borders; new space gets new ids."""

from __future__ import annotations

import numpy as np
import pytest

from specmap_cli.core.geometry import FloatArray, compose
from specmap_cli.core.records import IntArray, Labels
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from specmap_cli.topology.graph import Heritage, inherited
from specmap_cli.topology.regions import divide

REGION_MIN_M = 1.0


def rooms(count: int) -> GridMap:
    """Rooms of 4 m x 4 m in a row, with doors 1 m wide, in cells of 0.1 m."""
    cells = np.full((44, 41 * count + 1), OCCUPIED, dtype=np.uint8)
    for k in range(count):
        cells[2:42, 41 * k + 1 : 41 * k + 41] = FREE
        if k:
            cells[17:27, 41 * k] = FREE
    return GridMap(cells, 0.1)


def way(start_m: float, end_m: float) -> FloatArray:
    """Poses every 0.1 m along the middle of the rooms."""
    x = np.arange(start_m, end_m, 0.1 if start_m < end_m else -0.1)
    return np.column_stack([x, np.full_like(x, 2.2), np.zeros_like(x)])


def room_of(poses: FloatArray) -> IntArray:
    return (poses[:, 0] // 4.1).astype(np.int64)


def labels_after(
    known: GridMap,
    first: FloatArray,
    second: FloatArray,
    *,
    next_id: int = 2,
    joint: int | None = None,
    moved: FloatArray | None = None,
) -> tuple[IntArray, IntArray]:
    """Labels of the keyframes of a map of some rooms, and of a second tour.

    The joint division says the room and `joint`, or one submap for all; the layout may have moved.
    """
    submaps = room_of(first)
    known_as = Labels(stamps_ns=np.arange(len(first)), poses=first, submaps=submaps)
    old = Heritage(first, submaps, divide(known, known_as), next_id)
    poses = np.concatenate([first, second])
    division = np.zeros_like(room_of(poses)) if joint is None else joint + room_of(poses)
    placed = poses if moved is None else compose(moved, poses)
    labels = inherited(old, placed, division, REGION_MIN_M)
    return labels[: len(first)], labels[len(first) :]


def test_a_new_room_gets_an_id_that_no_other_ever_had() -> None:
    first, second = way(1.0, 7.5), way(2.0, 14.0)
    kept, labels = labels_after(rooms(2), first, second, next_id=7, joint=10)
    assert kept.tolist() == room_of(first).tolist()
    expected = np.array([0, 1, 7, 8])[room_of(second)]
    assert (labels != expected).sum() <= 2, "a door may be counted either way"
    assert set(kept.tolist()) | set(labels.tolist()) == {0, 1, 7, 8}


@pytest.mark.parametrize(
    ("second", "moved"),
    [(way(7.0, 1.5), None), (way(2.0, 7.0), np.array([5.0, -3.0, 1.0]))],
    ids=["in place", "moved"],
)
def test_old_borders_stay_where_the_joint_division_differs_and_move_with_the_keyframes(
    second: FloatArray, moved: FloatArray | None
) -> None:
    _, labels = labels_after(rooms(2), way(1.0, 7.5), second, moved=moved)
    assert (labels != room_of(second)).sum() <= 2


def test_the_rest_of_a_room_that_was_half_seen_goes_to_its_submap() -> None:
    half = rooms(2).cells.copy()
    half[:, 62:] = UNKNOWN
    _, labels = labels_after(GridMap(half, 0.1), way(1.0, 5.8), way(5.0, 7.8), joint=0)
    assert set(labels.tolist()) == {1}


def test_a_new_room_only_looked_into_is_none_and_all_in_new_space_is_a_submap() -> None:
    for second, ids in ((way(7.0, 8.6), {0, 1}), (way(8.5, 9.0), {0, 1, 2})):
        both = labels_after(rooms(2), way(1.0, 7.5), second, joint=0)
        assert set(np.concatenate(both).tolist()) == ids
    assert set(both[1].tolist()) == {2}


def test_a_room_that_was_only_looked_into_is_new() -> None:
    first, second = way(1.0, 3.5), way(2.0, 7.8)
    labels = Labels(stamps_ns=np.arange(len(first)), poses=first, submaps=room_of(first))
    owner = divide(rooms(2), labels).owner
    assert (owner[:, 50:80] == 0).any(), "seen through the door, and nobody else's"
    _, found = labels_after(rooms(2), first, second, next_id=1, joint=10)
    assert (found != room_of(second)).sum() <= 3
