"""What newer recordings show again, and the walls that only one keyframe knows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import IntArray, PlanarScan
from specmap_cli.core.settings import GridConfig
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from specmap_cli.grids.keyframes import (
    KeyframeStore,
    Recorded,
    repeated,
    sole_views,
    views_needed,
)
from tests.casting import keyframe

ENOUGH = 4


def laser(beams: int, view_deg: float, range_max: float) -> PlanarScan:
    bearings = np.radians(np.linspace(-view_deg / 2, view_deg / 2, beams))
    return PlanarScan(0, bearings, np.full(beams, np.inf), range_max, view_deg > 350)


@pytest.mark.parametrize(
    ("scan", "looks"),
    [
        (laser(181, 180.0, 81.0), 7),  # beams 0.35 m apart at 20 m, where the grid ends
        (laser(181, 180.0, 5.0), 2),
        (laser(1081, 270.0, 30.0), 2),
        (laser(36, 350.0, 30.0), 16),  # no cell needs more than a grid takes in
        (laser(1, 0.0, 30.0), 1),
    ],
)
def test_so_many_scans_show_a_place_that_every_cell_of_a_wall_is_hit(
    scan: PlanarScan, looks: int
) -> None:
    assert views_needed(scan, GridConfig()) == looks


def along(start: float, end: float, y: float = 0.0, heading: float = 0.0) -> FloatArray:
    """A way along a line, a keyframe every 0.1 m."""
    x = start + 0.1 * np.arange(round((end - start) / 0.1))
    return np.column_stack([x, np.full(len(x), y), np.full(len(x), heading)])


def recorded(ways: Sequence[FloatArray], all_round: bool = False) -> Recorded:
    return Recorded(
        poses=np.concatenate(ways),
        of=np.repeat(np.arange(len(ways)), [len(way) for way in ways]),
        enough=np.full(len(ways), ENOUGH),
        all_round=np.full(len(ways), all_round),
    )


def gone(drive: Recorded, needed: Sequence[int] = ()) -> list[IntArray]:
    """The keyframes that are repeated, of each recording by their own numbers."""
    marked = np.zeros(len(drive.poses), dtype=bool)
    marked[list(needed)] = True
    found = repeated(drive, marked)
    return [np.flatnonzero(found[drive.of == k]) for k in range(len(drive.enough))]


def test_what_was_driven_again_goes_and_the_rest_stays() -> None:
    old, new = gone(recorded([along(0.0, 10.0), along(4.0, 6.0, 0.3)]))
    assert len(new) == 0
    assert set(old.tolist()) <= set(range(36, 65))  # within half a metre of enough newer ones
    assert set(range(42, 58)) <= set(old.tolist())


def test_keyframes_that_are_needed_stay() -> None:
    (old, _) = gone(recorded([along(0.0, 10.0), along(4.0, 6.0)]), needed=[50])
    assert {49, 51} == {49, 50, 51} & set(old.tolist())


def test_the_way_back_shows_the_other_side_but_not_to_a_laser_that_looks_all_round() -> None:
    ways = [along(0.0, 3.0), along(0.0, 3.0, heading=np.pi)]
    assert len(gone(recorded(ways))[0]) == 0
    assert len(gone(recorded(ways, all_round=True))[0]) == 30


def test_a_few_newer_looks_are_not_enough() -> None:
    ways = [along(0.0, 3.0), along(1.0, 1.0 + 0.1 * (ENOUGH - 1))]
    assert len(gone(recorded(ways))[0]) == 0
    assert len(gone(recorded([ways[0], along(1.0, 1.0 + 0.1 * ENOUGH)]))[0]) > 0


def test_looks_of_several_newer_recordings_add_up() -> None:
    few = along(1.0, 1.2)
    assert len(few) == ENOUGH / 2
    assert len(gone(recorded([along(0.0, 3.0), few, few]))[0]) > 0


def test_where_the_last_recording_was_not_nothing_goes() -> None:
    ways = [along(0.0, 3.0), along(0.0, 3.0), along(0.0, 3.0, y=8.0)]
    assert [len(own) for own in gone(recorded(ways))] == [0, 0, 0]


def test_only_what_is_left_of_a_recording_speaks_for_a_place() -> None:
    # the second lies beside the first, the third beside the second: 0.6 m from the first
    ways = [along(0.0, 3.0), along(0.0, 3.0, 0.3), along(0.0, 3.0, 0.6)]
    first, second, _ = gone(recorded(ways))
    assert len(second) == 30
    assert len(first) == 0


def corridor(most: int) -> GridMap:
    """A wall along y = 1 m, from 0 to `most` cells of 0.1 m."""
    cells = np.full((20, 100), UNKNOWN, dtype=np.uint8)
    cells[:10] = FREE
    cells[10, :most] = OCCUPIED
    return GridMap(cells, 0.1)


@pytest.fixture
def beside() -> KeyframeStore:
    """Ten keyframes a metre apart; each sees the wall at its left and nothing else."""
    store = KeyframeStore()
    for k in range(10):
        scan = PlanarScan(k, np.array([np.pi / 2]), np.array([1.04]), 10.0, False)
        pose = Pose2(k + 0.05, 0.0, 0.0)
        store.append(keyframe(scan, pose, number=k))
    return store


def stay(store: KeyframeStore, marked: Sequence[int], unseen: Sequence[int]) -> list[int]:
    grid = corridor(100)
    cells = np.zeros(grid.cells.shape, dtype=bool)
    cells[10, list(unseen)] = True
    dropped = np.zeros(len(store), dtype=bool)
    dropped[list(marked)] = True
    with store:
        found = sole_views(store, dropped, store.poses, grid, cells, 20.0)
    return [int(number) for number in found]


def test_the_only_keyframe_that_shows_a_wall_stays(beside: KeyframeStore) -> None:
    assert stay(beside, marked=range(10), unseen=[30, 70]) == [3, 7]


def test_a_wall_that_a_kept_keyframe_shows_needs_no_other(beside: KeyframeStore) -> None:
    assert stay(beside, marked=[1, 2, 4], unseen=[30]) == []


def test_walls_that_newer_recordings_looked_at_need_none(beside: KeyframeStore) -> None:
    assert stay(beside, marked=range(10), unseen=[]) == []


def test_of_several_witnesses_the_last_stays() -> None:
    store = KeyframeStore()
    for k in range(3):
        scan = PlanarScan(k, np.array([np.pi / 2]), np.array([1.04]), 10.0, False)
        store.append(keyframe(scan, Pose2(3.05 + 0.02 * k, 0.0, 0.0), number=k))
    assert stay(store, marked=range(3), unseen=[30]) == [2]
