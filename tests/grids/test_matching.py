"""The matcher finds the pose a scan was taken from; which directions walls fix."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2, wrap_angle
from specmap_cli.grids import matching
from specmap_cli.grids.matching import Window, refine, search
from specmap_cli.grids.score_field import ScoreField
from tests.strategies import few, seeds
from tests.turning import turn

WIDE = Window(distance_m=1.0, angle_rad=0.3, step_m=0.1)
NARROW = Window(distance_m=0.3, angle_rad=0.1, step_m=0.1)
BEARINGS = np.linspace(-math.pi, math.pi, 720, endpoint=False)


def assert_near(found: Pose2, true: Pose2, metres: float, radians: float) -> None:
    away = true.inverse() @ found
    assert away.distance < metres
    assert abs(away.theta) < radians


def test_without_points_on_the_field_every_answer_is_the_guess(field: ScoreField) -> None:
    nothing = np.zeros((0, 2))
    guess = Pose2(1.0, 2.0, 0.3)
    assert search(field, nothing, guess, WIDE).pose == guess
    assert refine(field, nothing, guess).pose == guess
    assert matching.search_everywhere(field, nothing, 1, 0.2, 0.05) == []
    assert ScoreField.from_points(nothing).score(np.ones((3, 2)), IDENTITY) == 0.0
    lone = np.array([[100.0, 100.0], [-200.0, 3.0], [50.0, -70.0]])
    assert search(field, lone, IDENTITY, WIDE).score == 0.0


@few(15)
@given(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(-3.1, 3.1))
def test_a_scan_is_found_from_a_guess(
    field: ScoreField, room: FloatArray, dx: float, dy: float, turn: float, heading: float
) -> None:
    true = Pose2(0.4, -0.3, heading)
    scan = true.inverse().apply(room[::3])
    guess = Pose2(true.x + dx, true.y + dy, heading + turn)
    rough = search(field, scan, guess, Window(distance_m=0.4, angle_rad=0.35, step_m=0.05))
    assert_near(rough.pose, true, 0.1, 0.05)
    # walls on the very edge of cells are drawn half a cell away
    assert_near(refine(field, scan, rough.pose).pose, true, 0.04, 0.01)


@pytest.mark.parametrize("heading", [-2.5, -0.4, 0.0, 1.3, 3.0])
def test_a_scan_is_found_without_a_guess_and_places_are_apart(
    field: ScoreField, room: FloatArray, heading: float
) -> None:
    true = Pose2(6.0, -9.0, heading)
    scan = true.inverse().apply(room[::2])
    found = matching.search_everywhere(field, scan, count=5, step=0.2, angle_step=0.05)
    assert len(found) == 5
    best, *others = found
    assert_near(refine(field, scan, best.pose).pose, true, 0.05, 0.02)
    assert all(other.score < best.score for other in others)
    centre = scan.mean(axis=0)[None, :]
    for a, b in itertools.combinations(found, 2):
        gap = np.hypot(*(a.pose.apply(centre) - b.pose.apply(centre))[0])
        assert gap >= 0.99 or abs(wrap_angle(a.pose.theta - b.pose.theta)) >= 0.29
    for match in found:  # scores are never below the true ones
        assert match.score <= 1.0
        assert 0.0 <= field.score(scan, match.pose) <= match.score + 1e-9
        near = search(field, scan, match.pose, NARROW)
        assert near.score >= field.score(scan, match.pose)


def test_a_penalty_keeps_the_pose_near_the_guess(corridor: FloatArray) -> None:
    field = ScoreField.from_points(corridor)
    scan = corridor[np.abs(corridor[:, 0]) < 4]
    window = Window(
        distance_m=1.0, angle_rad=0.1, step_m=0.05, penalty_per_m2=0.1, penalty_per_rad2=0.1
    )
    found = search(field, scan, Pose2(0.5, 0.1, 0.05), window)
    assert found.pose.x == pytest.approx(0.5, abs=0.06)
    assert found.pose.y == pytest.approx(0.0, abs=0.06)


def test_covariance_is_long_along_a_corridor(
    field: ScoreField, room: FloatArray, corridor: FloatArray
) -> None:
    scan = corridor[np.abs(corridor[:, 0]) < 4]
    spread = matching.covariance(ScoreField.from_points(corridor), scan, IDENTITY)
    assert spread[0, 0] > 20 * spread[1, 1]
    inside = matching.covariance(field, room, IDENTITY)
    assert inside[0, 0] < 0.1 * spread[0, 0]
    assert np.linalg.eigvalsh(inside).min() >= 0.0


def lattice(window: Window, resolution: float, turns: int) -> list[tuple[float, float, float]]:
    """Every pose of a window, those nearest the guess first: shifts in cells, angles either way."""
    stride = round(window.step_m / resolution)
    n = round(window.distance_m / resolution) // stride
    shifts = stride * resolution * np.arange(-n, n + 1)
    angles = window.angle_rad * np.arange(-turns, turns + 1) / max(turns, 1)
    poses = [(x, y, a) for x in shifts for y in shifts for a in angles]
    return sorted(poses, key=lambda pose: (abs(pose[2]), pose[0] ** 2 + pose[1] ** 2))


@given(seeds, st.sampled_from([0.0, 0.4]))
@few(12)
def test_the_search_finds_what_trying_every_pose_finds(seed: int, penalty: float) -> None:
    rng = np.random.default_rng(seed)
    resolution = 0.0625  # a power of two, so that shifts by whole cells are exact
    field = ScoreField.from_points(rng.uniform(-2.0, 2.0, (60, 2)), resolution)
    points, guess = rng.uniform(-1.5, 1.5, (25, 2)), Pose2(*rng.uniform(-0.5, 0.5, 3).tolist())
    window = Window(
        distance_m=4 * resolution,
        angle_rad=0.2,
        step_m=2 * resolution,
        angle_step_rad=0.1,
        penalty_per_m2=penalty,
        penalty_per_rad2=penalty,
    )
    values = [
        field.score(points, Pose2(guess.x + x, guess.y + y, guess.theta + a))
        - penalty * (x**2 + y**2 + a**2)
        for x, y, a in lattice(window, resolution, 2)
    ]
    found = search(field, points, guess, window)
    assert found.score == pytest.approx(field.score(points, found.pose), abs=1e-6)
    moved = np.array(found.pose) - guess
    assert found.score - penalty * (moved**2).sum() == pytest.approx(max(values), abs=1e-6)


def test_of_poses_that_fit_alike_the_search_takes_the_nearest(corridor: FloatArray) -> None:
    field = ScoreField.from_points(corridor)
    middle = corridor[np.abs(corridor[:, 0]) < 2]
    empty = ScoreField(np.zeros((50, 50), dtype=np.float32), 0.1, (0.0, 0.0))
    for place in (field, empty):
        guess = Pose2(0.013, 0.0, 0.0)
        assert search(place, middle, guess, NARROW).pose == guess


@given(seeds)
@few(8)
def test_covariance_is_that_of_weights_summed_pose_by_pose(seed: int) -> None:
    rng = np.random.default_rng(seed)
    resolution = 0.0625
    field = ScoreField.from_points(rng.uniform(-2.0, 2.0, (60, 2)), resolution)
    points, pose = rng.uniform(-1.5, 1.5, (25, 2)), Pose2(*rng.uniform(-0.5, 0.5, 3).tolist())
    reach, angle = 6 * resolution, 0.06
    window = Window(distance_m=reach, angle_rad=angle, step_m=resolution)
    offsets = np.array(lattice(window, resolution, 6))
    scores = np.array([field.score(points, Pose2(*(pose + o).tolist())) for o in offsets])
    weights = np.exp((scores - scores.max()) / 0.05)
    expected = np.cov(offsets.T, aweights=weights, ddof=0)
    turn("grids", spread_temperature=0.05, spread_m=reach, spread_rad=angle)
    found = matching.covariance(field, points, pose)
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-9)


def box(length_m: float, width_m: float, range_m: float, noise_m: float) -> FloatArray:
    """What a laser in the middle of a box sees, its long side along x."""
    rng = np.random.default_rng(0)
    to_end = 0.5 * length_m / np.maximum(np.abs(np.cos(BEARINGS)), 1e-9)
    to_side = 0.5 * width_m / np.maximum(np.abs(np.sin(BEARINGS)), 1e-9)
    ranges = np.minimum(to_end, to_side)
    seen = ranges < range_m
    ranges = ranges + rng.normal(0.0, noise_m, len(ranges))
    return np.column_stack([ranges * np.cos(BEARINGS), ranges * np.sin(BEARINGS)])[seen]


@pytest.mark.parametrize("noise_m", [0.0, 0.01, 0.03])
@pytest.mark.parametrize("width_m", [1.5, 2.5])
@pytest.mark.parametrize("turn", [0.0, 0.7, -2.0])
def test_a_bare_corridor_is_open_along_itself(noise_m: float, width_m: float, turn: float) -> None:
    points = Pose2(0.0, 0.0, turn).apply(box(60.0, width_m, 8.0, noise_m))
    weakest = matching.weakest_direction(points)
    assert weakest.open
    assert abs(math.sin(weakest.heading - turn)) < 0.05


@pytest.mark.parametrize("noise_m", [0.0, 0.01, 0.03])
def test_an_end_in_sight_closes_it_and_a_square_room_fixes_all_directions_alike(
    noise_m: float,
) -> None:
    assert not matching.weakest_direction(box(12.0, 2.5, 8.0, noise_m)).open
    square = matching.weakest_direction(box(5.0, 5.0, 10.0, noise_m))
    assert square.share == pytest.approx(0.5, abs=0.06)
    for count in range(3):  # too few points fix nothing
        assert matching.weakest_direction(np.ones((count, 2))).open
