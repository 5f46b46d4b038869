"""Tours cover all reachable space, and are driven within the robot's limits."""

from __future__ import annotations

from itertools import pairwise, permutations

import numpy as np
import pytest
from hypothesis import given
from scipy.spatial import cKDTree

from specmap_cli.core.errors import MapError
from specmap_cli.core.geometry import FloatArray
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.simulation.driving import Drive, drive
from specmap_cli.simulation.tours import plan_tour, reachable_space, shortest_order
from specmap_cli.simulation.worlds import RoomTruth, World
from tests.strategies import seeds

RADIUS = 0.25


def tour(plan: GridMap, seed: int, laps: int = 1, spacing_m: float = 1.5) -> FloatArray:
    world = World.of(plan)
    space = reachable_space(world, RADIUS)
    return plan_tour(world, space, RADIUS, spacing_m, laps, np.random.default_rng(seed))


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_every_reachable_place_is_near_the_path(flat: GridMap, seed: int) -> None:
    places = reachable_space(World.of(flat), RADIUS).points
    away, _ = cKDTree(tour(flat, seed)).query(places)
    assert away.max() <= 1.5 + 0.3  # smoothing cuts the tips of the path


def test_each_lap_enters_every_room_and_is_a_new_path(flat: GridMap, flat_rooms: RoomTruth) -> None:
    both, first = tour(flat, 4, laps=2), tour(flat, 4, laps=1)
    # where a further lap follows, only the very end of the first one is smoothed differently
    assert np.abs(both[: len(first) - 40] - first[:-40]).max() < 0.1
    second = both[len(first) :]
    for lap in (first, second):
        assert set(flat_rooms.at(lap).tolist()) == {1, 2, 3, 4}
    away, _ = cKDTree(first).query(second)
    assert np.quantile(away, 0.75) > 0.15


def test_the_robot_fits_along_the_whole_path(office: GridMap) -> None:
    path = tour(office, 5)
    walls = office.centres_of(np.argwhere(~office.free))
    away, _ = cKDTree(walls).query(path)
    # distances to centres of cells; a point between two that fit may be half a cell nearer
    assert away.min() >= RADIUS - 0.025


def test_another_seed_is_another_route_and_the_same_seed_the_same(flat: GridMap) -> None:
    once, again, other = tour(flat, 6), tour(flat, 6), tour(flat, 7)
    np.testing.assert_array_equal(once, again)
    assert once.shape != other.shape or np.abs(once - other).max() > 0.5


def test_space_the_robot_cannot_reach_is_left_out() -> None:
    cells = np.full((60, 120), OCCUPIED, dtype=np.uint8)
    cells[2:58, 2:70] = FREE
    cells[2:58, 74:118] = FREE
    cells[30:36, 70:74] = FREE  # 0.3 m wide: too narrow for the robot
    space = reachable_space(World.of(GridMap(cells, 0.05)), RADIUS)
    assert space.points[:, 0].max() < 70 * 0.05
    assert space.area_m2 == pytest.approx(3.4 * 2.8 - 6.2 * 0.5, rel=0.1)


def test_a_plan_without_room_for_the_robot_is_refused() -> None:
    cells = np.full((40, 40), OCCUPIED, dtype=np.uint8)
    cells[10:14, 10:14] = FREE
    with pytest.raises(MapError, match=r"no free space for a robot of radius 0\.25 m"):
        reachable_space(World.of(GridMap(cells, 0.05)), RADIUS)


def length_of(distances: FloatArray, order: list[int]) -> float:
    return float(sum(distances[a, b] for a, b in pairwise(order)))


@given(seeds)
def test_orders_start_at_the_first_target_and_are_nearly_the_shortest(seed: int) -> None:
    points = np.random.default_rng(seed).uniform(0, 10, (7, 2))
    distances = np.linalg.norm(points[:, None] - points[None], axis=2)
    order = shortest_order(distances).tolist()
    assert order[0] == 0
    assert sorted(order) == list(range(7))
    best = min(length_of(distances, [0, *rest]) for rest in permutations(range(1, 7)))
    assert length_of(distances, order) <= 1.25 * best
    for i in range(1, 7):
        for j in range(i + 1, 8):
            other = order[:i] + order[i:j][::-1] + order[j:]
            assert length_of(distances, order) <= length_of(distances, other) + 1e-9


def rates(driven: Drive) -> tuple[FloatArray, FloatArray]:
    seconds = np.diff(driven.times_s)
    steps = np.diff(driven.poses, axis=0)
    return np.hypot(steps[:, 0], steps[:, 1]) / seconds, np.abs(steps[:, 2]) / seconds


def test_a_drive_keeps_speed_acceleration_and_turn_rate(flat: GridMap) -> None:
    path = tour(flat, 8)
    driven = drive(path, 0.7, 1.2)
    speeds, turns = rates(driven)
    assert (np.diff(driven.times_s) > 0).all()
    assert speeds.max() <= 0.7 + 1e-9
    assert turns.max() <= 1.2 + 1e-9
    length = np.hypot(*np.diff(path, axis=0).T).sum()
    assert driven.duration_s >= length / 0.7
    # 0.5 m/s^2, seen through speeds that are averages of neighbouring segments
    middle = 0.5 * (driven.times_s[:-1] + driven.times_s[1:])
    assert (np.abs(np.diff(speeds)) <= 0.5 * np.diff(middle) + 1e-6).mean() > 0.95
    away, _ = cKDTree(driven.poses[:, :2]).query(path)
    assert away.max() < 1e-9
    steps = np.diff(driven.poses[:, :2], axis=0)
    assert np.hypot(*steps.T).sum() == pytest.approx(length)


def test_the_robot_looks_where_it_drives_and_turns_in_place_at_corners() -> None:
    corner = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [1.0, 0.0]])
    driven = drive(corner, 1.0, 1.0)
    moving = np.hypot(*np.diff(driven.poses[:, :2], axis=0).T) > 1e-9
    headings = driven.poses[1:][moving][:, 2]
    np.testing.assert_allclose(headings, [0.0, np.pi / 2, -np.pi / 2], atol=1e-9)
    quarter = 1.5 * np.pi / 2
    assert driven.duration_s == pytest.approx(3 * 2 * np.sqrt(1.0 / 0.5) + 3 * quarter)


def test_a_path_of_one_place_is_a_robot_that_stands() -> None:
    driven = drive(np.array([[2.0, 3.0], [2.0, 3.0]]), 1.0, 1.0)
    assert driven.duration_s == 0.0
    np.testing.assert_array_equal(driven.at(np.array([0.0, 9.0])), [[2.0, 3.0, 0.0]] * 2)
