"""Worlds of a simulation and the rooms painted in them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from specmap_cli.core.errors import MapError
from specmap_cli.grids.gridmap import FREE, UNKNOWN, GridMap
from specmap_cli.simulation.worlds import RoomTruth, World, read_rooms


def test_beams_end_at_unknown_cells_too() -> None:
    cells = np.full((20, 40), FREE, dtype=np.uint8)
    cells[:, 30:] = UNKNOWN
    world = World.of(GridMap(cells, 0.1, (5.0, 0.0)))
    ahead, back = world.cast(np.array([[6.0, 1.05]] * 2), np.array([0.0, np.pi]), 10.0)
    assert ahead == pytest.approx(2.0, abs=1e-5)
    assert back == np.inf  # off the plan


def test_clearance_errs_on_the_safe_side(flat: GridMap) -> None:
    world = World.of(flat)
    walls = flat.centres_of(np.argwhere(flat.occupied))
    rng = np.random.default_rng(1)
    points = rng.uniform((0.3, 0.3), (8.7, 5.7), (300, 2))
    to_centres = np.linalg.norm(points[:, None] - walls[None], axis=2).min(axis=1)
    # at most half a cell's diagonal between a point and its cell's centre, and so for the wall
    assert (world.clearance_at(points) <= to_centres + 0.5 * np.sqrt(2) * 0.05).all()
    assert (world.clearance_at(np.array([[-1.0, 2.0], [99.0, 2.0]])) == 0.0).all()


def test_rooms_are_the_large_white_regions_of_a_picture(tmp_path: Path) -> None:
    picture = np.zeros((60, 100), dtype=np.uint8)
    picture[5:25, 5:45] = 255  # the upper room: the higher y
    picture[35:55, 50:95] = 251
    picture[40:49, 10:20] = 255  # 90 pixels: not a room
    picture[35:55, 30:45] = 250  # not white enough
    cv2.imwrite(str(tmp_path / "rooms.png"), picture)
    rooms = read_rooms(tmp_path / "rooms.png", 0.1, (-1.0, 2.0))
    assert rooms.count == 2
    points = np.array([[1.0, 6.5], [6.0, 3.5], [0.5, 3.5], [2.5, 3.5]])
    assert rooms.at(points, reach_m=0.05).tolist() == [1, 2, 0, 0]


def test_a_pose_on_the_line_of_a_door_gets_the_nearer_room(flat_rooms: RoomTruth) -> None:
    door_x = 1.7
    poses = np.array([[door_x, 1.95, 0.3], [door_x, 2.08, 0.0], [-3.0, 2.0, 1.0]])
    assert flat_rooms.at(poses).tolist() == [4, 1, 0]
    assert flat_rooms.at(poses, reach_m=0.01).tolist() == [0, 0, 0]


@pytest.mark.parametrize("content", [None, b"no picture"])
def test_an_unreadable_picture_of_rooms_is_one_clear_line(
    tmp_path: Path, content: bytes | None
) -> None:
    path = tmp_path / "rooms.png"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(MapError, match=r"rooms\.png: cannot be read"):
        read_rooms(path, 0.05)


def test_a_picture_without_rooms_is_refused(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "dark.png"), np.full((30, 30), 200, np.uint8))
    with pytest.raises(MapError, match="no white region"):
        read_rooms(tmp_path / "dark.png", 0.05)
