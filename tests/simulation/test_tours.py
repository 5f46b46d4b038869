"""Tours cover all reachable space, by paths on which the robot fits, in worlds and their rooms."""

from itertools import pairwise, permutations
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from specmap_cli.core.errors import MapError
from specmap_cli.core.geometry import FloatArray, path_length, step_lengths
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.simulation import tours
from specmap_cli.simulation.tours import drive, reachable_space
from specmap_cli.simulation.worlds import RoomTruth, World, read_rooms
from tests.strategies import seeds

RADIUS, COMFORT = 0.25, 0.8
SPEED, TURN_RATE, ACCELERATION = USUAL = (0.7, 1.2, 0.5)  # m/s, rad/s, m/s^2


def tour(plan: GridMap, seed: int, laps: int = 1, spacing_m: float = 1.5) -> FloatArray:
    world = World.of(plan)
    space = reachable_space(world, RADIUS, COMFORT)
    return tours.plan_tour(world, space, spacing_m, laps, np.random.default_rng(seed))


@pytest.mark.parametrize(("plan", "seed"), [("flat", 0), ("flat", 1), ("flat", 2), ("office", 5)])
def test_a_path_is_near_every_place_in_even_steps_where_the_robot_fits_wherever_the_plan_lies(
    plan: str, seed: int, request: pytest.FixtureRequest
) -> None:
    here: GridMap = request.getfixturevalue(plan)
    path = tour(here, seed)
    away, _ = cKDTree(path).query(reachable_space(World.of(here), RADIUS, COMFORT).points)
    assert away.max() <= 1.5 + 0.3  # smoothing cuts the tips of the path
    away, _ = cKDTree(here.centres_of(np.argwhere(~here.free))).query(path)
    # distances to centres of cells; a point between two that fit may be half a cell nearer
    assert away.min() >= RADIUS - 0.025
    steps = step_lengths(path)
    assert steps.max() <= 0.06
    assert np.quantile(steps, 0.02) > 0.03  # smoothing and the corners take some of it
    elsewhere = tour(GridMap(here.cells, here.resolution, (120.0, -7.5)), seed)
    np.testing.assert_allclose(elsewhere - (120.0, -7.5), path - here.origin, atol=1e-6)


def test_each_lap_enters_every_room_and_is_a_new_path(flat: GridMap, flat_rooms: RoomTruth) -> None:
    both, first = tour(flat, 4, laps=2), tour(flat, 4, laps=1)
    # where a further lap follows, only the very end of the first one is smoothed differently
    assert np.abs(both[: len(first) - 40] - first[:-40]).max() < 0.1
    second = both[len(first) :]
    for lap in (first, second):
        assert set(flat_rooms.at(lap).tolist()) == {1, 2, 3, 4}
    away, _ = cKDTree(first).query(second)
    assert np.quantile(away, 0.75) > 0.15


def test_space_the_robot_cannot_reach_is_left_out_and_a_plan_without_room_for_it_refused() -> None:
    cells = np.full((60, 120), OCCUPIED, dtype=np.uint8)
    cells[2:58, 2:70] = FREE
    cells[2:58, 74:118] = FREE
    cells[30:36, 70:74] = FREE  # 0.3 m wide: too narrow for the robot
    space = reachable_space(World.of(GridMap(cells, 0.05)), RADIUS, COMFORT)
    assert space.points[:, 0].max() < 70 * 0.05
    assert space.area_m2 == pytest.approx(3.4 * 2.8 - 6.2 * 0.5, rel=0.1)
    cells[:, :70] = cells[:, 74:] = OCCUPIED
    with pytest.raises(MapError, match=r"no free space for a robot of radius 0\.25 m"):
        reachable_space(World.of(GridMap(cells, 0.05)), RADIUS, COMFORT)


@given(seeds)
def test_orders_start_at_the_first_target_and_are_nearly_the_shortest(seed: int) -> None:
    points = np.random.default_rng(seed).uniform(0, 10, (7, 2))
    distances = np.linalg.norm(points[:, None] - points[None], axis=2)
    order = tours.shortest_order(distances).tolist()
    assert order[0] == 0
    assert sorted(order) == list(range(7))

    def length_of(order: list[int]) -> float:
        return float(sum(distances[a, b] for a, b in pairwise(order)))

    shortest = min(length_of([0, *rest]) for rest in permutations(range(1, 7)))
    assert length_of(order) <= 1.25 * shortest
    for i in range(1, 7):
        for j in range(i + 1, 8):
            assert length_of(order) <= length_of(order[:i] + order[i:j][::-1] + order[j:]) + 1e-9
    for expected in ([0], [0, 1], [0, 2, 1]):
        places = np.array([0.0, 5.0, 1.0])[: len(expected)]
        assert tours.shortest_order(np.abs(places[:, None] - places[None])).tolist() == expected


def winding(seed: int, points: int, step_m: float) -> FloatArray:
    """A path (N, 2) of equal steps whose heading wanders, now and then by a sharp corner."""
    rng = np.random.default_rng(seed)
    turns = np.where(rng.random(points) < 0.1, rng.uniform(-3.1, 3.1, points), 0.1)
    headings = np.cumsum(turns * rng.choice([-1, 1], points))
    steps = step_m * np.column_stack([np.cos(headings), np.sin(headings)])
    return np.concatenate([[[0.0, 0.0]], np.cumsum(steps, axis=0)])


@given(seeds, st.integers(2, 60), st.sampled_from([0.02, 0.3, 4.0]))
def test_a_drive_keeps_limits_and_passes_every_point(seed: int, points: int, step_m: float) -> None:
    path = winding(seed, points, step_m)
    driven = drive(path, *USUAL)
    seconds, turns = np.diff(driven.times_s), np.abs(np.diff(driven.poses[:, 2]))
    assert (seconds > 0).all()
    assert (step_lengths(driven.poses) / seconds).max() <= SPEED + 1e-9
    assert (turns / seconds).max() <= TURN_RATE + 1e-9
    away, _ = cKDTree(driven.poses[:, :2]).query(path)
    assert away.max() < 1e-9
    assert path_length(driven.poses) == pytest.approx(path_length(path))
    repeated = drive(np.repeat(path, 2, axis=0), *USUAL)  # which changes nothing
    np.testing.assert_array_equal(repeated.poses, driven.poses)
    np.testing.assert_array_equal(repeated.times_s, driven.times_s)


@pytest.mark.parametrize("length", [0.1, 0.98, 3.0, 50.0])
def test_a_straight_way_is_driven_as_fast_as_physics_lets(length: float) -> None:
    """Closed form: a triangle of speed over time, or a trapezium once the limit is reached."""
    v, a = SPEED, ACCELERATION
    peak = min(v, np.sqrt(a * length))
    for points in (2, 2000):
        path = np.column_stack([np.linspace(0.0, length, points), np.zeros(points)])
        assert drive(path, *USUAL).duration_s == pytest.approx(length / peak + peak / a, rel=2e-3)


def test_the_robot_looks_where_it_drives_and_turns_in_place_at_corners() -> None:
    corner = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [1.0, 0.0]])
    driven = drive(corner, 1.0, 1.0, 0.5)
    headings = driven.poses[1:][step_lengths(driven.poses) > 1e-9][:, 2]
    np.testing.assert_allclose(headings, [0.0, np.pi / 2, -np.pi / 2], atol=1e-9)
    # the ease of a turn is 1.5 times as steep in its middle as on average
    turning_s = 1.5 * (np.pi / 2 + np.pi)
    assert driven.duration_s == pytest.approx(3 * 2 * np.sqrt(1.0 / 0.5) + turning_s)
    gentle = drive(np.array([[0.0, 0.0], [2.0, 0.0], [4.0, 0.6]]), *USUAL)  # rounded without a stop
    assert len(gentle.times_s) == 3
    assert gentle.poses[1, 2] == pytest.approx(0.5 * np.arctan2(0.6, 2.0))


def test_a_path_of_one_place_is_a_robot_that_stands_as_before_the_start_and_after_the_end() -> None:
    for places in (1, 2, 5):
        driven = drive(np.array([[2.0, 3.0]] * places), *USUAL)
        assert driven.duration_s == 0.0
        np.testing.assert_array_equal(driven.at(np.array([0.0, 9.0])), [[2.0, 3.0, 0.0]] * 2)
    driven = drive(np.array([[0.0, 0.0], [1.0, 1.0]]), *USUAL)
    ends = driven.at(np.array([-5.0, 0.0, driven.duration_s, 1e6]))
    np.testing.assert_array_equal(ends[[0, 3]], ends[[1, 2]])
    np.testing.assert_allclose(ends[:, 2], np.pi / 4)


@pytest.mark.parametrize("kind", [str, Path])
def test_rooms_are_the_large_white_regions_of_a_picture(tmp_path: Path, kind: type) -> None:
    picture = np.zeros((60, 100), dtype=np.uint8)
    picture[5:25, 5:45] = 255  # the upper room: the higher y
    picture[35:55, 50:95] = 251
    picture[40:49, 10:20] = 255  # 90 pixels: not a room
    picture[35:55, 30:45] = 250  # not white enough
    cv2.imwrite(str(tmp_path / "rooms.png"), picture)
    rooms = read_rooms(kind(tmp_path / "rooms.png"), 0.1)
    assert rooms.count == 2
    points = np.array([[2.0, 4.5], [7.0, 1.5], [1.5, 1.5], [3.5, 1.5]])
    assert rooms.at(points, reach_m=0.05).tolist() == [1, 2, 0, 0]
    coloured = cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR)
    coloured[35:55, 50:95] = (255, 0, 0)  # read by its brightness
    cv2.imwrite(str(tmp_path / "rooms.png"), coloured)
    assert read_rooms(tmp_path / "rooms.png", 0.1).count == 1


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
