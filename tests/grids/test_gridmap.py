"""The occupancy grid claims what beams have proved and no more; virtual scans are exact."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree

from specmap_cli.core.config import GridConfig
from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import PlanarScan
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap, cell_distances
from specmap_cli.grids.occupancy import OccupancyGrid
from specmap_cli.grids.ray_casting import cast_ranges, cast_rays
from tests.strategies import grid_maps, planar_scans, poses, seeds

CELL = 0.0625  # a power of two, so that shifts by whole cells are exact
CONFIG = GridConfig(resolution_m=CELL)


def gridded(scans: list[PlanarScan], at: list[Pose2], config: GridConfig = CONFIG) -> GridMap:
    grid = OccupancyGrid(config)
    for scan, pose in zip(scans, at, strict=True):
        grid.integrate(scan, pose)
    return grid.snapshot()


def known(grid: GridMap) -> dict[tuple[int, int], int]:
    """State of every known cell by its place in the world, in whole cells."""
    column, row = (round(side / grid.resolution) for side in grid.origin)
    cells = np.argwhere(grid.cells != UNKNOWN)
    return {(int(c) + column, int(r) + row): int(grid.cells[r, c]) for r, c in cells}


def one_beam(bearing: float, reach: float) -> PlanarScan:
    return PlanarScan(0, np.array([bearing]), np.array([reach]), 20.0, False)


def proved_points(scan: PlanarScan, pose: Pose2, config: GridConfig) -> FloatArray:
    """Points dense along every beam that returned, and between two that met one surface."""
    returned = np.isfinite(scan.ranges)
    ranges = np.where(returned, np.minimum(scan.ranges, config.max_range_m), 0.0)
    beams = np.column_stack([np.cos(scan.bearings), np.sin(scan.bearings)]) * ranges[:, None]
    ends = [beams[returned]]
    gaps = np.linalg.norm(np.diff(beams, axis=0), axis=1)
    for i in np.flatnonzero(returned[1:] & returned[:-1] & (gaps <= config.surface_gap_m)):
        ends.append(beams[i] + np.linspace(0, 1, 12)[:, None] * (beams[i + 1] - beams[i]))
    along = np.linspace(0.0, 1.0, 400)[:, None, None] * np.concatenate(ends)[None]
    return pose.apply(along.reshape(-1, 2))


@given(planar_scans(beams=48, reach=4.0), poses)
def test_a_cell_is_free_only_where_a_beam_passed(scan: PlanarScan, pose: Pose2) -> None:
    grid = gridded([scan], [pose])
    free = grid.centres_of(np.argwhere(grid.free))
    away, _ = cKDTree(proved_points(scan, pose, CONFIG)).query(free)
    assert away.max() <= 1.25 * CELL  # a line drawn in whole cells strays by one of them


@given(planar_scans(reach=6.0), poses)
def test_every_return_is_an_occupied_cell_whatever_the_other_beams_say(
    scan: PlanarScan, pose: Pose2
) -> None:
    grid = gridded([scan] * 3, [pose] * 3)
    hits = pose.apply(scan.hits())
    # a return on the border of two cells belongs to either
    around = [hits + np.array([dx, dy]) for dx in (-1e-9, 1e-9) for dy in (-1e-9, 1e-9)]
    assert (np.array([grid.values_at(p) == OCCUPIED for p in around]).any(axis=0)).all()
    assert grid.occupied.sum() <= len(hits)


def test_beams_without_a_return_prove_nothing() -> None:
    bearings = np.linspace(-np.pi, np.pi, 90, endpoint=False)
    for empty in (np.inf, np.nan):
        nothing = PlanarScan(0, bearings, np.full(90, empty), 20.0, True)
        assert gridded([nothing], [Pose2(1.0, 2.0, 0.3)]).cells.size == 0
    ranges = np.full(90, np.inf)
    ranges[45] = 2.0  # bearing 0
    grid = gridded([PlanarScan(0, bearings, ranges, 20.0, True)], [Pose2(0.0, 0.0, 0.0)])
    places = np.array([[1.0, 0.0], [2.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [2.2, 0.0]])
    assert grid.values_at(places).tolist() == [FREE, OCCUPIED, UNKNOWN, UNKNOWN, UNKNOWN]


def test_a_beam_longer_than_the_cut_proves_free_space_and_no_wall() -> None:
    config = GridConfig(resolution_m=CELL, max_range_m=3.0)
    grid = gridded([one_beam(0.0, 5.0)], [Pose2(0.0, 0.0, 0.0)], config)
    places = np.array([[2.5, 0.0], [3.5, 0.0], [5.0, 0.0]])
    assert grid.values_at(places).tolist() == [FREE, UNKNOWN, UNKNOWN]
    assert not grid.occupied.any()


@pytest.mark.parametrize(("passes", "state"), [(0, OCCUPIED), (3, OCCUPIED), (4, FREE)])
def test_a_wall_is_given_up_when_most_scans_pass_through_it(passes: int, state: int) -> None:
    beams = [one_beam(0.0, 2.0)] + [one_beam(0.0, 4.0)] * passes
    grid = gridded(beams, [Pose2(0.0, 0.0, 0.0)] * len(beams))
    assert grid.values_at(np.array([[2.0, 0.0]]))[0] == state


@given(st.lists(st.tuples(planar_scans(beams=24), poses), min_size=2, max_size=4))
def test_neither_order_nor_growth_changes_what_was_counted(
    taken: list[tuple[PlanarScan, Pose2]],
) -> None:
    scans, at = [scan for scan, _ in taken], [pose for _, pose in taken]
    assert known(gridded(scans, at)) == known(gridded(scans[::-1], at[::-1]))


@given(planar_scans(), poses, st.integers(-40, 40), st.integers(-40, 40))
def test_a_shift_by_whole_cells_shifts_the_grid(
    scan: PlanarScan, pose: Pose2, columns: int, rows: int
) -> None:
    start = Pose2(round(pose.x * 256) / 256, round(pose.y * 256) / 256, pose.theta)
    moved = Pose2(start.x + columns * CELL, start.y + rows * CELL, start.theta)
    shifted = {(c + columns, r + rows): v for (c, r), v in known(gridded([scan], [start])).items()}
    found = known(gridded([scan], [moved]))
    # a beam may end on a border to within rounding
    different = {
        cell for cell in shifted.keys() | found.keys() if shifted.get(cell) != found.get(cell)
    }
    assert len(different) <= 2


@pytest.mark.parametrize("limit", [{"max_extent_m": 40.0}, {"max_area_m2": 1600.0}])
def test_a_grid_never_grows_past_its_limit(limit: dict[str, float]) -> None:
    grid = OccupancyGrid(GridConfig(resolution_m=CELL, **limit))
    grid.integrate(one_beam(0.0, 2.0), Pose2(0.0, 0.0, 0.0))
    before = grid.snapshot()
    grid.integrate(one_beam(0.0, 2.0), Pose2(500.0, 0.0, 0.0))
    grid.mark_free_disc(0.0, -500.0, 0.3)
    np.testing.assert_array_equal(grid.snapshot().cells, before.cells)
    grid.integrate(one_beam(0.0, 2.0), Pose2(5.0, 5.0, 0.0))
    assert grid.snapshot().cells.size * CELL**2 <= 1600.0
    assert grid.snapshot().values_at(np.array([[7.0, 5.0]]))[0] == OCCUPIED


def test_the_robot_stood_on_free_floor() -> None:
    grid = OccupancyGrid(CONFIG)
    grid.mark_free_disc(1.0, -2.0, 0.3)
    snapshot = grid.snapshot()
    assert snapshot.free_area_m2 == pytest.approx(math.pi * 0.09, rel=0.1)
    away = np.linalg.norm(snapshot.centres_of(np.argwhere(snapshot.free)) - (1.0, -2.0), axis=1)
    assert away.max() <= 0.3


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


def empty_room() -> GridMap:
    """A room of 5 m x 4 m, its walls at x = 1 and 6, y = 0.5 and 4.5."""
    cells = np.full((100, 140), OCCUPIED, dtype=np.uint8)
    cells[10:90, 20:120] = FREE
    return GridMap(cells, 0.05)


@given(seeds)
def test_virtual_scans_of_a_room_are_its_walls_in_closed_form(seed: int) -> None:
    room = empty_room()
    rng = np.random.default_rng(seed)
    origins = rng.uniform((1.0, 0.5), (6.0, 4.5), (20, 2))
    bearings = rng.uniform(-np.pi, np.pi, 30)
    c, s = np.cos(bearings), np.sin(bearings)
    to_x = (np.where(c > 0, 6.0, 1.0) - origins[:, :1]) / c
    to_y = (np.where(s > 0, 4.5, 0.5) - origins[:, 1:]) / s
    found = cast_ranges(room.obstacle_distance(), room, origins, bearings, 20.0)
    np.testing.assert_allclose(found, np.minimum(to_x, to_y), atol=1e-6)


@given(grid_maps(), seeds)
def test_a_ray_ends_where_it_first_touches_an_obstacle(grid: GridMap, seed: int) -> None:
    rng = np.random.default_rng(seed)
    height, width = grid.cells.shape
    origins = grid.origin + rng.uniform(0, 1, (30, 2)) * (width, height) * np.array(grid.resolution)
    angles = rng.uniform(-np.pi, np.pi, 30)
    longest = 0.6 * width * grid.resolution
    ranges = cast_rays(grid.obstacle_distance(), grid, origins, angles, longest)
    directions = np.column_stack([np.cos(angles), np.sin(angles)])
    returned = np.isfinite(ranges)
    inside = ranges[returned] + 1e-5 * grid.resolution
    ends = origins[returned] + directions[returned] * inside[:, None]
    assert (grid.values_at(ends) == OCCUPIED).all()
    reach = np.where(returned, ranges - 1e-5 * grid.resolution, longest)
    for share in np.linspace(0.0, 1.0, 200):
        points = origins + directions * (share * np.maximum(reach, 0.0))[:, None]
        assert (grid.values_at(points[reach > 0]) != OCCUPIED).all()


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


def test_distances_are_the_same_bit_for_bit_wherever_the_picture_lies() -> None:
    picture = (np.random.default_rng(0).random((233, 181)) > 0.002).astype(np.uint8)
    exact = distance_transform_edt(picture)
    threads = cv2.getNumThreads()
    for count in (1, 2):
        cv2.setNumThreads(count)
        for offset in range(4):
            memory = np.empty(picture.size + 4, dtype=np.uint8)
            moved = memory[offset : offset + picture.size].reshape(picture.shape)
            moved[:] = picture
            np.testing.assert_array_equal(cell_distances(moved), exact)
    cv2.setNumThreads(threads)
