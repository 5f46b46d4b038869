"""Where submaps end, once the whole map is known."""

from __future__ import annotations

import numpy as np

from specmap_cli.core.config import SegmentationConfig
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from specmap_cli.segmentation.refinement import regions_of

CONFIG = SegmentationConfig()


def two_rooms() -> GridMap:
    """Two rooms of 4 m x 4 m side by side, joined by a door 0.9 m wide at y = 2 m."""
    cells = np.full((80, 164), OCCUPIED, dtype=np.uint8)
    cells[2:78, 2:80] = FREE
    cells[2:78, 84:162] = FREE
    cells[31:49, 80:84] = FREE
    return GridMap(cells, 0.05)


def drive(xs: np.ndarray, y: float = 2.0) -> np.ndarray:
    return np.column_stack([xs, np.full(len(xs), y), np.zeros(len(xs))])


def test_keyframes_change_region_in_the_door() -> None:
    poses = drive(np.linspace(1.0, 7.0, 61))
    labels = regions_of(two_rooms(), poses, CONFIG)
    change = np.flatnonzero(np.diff(labels))
    assert len(change) == 1
    assert 3.8 < poses[change[0], 0] < 4.4


def test_a_room_come_back_to_is_the_same_region() -> None:
    poses = drive(np.concatenate([np.linspace(1.0, 7.0, 31), np.linspace(7.0, 1.0, 31)]))
    labels = regions_of(two_rooms(), poses, CONFIG)
    assert labels[0] == labels[-1] != labels[30]


def test_a_glance_into_the_next_room_is_no_visit() -> None:
    xs = np.concatenate([np.linspace(1.0, 4.3, 34), np.linspace(4.3, 1.0, 34)])
    assert len(np.unique(regions_of(two_rooms(), drive(xs), CONFIG))) == 1


def test_keyframes_off_the_free_space_go_to_the_nearest_region() -> None:
    poses = drive(np.array([-0.5, 1.0, 2.0, 3.0]))
    assert len(np.unique(regions_of(two_rooms(), poses, CONFIG))) == 1


def test_a_map_without_free_space_is_one_region() -> None:
    grid = GridMap(np.full((20, 20), UNKNOWN, dtype=np.uint8), 0.05)
    assert regions_of(grid, drive(np.linspace(0.0, 1.0, 5)), CONFIG).tolist() == [0] * 5
