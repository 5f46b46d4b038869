"""Virtual scans are exact."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given

from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap, cast_ranges, cast_rays
from tests.strategies import grid_maps, seeds


def empty_room() -> GridMap:
    """A room of 5 m x 4 m, its walls at x = 1 and 6, y = 0.5 and 4.5."""
    cells = np.full((100, 140), OCCUPIED, dtype=np.uint8)
    cells[10:90, 20:120] = FREE
    return GridMap(cells, 0.05)


def test_rays_end_at_their_range_and_at_the_edge_of_the_grid() -> None:
    room = empty_room()
    distance, middle = room.obstacle_distance(), np.array([[3.5, 2.5]])
    assert cast_ranges(distance, room, middle, np.array([0.0]), 2.4)[0, 0] == np.inf
    assert cast_ranges(distance, room, middle, np.array([0.0]), 2.6)[0, 0] == pytest.approx(2.5)
    open_ = GridMap(np.zeros((10, 10), dtype=np.uint8), 0.1)
    far = cast_ranges(
        open_.obstacle_distance(), open_, np.array([[0.5, 0.5], [9.0, 9.0]]), np.zeros(1), 50.0
    )
    assert (far == np.inf).all()
    in_wall = cast_ranges(distance, room, np.array([[0.5, 2.0]]), np.array([0.0]), 5.0)
    assert in_wall[0, 0] == 0.0


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
    crossings = np.array([0.0, *sorted(t for t in borders if t > 0.0)])
    for near, far in itertools.pairwise(crossings):
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
    angles = rng.uniform(-np.pi, np.pi, 12)
    found = cast_rays(grid.obstacle_distance(), grid, origins, angles, 100.0)
    expected = [walked(grid, origin, angle) for origin, angle in zip(origins, angles, strict=True)]
    np.testing.assert_allclose(found, expected, atol=1e-5)


@given(grid_maps())
def test_rays_along_rows_and_columns_see_the_next_obstacle(grid: GridMap) -> None:
    row, column = (side // 2 for side in grid.cells.shape)
    middle = grid.centres_of(np.array([[row, column]]))
    turns = np.array([0.0, 0.5, 1.0, 1.5]) * np.pi
    ranges = cast_ranges(grid.obstacle_distance(), grid, middle, turns, 100.0)[0]
    lines = (
        grid.cells[row, column:],
        grid.cells[row:, column],
        grid.cells[row, column::-1],
        grid.cells[row::-1, column],
    )
    for reach, line in zip(ranges, lines, strict=True):
        ahead = np.flatnonzero(line == OCCUPIED)
        expected = max(ahead[0] - 0.5, 0.0) * grid.resolution if len(ahead) else math.inf
        assert reach == pytest.approx(expected, abs=1e-6)


def test_many_rays_are_the_same_rays_few_at_a_time() -> None:
    room = empty_room()
    rng = np.random.default_rng(3)
    origins, angles = rng.uniform((1.1, 0.6), (5.9, 4.4), (70_000, 2)), rng.uniform(-3, 3, 70_000)
    distance = room.obstacle_distance()
    whole = cast_rays(distance, room, origins, angles, 20.0)
    for part in (slice(0, 5), slice(65_530, 65_545), slice(69_995, 70_000)):
        few = cast_rays(distance, room, origins[part], angles[part], 20.0)
        np.testing.assert_array_equal(few, whole[part])


def test_no_rays_have_no_ranges() -> None:
    room = empty_room()
    assert cast_rays(room.obstacle_distance(), room, np.zeros((0, 2)), np.zeros(0), 5.0).shape == (
        0,
    )
    bearings = np.zeros(7)
    assert cast_ranges(room.obstacle_distance(), room, np.zeros((0, 2)), bearings, 5.0).shape == (
        0,
        7,
    )
