"""Worlds of a simulation: what stops a beam, how far walls are, which room a pose lies in."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from specmap_cli.core.errors import MapError
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from specmap_cli.simulation.worlds import RoomTruth, World, read_rooms
from tests.strategies import grid_maps, seeds


@given(grid_maps())
def test_everything_that_is_not_free_is_a_wall(plan: GridMap) -> None:
    before = plan.cells.copy()
    world = World.of(plan)
    np.testing.assert_array_equal(world.plan.cells == FREE, plan.cells == FREE)
    np.testing.assert_array_equal(world.plan.cells == OCCUPIED, plan.cells != FREE)
    np.testing.assert_array_equal(plan.cells, before)
    cells = np.full((20, 40), FREE, dtype=np.uint8)
    cells[:, 30:] = UNKNOWN
    world = World.of(GridMap(cells, 0.1, (5.0, 0.0)))
    ahead, back = world.cast(np.array([[6.0, 1.05]] * 2), np.array([0.0, np.pi]), 10.0)
    assert ahead == pytest.approx(2.0, abs=1e-5)
    assert back == np.inf  # off the plan


@given(grid_maps(largest=12))
def test_clearance_is_that_to_the_nearest_wall_cell_less_half_a_cell(plan: GridMap) -> None:
    """Against every wall, one by one; what is off the plan is a wall, too."""
    world = World.of(plan)
    height, width = plan.cells.shape
    framed = np.pad(plan.free, 1)
    walls = np.argwhere(~framed) - 1
    everywhere = np.argwhere(np.ones((height, width), dtype=bool))
    gaps = np.linalg.norm(everywhere[:, None] - walls[None], axis=2).min(axis=1)
    expected = np.maximum(gaps * plan.resolution - 0.5 * plan.resolution, 0.0)
    expected[~plan.free.reshape(-1)] = 0.0
    found = world.clearance_at(plan.centres_of(everywhere))
    np.testing.assert_allclose(found, expected, atol=1e-6)


@pytest.mark.parametrize("kind", [str, Path])
def test_rooms_are_the_large_white_regions_of_a_picture(tmp_path: Path, kind: type) -> None:
    picture = np.zeros((60, 100), dtype=np.uint8)
    picture[5:25, 5:45] = 255  # the upper room: the higher y
    picture[35:55, 50:95] = 251
    picture[40:49, 10:20] = 255  # 90 pixels: not a room
    picture[35:55, 30:45] = 250  # not white enough
    cv2.imwrite(str(tmp_path / "rooms.png"), picture)
    rooms = read_rooms(kind(tmp_path / "rooms.png"), 0.1, (-1.0, 2.0))
    assert rooms.count == 2
    points = np.array([[1.0, 6.5], [6.0, 3.5], [0.5, 3.5], [2.5, 3.5]])
    assert rooms.at(points, reach_m=0.05).tolist() == [1, 2, 0, 0]
    coloured = cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR)
    coloured[35:55, 50:95] = (255, 0, 0)  # read by its brightness
    cv2.imwrite(str(tmp_path / "rooms.png"), coloured)
    assert read_rooms(tmp_path / "rooms.png", 0.1).count == 1


@given(seeds, st.integers(1, 12), st.integers(1, 12))
def test_a_point_is_in_the_room_of_its_cell_else_in_the_nearest(
    seed: int, height: int, width: int
) -> None:
    """Against every painted cell, one by one; of rooms equally near either will do."""
    rng = np.random.default_rng(seed)
    labels = rng.choice([0, 0, 0, 1, 2], size=(height, width)).astype(np.int32)
    labels[rng.integers(height), rng.integers(width)] = 3
    rooms = RoomTruth(labels, 0.5, (-2.0, 1.0))
    rows, columns = np.divmod(np.arange(height * width), width)
    centres = np.column_stack([columns, rows]) * 0.5 + (-1.75, 1.25)
    painted = np.flatnonzero(labels)
    away, _ = cKDTree(centres[painted]).query(centres)
    found = rooms.at(centres, reach_m=100.0)
    for k, room in enumerate(found.tolist()):
        own = centres[painted[labels.reshape(-1)[painted] == room]]
        nearest = np.linalg.norm(own - centres[k], axis=1).min()
        assert nearest <= 1.05 * away[k] + 1e-9  # OpenCV's mask of 5 is right to some percent
    np.testing.assert_array_equal(found[painted], labels.reshape(-1)[painted])
    bare = rooms.at(centres, reach_m=0.0)
    np.testing.assert_array_equal(bare, labels.reshape(-1))


def test_points_beside_the_picture_are_measured_from_its_border_up_to_half_a_metre() -> None:
    rooms = RoomTruth(np.repeat([[1, 2]], 10, axis=0).repeat(10, axis=1).astype(np.int32), 0.1)
    points = np.array([[-0.3, 0.5], [-0.7, 0.5], [2.4, 0.5], [2.7, 0.5], [1.0, 1.3]])
    assert rooms.at(points).tolist() == [1, 0, 2, 0, 2]
    none = RoomTruth(np.zeros((4, 4), dtype=np.int32), 0.1)
    assert none.count == 0
    assert none.at(points, reach_m=np.inf).tolist() == [0] * 5


def test_a_picture_that_cannot_be_read_or_has_no_rooms_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "rooms.png"
    for content in (None, b"no picture"):
        if content is not None:
            path.write_bytes(content)
        with pytest.raises(MapError, match=r"rooms\.png: cannot be read as a picture; give a PNG"):
            read_rooms(path, 0.05)
    cv2.imwrite(str(path), np.full((30, 30), 200, np.uint8))
    with pytest.raises(MapError, match=r"no white region of 100 pixels; is it a plan\?"):
        read_rooms(path, 0.05)
