"""The matcher finds the pose a scan was taken from, near a guess and without one."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2, wrap_angle
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.grids.matching import (
    ScoreField,
    Window,
    covariance,
    refine,
    search,
    search_everywhere,
    thinned,
)


def wall(x0: float, y0: float, x1: float, y1: float) -> FloatArray:
    """Points every 4 cm along a wall."""
    n = int(np.hypot(x1 - x0, y1 - y0) / 0.04) + 1
    return np.column_stack([np.linspace(x0, x1, n), np.linspace(y0, y1, n)])


@pytest.fixture(scope="module")
def room() -> FloatArray:
    """An L-shaped room with a pillar: no symmetry."""
    corners = [(-3, -2), (4, -2), (4, 1), (1, 1), (1, 3), (-3, 3), (-3, -2)]
    sides = [wall(*a, *b) for a, b in itertools.pairwise(corners)]
    return np.concatenate([*sides, wall(2, -1, 2.4, -1), wall(2.4, -1, 2.4, -0.6)])


@pytest.fixture(scope="module")
def field(room: FloatArray) -> ScoreField:
    return ScoreField.from_points(room)


def assert_near(found: Pose2, true: Pose2, metres: float, radians: float) -> None:
    away = true.inverse() @ found
    assert away.distance < metres
    assert abs(away.theta) < radians


def test_values_are_those_of_the_distance_to_the_nearest_point(room: FloatArray) -> None:
    field = ScoreField.from_points(room, 0.05, 0.1)
    places = np.random.default_rng(1).uniform(-3.2, 4.2, (500, 2))
    distance, _ = cKDTree(room).query(places)
    expected = np.exp(-(distance**2) / (2 * 0.1**2))
    # both ends are rounded to cells of 5 cm
    nearest = np.exp(-(np.maximum(distance - 0.085, 0) ** 2) / (2 * 0.1**2))
    farthest = np.exp(-((distance + 0.085) ** 2) / (2 * 0.1**2))
    values = field.at(places)
    assert (values <= nearest + 1e-6).all()
    assert (values >= farthest - 3e-3).all()  # nought beyond 3.5 sigma of the walls
    assert np.abs(values - expected).mean() < 0.05


def test_field_of_a_grid_is_one_on_its_walls_and_starts_at_its_origin() -> None:
    cells = np.full((40, 60), FREE, dtype=np.uint8)
    cells[10, 5:50] = OCCUPIED
    grid = GridMap(cells, 0.05, (2.0, -1.0))
    field = ScoreField.from_grid(grid)
    on_wall = grid.centres_of(np.argwhere(grid.occupied))
    assert np.allclose(field.at(on_wall), 1.0)
    assert field.score(on_wall + (0.0, 0.5), IDENTITY) < 1e-3


def test_a_stray_point_far_away_costs_no_memory(room: FloatArray) -> None:
    stray = np.vstack([room, [[1e6, -1e6]]])
    field = ScoreField.from_points(stray, max_side=40.0)
    assert field.values.shape[0] < 900
    assert field.values.shape[1] < 900
    assert field.score(room, IDENTITY) > 0.95


def test_without_points_every_answer_is_the_guess(field: ScoreField) -> None:
    nothing = np.zeros((0, 2))
    guess = Pose2(1.0, 2.0, 0.3)
    assert search(field, nothing, guess, Window(1.0, 0.3, 0.1)).pose == guess
    assert refine(field, nothing, guess).pose == guess
    assert search_everywhere(field, nothing) == []
    assert ScoreField.from_points(nothing).score(np.ones((3, 2)), IDENTITY) == 0.0


@settings(max_examples=15, derandomize=True, deadline=None)
@given(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(-3.1, 3.1))
def test_a_scan_is_found_from_a_guess(
    field: ScoreField, room: FloatArray, dx: float, dy: float, turn: float, heading: float
) -> None:
    true = Pose2(0.4, -0.3, heading)
    scan = true.inverse().apply(room[::3])
    guess = Pose2(true.x + dx, true.y + dy, heading + turn)
    rough = search(field, scan, guess, Window(0.4, 0.35, 0.05))
    assert_near(rough.pose, true, 0.1, 0.05)
    # walls on the very edge of cells are drawn half a cell away
    assert_near(refine(field, scan, rough.pose).pose, true, 0.04, 0.01)


@pytest.mark.parametrize("heading", [-2.5, -0.4, 0.0, 1.3, 3.0])
def test_a_scan_is_found_without_a_guess(
    field: ScoreField, room: FloatArray, heading: float
) -> None:
    true = Pose2(6.0, -9.0, heading)
    scan = true.inverse().apply(room[::2])
    best, *others = search_everywhere(field, scan, count=3)
    assert_near(refine(field, scan, best.pose).pose, true, 0.05, 0.02)
    assert all(other.score < best.score for other in others)


def test_places_found_everywhere_are_apart(field: ScoreField, room: FloatArray) -> None:
    matches = search_everywhere(field, room[::2], count=4, apart=1.0)
    for k, a in enumerate(matches):
        for b in matches[:k]:
            centre = room[::2].mean(axis=0)[None, :]
            gap = np.hypot(*(a.pose.apply(centre) - b.pose.apply(centre))[0])
            assert gap >= 0.99 or abs(wrap_angle(a.pose.theta - b.pose.theta)) >= 0.29


def test_a_penalty_keeps_the_pose_near_the_guess() -> None:
    corridor = np.vstack([wall(-9, 0, 9, 0), wall(-9, 2, 9, 2)])
    field = ScoreField.from_points(corridor)
    scan = corridor[np.abs(corridor[:, 0]) < 4]
    window = Window(1.0, 0.1, 0.05, None, 0.1, 0.1)
    found = search(field, scan, Pose2(0.5, 0.1, 0.05), window)
    assert found.pose.x == pytest.approx(0.5, abs=0.06)
    assert found.pose.y == pytest.approx(0.0, abs=0.06)


def test_search_covers_the_whole_window_and_no_more(field: ScoreField, room: FloatArray) -> None:
    scan = room[::3]
    found = search(field, scan, Pose2(0.6, 0.0, 0.0), Window(0.3, 0.1, 0.1)).pose
    assert abs(found.x - 0.6) <= 0.3 + 1e-9
    assert abs(found.theta) <= 0.1 + 1e-9


def test_points_off_the_field_never_count(field: ScoreField) -> None:
    lone = np.array([[100.0, 100.0], [-200.0, 3.0], [50.0, -70.0]])
    assert search(field, lone, IDENTITY, Window(1.0, 0.3, 0.1)).score == 0.0


def test_refinement_never_makes_it_worse_nor_wanders(field: ScoreField, room: FloatArray) -> None:
    rng = np.random.default_rng(2)
    for _ in range(20):
        guess = Pose2(*rng.uniform(-1.0, 1.0, 3).tolist())
        match = refine(field, room[::4], guess, max_shift=0.3)
        assert (guess.inverse() @ match.pose).distance <= 0.3 + 1e-9


def test_covariance_is_long_along_a_corridor(field: ScoreField, room: FloatArray) -> None:
    corridor = np.vstack([wall(-9, 0, 9, 0), wall(-9, 2, 9, 2)])
    scan = corridor[np.abs(corridor[:, 0]) < 4]
    spread = covariance(ScoreField.from_points(corridor), scan, IDENTITY)
    assert spread[0, 0] > 20 * spread[1, 1]
    inside = covariance(field, room, IDENTITY)
    assert inside[0, 0] < 0.1 * spread[0, 0]
    assert np.linalg.eigvalsh(inside).min() >= 0.0


def test_the_coarser_field_is_nowhere_below_the_fine_one(field: ScoreField) -> None:
    coarse = field.coarser(4)
    places = np.random.default_rng(3).uniform(-4, 5, (2000, 2))
    assert (coarse.at(places) >= field.at(places)).all()


def test_the_sharper_field_has_half_the_sigma(room: FloatArray) -> None:
    wide, sharp = ScoreField.from_points(room, sigma=0.2), ScoreField.from_points(room, sigma=0.1)
    places = np.random.default_rng(4).uniform(-3, 3, (500, 2))
    assert np.allclose(wide.sharper().at(places), sharp.at(places), atol=1e-3)


@settings(max_examples=25, derandomize=True, deadline=None)
@given(st.integers(0, 200), st.floats(0.02, 1.0), st.sampled_from([2, 3]))
def test_thinning_keeps_one_point_a_cell(count: int, cell: float, dimensions: int) -> None:
    points = np.random.default_rng(count).uniform(-3, 3, (count, dimensions))
    kept = thinned(points, cell)
    cells = {tuple(row) for row in np.floor(points / cell).astype(int).tolist()}
    assert len(kept) == len(cells)
    assert {tuple(row) for row in np.floor(kept / cell).astype(int).tolist()} == cells
