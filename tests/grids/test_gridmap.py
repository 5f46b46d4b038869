"""Grid maps: cells and their places, windows, distances, rays, and motions that are not rigid."""

from __future__ import annotations

import itertools
import math

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import distance_transform_edt

from specmap_cli.core.geometry import BentMotion, LocalMotion, Pose2
from specmap_cli.grids import gridmap
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap, cast_rays
from tests.strategies import grid_maps, seeds


@given(grid_maps())
def test_cells_and_their_centres_belong_together(grid: GridMap) -> None:
    cells = np.argwhere(np.ones_like(grid.cells))
    centres = grid.centres_of(cells)
    np.testing.assert_array_equal(grid.cells_of(centres), cells)
    np.testing.assert_array_equal(grid.values_at(centres), grid.cells.reshape(-1))
    height, width = grid.cells.shape
    outside = np.array([[-1, 0], [0, -1], [height, 0], [0, width]])
    assert not grid.inside(outside).any()
    assert (grid.values_at(grid.centres_of(outside)) == UNKNOWN).all()
    assert grid.inside(cells).all()


@given(grid_maps())
def test_distances_are_scipys(grid: GridMap) -> None:
    clearance = distance_transform_edt(np.pad(grid.free, 1))[1:-1, 1:-1] * grid.resolution
    np.testing.assert_allclose(grid.clearance(), clearance, rtol=1e-5)
    if grid.occupied.any():
        distance = distance_transform_edt(~grid.occupied) * grid.resolution
        np.testing.assert_allclose(grid.obstacle_distance(), distance, rtol=1e-5)
    else:
        assert (grid.obstacle_distance() > 100.0).all()


def test_what_is_near_a_zero_is_the_same_in_bands_of_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    picture = (np.random.default_rng(0).uniform(size=(90, 40)) > 0.01).astype(np.uint8)
    picture[30:70, 5:35] = 1  # some bands of rows hold no zero
    numbers = np.random.default_rng(1).integers(-1, 7, (90, 40)).astype(np.int16)
    table = np.arange(10, 18, dtype=np.int32)
    away = distance_transform_edt(picture)
    for cells in (1 << 20, 120):
        monkeypatch.setattr(gridmap, "_CELLS_AT_ONCE", cells)
        for reach in (0.0, 2.99, 3.0, 5.0, 200.0):
            np.testing.assert_array_equal(gridmap.within(picture, reach), away <= reach)
        np.testing.assert_array_equal(gridmap.looked_up(table, numbers), table[numbers])
    assert gridmap.within(picture[:0], 3.0).shape == (0, 40)


@given(grid_maps(), st.data())
def test_a_window_is_the_same_map_seen_through_a_hole(grid: GridMap, data: st.DataObject) -> None:
    height, width = grid.cells.shape
    low, left = data.draw(st.integers(0, height - 1)), data.draw(st.integers(0, width - 1))
    high, right = data.draw(st.integers(low, height)), data.draw(st.integers(left, width))
    part = grid.window(slice(low, high), slice(left, right))
    assert part.cells.shape == (high - low, right - left)
    assert part.resolution == grid.resolution
    cells = np.argwhere(np.ones_like(part.cells))
    places = part.centres_of(cells)
    np.testing.assert_allclose(places, grid.centres_of(cells + (low, left)), atol=1e-9)
    np.testing.assert_array_equal(grid.values_at(places), part.cells.reshape(-1))
    assert not np.shares_memory(part.cells, grid.cells)


def test_a_point_on_a_border_belongs_to_the_cell_above_and_right_of_it() -> None:
    grid = GridMap(np.zeros((4, 4), dtype=np.uint8), 0.25, (-0.5, 1.0))
    corners = np.array([[-0.5, 1.0], [0.0, 1.0], [-0.25, 1.25], [0.5, 2.0]])
    assert grid.cells_of(corners).tolist() == [[0, 0], [0, 2], [1, 1], [4, 4]]
    assert grid.inside(grid.cells_of(corners)).tolist() == [True, True, True, False]
    assert grid.cells_of(np.zeros((0, 2))).shape == (0, 2)
    assert grid.values_at(np.zeros((0, 2))).shape == (0,)


def test_a_packed_grid_is_the_grid_in_a_fraction_of_its_memory() -> None:
    grid = GridMap(np.full((300, 200), UNKNOWN, dtype=np.uint8), 0.05, (-3.0, 7.5))
    grid.cells[50:250, 40:160], grid.cells[50:250, 40] = FREE, OCCUPIED
    packed = gridmap.PackedGrid.of(grid)
    np.testing.assert_array_equal(packed.grid.cells, grid.cells)
    assert (packed.grid.resolution, packed.grid.origin) == (0.05, (-3.0, 7.5))
    assert 20 * len(packed.cells.data) < grid.cells.nbytes


def test_rays_end_at_their_range_and_at_the_edge_of_the_grid() -> None:
    room = GridMap(np.full((100, 140), FREE, dtype=np.uint8), 0.05)
    room.cells[:, 120:] = OCCUPIED  # from x = 6 m on
    distance, middle, ahead = room.obstacle_distance(), np.array([[3.5, 2.5]]), np.zeros(1)
    assert cast_rays(distance, room, middle, ahead, 2.4)[0] == np.inf
    assert cast_rays(distance, room, middle, ahead, 2.6)[0] == pytest.approx(2.5)
    assert cast_rays(distance, room, middle, ahead + np.pi, 50.0)[0] == np.inf
    assert cast_rays(distance, room, middle + 9.0, ahead, 50.0)[0] == np.inf
    assert cast_rays(distance, room, middle[:0], ahead[:0], 5.0).shape == (0,)


def walked(grid: GridMap, origin: np.ndarray, angle: float) -> float:
    """The range of one ray, from border to border through every cell it crosses."""
    start = (origin - grid.origin) / grid.resolution
    step = np.array([math.cos(angle), math.sin(angle)])
    height, width = grid.cells.shape
    borders = [
        (line - start[axis]) / step[axis]
        for axis, count in ((0, width), (1, height))
        for line in range(count + 1)
        if step[axis]
    ]
    for near, far in itertools.pairwise(np.array([0.0, *sorted(t for t in borders if t > 0.0)])):
        column, row = np.floor(start + step * (near + far) / 2.0).astype(int)
        if not (0 <= row < height and 0 <= column < width):
            return math.inf
        if grid.cells[row, column] == OCCUPIED:
            return float(near) * grid.resolution
    return math.inf


@given(grid_maps(), seeds)
def test_ranges_are_those_of_a_walk_through_every_cell(grid: GridMap, seed: int) -> None:
    rng = np.random.default_rng(seed)
    height, width = grid.cells.shape
    origins = grid.origin + rng.uniform(0, 1, (12, 2)) * (width, height) * np.array(grid.resolution)
    middle = grid.centres_of(np.array([[height // 2, width // 2]] * 4))
    origins = np.concatenate([origins, middle])  # from the middle along its row and its column
    angles = np.concatenate([rng.uniform(-np.pi, np.pi, 12), 0.5 * np.pi * np.arange(4)])
    found = cast_rays(grid.obstacle_distance(), grid, origins, angles, 100.0)
    expected = [walked(grid, origin, angle) for origin, angle in zip(origins, angles, strict=True)]
    np.testing.assert_allclose(found, expected, atol=1e-5)


@given(grid_maps(), st.integers(0, 3))
def test_a_crop_is_what_is_known_and_a_frame_within_the_map(grid: GridMap, frame: int) -> None:
    crop, known = grid.cropped(frame=frame), np.argwhere(grid.cells != UNKNOWN)
    if not len(known):
        assert crop is grid
        return
    low = np.maximum(known.min(axis=0) - frame, 0).tolist()
    high = np.minimum(known.max(axis=0) + frame + 1, grid.cells.shape).tolist()
    expected = grid.window(slice(low[0], high[0]), slice(low[1], high[1]))
    for found in (crop, grid.cropped(grid.cells != UNKNOWN, frame)):
        np.testing.assert_array_equal(found.cells, expected.cells)
        assert found.origin == expected.origin


RIGID = Pose2(3.0, -1.0, 0.7)
POINTS = np.array([[0.0, 0.0], [5.0, 2.0], [-4.0, 8.0]])


def local(x: float, y: float, off_x: float) -> LocalMotion:
    return LocalMotion(np.array([x, y]), Pose2(RIGID.x + off_x, RIGID.y, RIGID.theta), 10.0)


def test_each_local_motion_rules_where_it_is_and_between_them_it_blends() -> None:
    bent = BentMotion(RIGID, (local(0.0, 0.0, 0.0), local(20.0, 0.0, 0.2)))
    places = np.array([[0.0, 0.0], [10.0, 0.0], [20.0, 0.0]])
    off = bent.apply(places) - RIGID.apply(places)
    assert off[:, 0] == pytest.approx([0.0, 0.1, 0.2], abs=0.01)
    assert off[:, 1] == pytest.approx(0.0)
    assert bent.near(places[2]).x - RIGID.x == pytest.approx(off[2, 0])


def test_without_local_motions_it_is_rigid_and_with_them_it_leads_there_and_back() -> None:
    assert BentMotion(RIGID).apply(POINTS) == pytest.approx(RIGID.apply(POINTS))
    bent = BentMotion(RIGID, (local(0.0, 0.0, 0.0), local(8.0, 3.0, 0.15)))
    assert bent.apply(POINTS[:0]).shape == (0, 2)
    assert bent.inverse().apply(bent.apply(POINTS)) == pytest.approx(POINTS, abs=0.01)


def test_distances_are_the_same_bit_for_bit_wherever_the_picture_lies() -> None:
    picture = (np.random.default_rng(0).random((233, 181)) > 0.002).astype(np.uint8)
    exact = distance_transform_edt(picture).astype(np.float32)
    threads = cv2.getNumThreads()
    for count in (1, 2):
        cv2.setNumThreads(count)
        for offset in range(4):
            memory = np.empty(picture.size + 4, dtype=np.uint8)
            moved = memory[offset : offset + picture.size].reshape(picture.shape)
            moved[:] = picture
            np.testing.assert_array_equal(gridmap.cell_distances(moved), exact)
    cv2.setNumThreads(threads)
