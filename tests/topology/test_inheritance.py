"""Old submaps keep their keyframes, ids and borders; new space gets new ids."""

from __future__ import annotations

import numpy as np

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


def heritage(known: GridMap, poses: FloatArray, next_id: int = 2) -> Heritage:
    """A map of the first two rooms."""
    labels = Labels(
        stamps_ns=np.arange(len(poses), dtype=np.int64), poses=poses, submaps=room_of(poses)
    )
    return Heritage(poses, labels.submaps, divide(known, labels), next_id)


def test_a_new_room_gets_an_id_that_no_other_ever_had() -> None:
    first, second = way(1.0, 7.5), way(2.0, 14.0)
    old = heritage(rooms(2), first, next_id=7)
    poses = np.concatenate([first, second])
    labels = inherited(old, poses, 10 + room_of(poses), REGION_MIN_M)
    assert labels[: len(first)].tolist() == room_of(first).tolist()
    expected = np.array([0, 1, 7, 8])[room_of(second)]
    assert (labels[len(first) :] != expected).sum() <= 2, "a door may be counted either way"
    assert set(labels.tolist()) == {0, 1, 7, 8}


def test_old_borders_stay_where_the_joint_division_differs() -> None:
    first, second = way(1.0, 7.5), way(7.0, 1.5)
    old = heritage(rooms(2), first)
    poses = np.concatenate([first, second])
    labels = inherited(old, poses, np.zeros(len(poses), dtype=np.int64), REGION_MIN_M)
    assert (labels[len(first) :] != room_of(second)).sum() <= 2


def test_the_rest_of_a_room_that_was_half_seen_goes_to_its_submap() -> None:
    known = rooms(2)
    half = known.cells.copy()
    half[:, 62:] = UNKNOWN
    first, second = way(1.0, 5.8), way(5.0, 7.8)
    old = heritage(GridMap(half, 0.1), first)
    poses = np.concatenate([first, second])
    labels = inherited(old, poses, room_of(poses), REGION_MIN_M)
    assert set(labels[len(first) :].tolist()) == {1}


def test_a_new_room_only_looked_into_is_none() -> None:
    first, second = way(1.0, 7.5), way(7.0, 8.6)
    old = heritage(rooms(2), first)
    poses = np.concatenate([first, second])
    labels = inherited(old, poses, room_of(poses), REGION_MIN_M)
    assert set(labels.tolist()) == {0, 1}


def test_territory_moves_with_the_keyframes_when_the_layout_moved() -> None:
    first, second = way(1.0, 7.5), way(2.0, 7.0)
    old = heritage(rooms(2), first)
    moved = compose(np.array([5.0, -3.0, 1.0]), np.concatenate([first, second]))
    labels = inherited(old, moved, np.zeros(len(moved), dtype=np.int64), REGION_MIN_M)
    assert (labels[len(first) :] != room_of(second)).sum() <= 2


def test_a_recording_that_lies_wholly_in_new_space_is_a_submap() -> None:
    first, second = way(1.0, 7.5), way(8.5, 9.0)
    old = heritage(rooms(2), first)
    poses = np.concatenate([first, second])
    labels = inherited(old, poses, room_of(poses), REGION_MIN_M)
    assert set(labels[len(first) :].tolist()) == {2}


def test_a_room_that_was_only_looked_into_is_new() -> None:
    first, second = way(1.0, 3.5), way(2.0, 7.8)
    old = heritage(rooms(2), first, next_id=1)
    assert (old.regions.owner[:, 50:80] == 0).any(), "seen through the door, and nobody else's"
    poses = np.concatenate([first, second])
    labels = inherited(old, poses, 10 + room_of(poses), REGION_MIN_M)
    expected = room_of(second)
    assert (labels[len(first) :] != expected).sum() <= 3
