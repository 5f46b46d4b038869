"""Score fields, the way to a match on them, its search and answers, and what walls fix."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import RegularGridInterpolator
from scipy.ndimage import distance_transform_edt
from scipy.optimize import minimize

from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2, wrap_angle
from specmap_cli.grids import matching
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.grids.matching import Prior, Window, answers, refine, search
from specmap_cli.grids.score_field import SIGMA_M, PointCells, Sample, ScoreField, approach, descend
from tests.strategies import few, grid_maps, poses, seeds
from tests.turning import turn

small = st.floats(-0.06, 0.06)


def wall(x0: float, y0: float, x1: float, y1: float) -> FloatArray:
    """Points every 4 cm along a wall."""
    n = int(np.hypot(x1 - x0, y1 - y0) / 0.04) + 1
    return np.column_stack([np.linspace(x0, x1, n), np.linspace(y0, y1, n)])


# an L-shaped room with a pillar: no symmetry
LINES: list[list[tuple[float, float]]] = [
    [(-3, -2), (4, -2), (4, 1), (1, 1), (1, 3), (-3, 3), (-3, -2)],
    [(2, -1), (2.4, -1), (2.4, -0.6)],
]
ROOM = np.concatenate([wall(*a, *b) for line in LINES for a, b in itertools.pairwise(line)])
FIELD = ScoreField.from_points(ROOM)


@pytest.mark.parametrize("longest", [100.0, 5.0])
def test_walls_in_parts_make_the_field_of_all(longest: float) -> None:
    parts = [ROOM[:40], np.zeros((0, 2)), ROOM[40:] + (0.3, -2.0), np.array([[9.0, 2.0]])]
    together = PointCells.of(np.vstack(parts), 0.075)
    whole = ScoreField.from_cells([together], 0.1, longest, (0.5, 0.2))
    cells = [PointCells.of(part, 0.075) for part in parts]
    field = ScoreField.from_cells(cells, 0.1, longest, (0.5, 0.2))
    assert np.array_equal(field.values, whole.values)
    assert (field.origin, field.left_out) == (whole.origin, whole.left_out)
    assert (field.left_out > 0) == (longest < 10.0)


@given(seeds)
def test_walls_drawn_into_a_field_make_the_field_of_all(seed: int) -> None:
    rng = np.random.default_rng(seed)
    edges = np.array([[-4.0, -3.0], [4.0, 3.0]])
    parts = [edges, rng.uniform(-3, 3, (40, 2)), rng.uniform(-2.5, 2.5, (200, 2))]
    before, more, last = (PointCells.of(part, 0.075) for part in parts)
    whole = ScoreField.from_cells([before, more, last], 0.1, 100.0, (0.0, 0.0))
    start = ScoreField.from_cells([before], 0.1, 100.0, (0.0, 0.0))
    unchanged = start.values.copy()
    field = start.with_cells(more, 0.1)
    assert field is not None
    drawn = field.with_cells(last, 0.1)
    assert drawn is not None
    near = whole.values > 3e-3  # within the reach of a wall: the same to the last bit
    assert np.array_equal(drawn.values[near], whole.values[near])
    assert (drawn.values <= whole.values).all()
    assert np.array_equal(start.values, unchanged)


@pytest.mark.parametrize("place", [(4.3, 0.0), (0.0, -3.3), (1e6, 0.0)])
def test_walls_at_the_edge_of_a_field_or_beyond_cannot_be_drawn(place: tuple[float, float]) -> None:
    edges = PointCells.of(np.array([[-4.0, -3.0], [4.0, 3.0]]), 0.075)
    field = ScoreField.from_cells([edges], 0.1, 100.0, (0.0, 0.0))
    inside, outside = ([[0.0, 0.0]], [[0.0, 0.0], place])
    assert field.with_cells(PointCells.of(np.array(inside), 0.075), 0.1) is not None
    assert field.with_cells(PointCells.of(np.array(outside), 0.075), 0.1) is None
    assert field.with_cells(PointCells.of(np.zeros((0, 2)), 0.075), 0.1) is field


def test_the_sharper_field_has_half_the_sigma() -> None:
    wide, sharp = ScoreField.from_points(ROOM, sigma=0.2), ScoreField.from_points(ROOM, sigma=0.1)
    places = np.random.default_rng(4).uniform(-3, 3, (500, 2))
    assert np.allclose(wide.sharper().at(places), sharp.at(places), atol=1e-3)


@given(grid_maps(), st.sampled_from([0.05, 0.1, 0.3]))
def test_the_field_of_a_grid_is_the_score_of_exact_distances(grid: GridMap, sigma: float) -> None:
    field = ScoreField.from_grid(grid, sigma)
    margin = math.ceil(3.5 * sigma / grid.resolution)
    if not grid.occupied.any():
        assert not field.values.any()
        return
    distance = distance_transform_edt(np.pad(~grid.occupied, margin, constant_values=True))
    metres = distance * grid.resolution
    near = np.exp(-((0.97 * metres) ** 2) / (2.0 * sigma**2))  # OpenCV's distance is off by 2 %
    far = np.exp(-((1.03 * metres) ** 2) / (2.0 * sigma**2))
    assert (field.values <= near + 1e-6).all()
    assert (field.values >= far - 1e-6).all()
    assert field.origin == pytest.approx(np.array(grid.origin) - margin * grid.resolution)


@given(poses, seeds)
def test_a_score_is_the_mean_of_the_values_under_the_points(pose: Pose2, seed: int) -> None:
    points = np.random.default_rng(seed).uniform(-2, 2, (40, 2))
    field = ScoreField.from_points(pose.apply(points), 0.05, 0.2)
    cells = np.floor((pose.apply(points) - field.origin) / field.resolution).astype(int)
    mean = sum(float(field.values[row, column]) for column, row in cells.tolist()) / len(points)
    assert field.score(points, pose) == pytest.approx(mean)
    assert field.score(points, pose) == pytest.approx(1.0)  # they are its obstacles
    assert field.score(points[:0], pose) == 0.0


def test_outside_a_field_all_is_nought() -> None:
    height, width = FIELD.values.shape
    right, top = FIELD.resolution * width, FIELD.resolution * height
    places = FIELD.origin + np.array([[-0.01, 1.0], [1.0, -0.01], [right, 1.0], [1.0, top]])
    assert not FIELD.at(places).any()
    edge = np.concatenate([FIELD.values[0], FIELD.values[-1], FIELD.values[:, 0]])
    assert edge.max() < 0.003  # so that nothing jumps where the field ends


@given(seeds, st.integers(1, 7))
def test_a_coarser_cell_is_the_best_of_the_cells_in_it(seed: int, factor: int) -> None:
    rng = np.random.default_rng(seed)
    values = rng.random((rng.integers(1, 20), rng.integers(1, 20)), dtype=np.float32)
    coarse = ScoreField(values, 0.1, (1.0, 2.0), 3).coarser(factor)
    height, width = values.shape
    assert coarse.values.shape == (-(-height // factor), -(-width // factor))
    assert (coarse.resolution, coarse.origin, coarse.left_out) == (0.1 * factor, (1.0, 2.0), 3)
    for row, column in np.ndindex(*coarse.values.shape):
        block = values[row * factor : (row + 1) * factor, column * factor : (column + 1) * factor]
        assert coarse.values[row, column] == block.max()


def test_points_too_far_from_the_others_are_counted() -> None:
    for stray in (0, 1, 7):
        far = np.column_stack([np.full(stray, 500.0), 900.0 + np.arange(stray)])
        field = ScoreField.from_points(np.vstack([ROOM, far]), max_side=40.0)
        assert field.left_out == field.sharper().left_out == stray
        assert not field.at(far).any()
    assert ScoreField.from_points(ROOM, max_side=1.0).left_out > 0
    assert ScoreField.from_points(ROOM[:0]).left_out == 0


@given(seeds, st.floats(1.0, 30.0))
def test_a_field_is_no_larger_than_told_and_shows_what_is_near(seed: int, max_side: float) -> None:
    points = np.random.default_rng(seed).standard_cauchy((200, 2)) * 3.0
    field = ScoreField.from_points(points, 0.1, 0.1, max_side)
    assert max(field.values.shape) <= max_side / 0.1 + 2 * math.ceil(3.5) + 2
    near = (np.abs(points - np.median(points, axis=0)) < max_side / 2).all(axis=1)
    assert (field.at(points[near]) == 1.0).all()
    assert field.left_out <= (~near).sum()


def cost(field: ScoreField, points: FloatArray, pose: Pose2) -> float:
    """Sum (1 - M(p))^2."""
    return float(((1.0 - Sample.of(field, points.T, pose).values) ** 2).sum())


@given(seeds)
def test_values_are_scipy_s_and_their_derivatives_those_of_finite_differences(seed: int) -> None:
    rng = np.random.default_rng(seed)
    field = ScoreField(rng.random((9, 13), dtype=np.float32), 0.5, (-1.0, 2.0))
    pose, points = Pose2(*rng.uniform(-1, 1, 3).tolist()), rng.uniform(-3, 9, (50, 2))
    height, width = field.values.shape
    centres = 2.25 + 0.5 * np.arange(height), -0.75 + 0.5 * np.arange(width)
    oracle = RegularGridInterpolator(centres, field.values, bounds_error=False, fill_value=0.0)
    values = Sample.of(field, points.T, pose).values
    np.testing.assert_allclose(values, oracle(pose.apply(points)[:, ::-1]), atol=1e-6)
    points, step = rng.uniform(0, 5, (50, 2)), 1e-5
    jacobian = Sample.of(field, points.T, pose).equations()[:3]
    for axis, derivative in zip(np.eye(3), jacobian, strict=True):
        ahead, behind = (
            Sample.of(field, points.T, Pose2(*(pose + way * axis).tolist())).values
            for way in (step, -step)
        )
        smooth = np.abs((ahead - behind) / (2 * step) - derivative) < 0.02
        assert smooth.mean() >= 0.95  # all but those that pass from cell to cell in the step


@given(small, small, small)
def test_the_descent_ends_as_scipy_s_and_the_way_near_it(dx: float, dy: float, turn: float) -> None:
    guess, points = Pose2(dx, dy, turn), ROOM[::5]
    found = descend(FIELD, points, guess, 20, 0.3)
    best = minimize(
        lambda pose: cost(FIELD, points, Pose2(*pose)),
        np.array(guess),
        method="Nelder-Mead",
        options={"initial_simplex": np.array(guess) + 0.02 * np.vstack([np.zeros(3), np.eye(3)])},
    )
    assert cost(FIELD, points, found) <= best.fun + 0.01
    found = approach(FIELD, points, guess, SIGMA_M)
    match = descend(FIELD, points, found, 30, 0.3)
    assert math.dist(found[:2], match[:2]) < 0.01
    assert found.theta == pytest.approx(match.theta, abs=0.005)


@given(seeds, st.floats(0.0, 0.5), st.integers(0, 6))
def test_the_descent_improves_within_its_reach(seed: int, reach: float, iterations: int) -> None:
    guess = Pose2(*np.random.default_rng(seed).uniform(-1.0, 1.0, 3).tolist())
    found = descend(FIELD, ROOM[::5], guess, iterations, reach)
    assert (guess.inverse() @ found).distance <= reach + 1e-9
    assert cost(FIELD, ROOM[::5], found) <= cost(FIELD, ROOM[::5], guess) + 1e-9
    if not iterations:
        assert found == pytest.approx(guess)


def test_too_few_points_or_cells_leave_the_guess_as_it_is() -> None:
    guess = Pose2(0.1, 0.2, 0.3)
    for points in range(3):
        assert descend(FIELD, np.zeros((points, 2)), guess, 20, 0.3) == guess
        assert approach(FIELD, np.zeros((points, 2)), guess, SIGMA_M) == guess
    speck = ScoreField(np.ones((1, 1), dtype=np.float32), 0.1, (0.0, 0.0))
    guess = Pose2(0.01, 0.02, 0.0)
    assert descend(speck, np.random.default_rng(0).random((9, 2)), guess, 20, 0.3) == guess


def test_the_way_follows_what_half_a_sigma_tells_apart() -> None:
    wall = np.column_stack([np.linspace(-4.0, 4.0, 400), np.full(400, 0.025)])
    double = np.vstack([wall, wall + (0.0, 0.15)])  # its second one, a sigma and a half behind it
    near = approach(ScoreField.from_points(double), wall[100:300], Pose2(0.0, 0.03, 0.0), SIGMA_M)
    assert near.y == pytest.approx(0.0, abs=0.01)


def test_along_a_bare_corridor_the_way_stays_at_the_guess() -> None:
    rng = np.random.default_rng(0)
    x = rng.uniform(-4.0, 4.0, 300)
    walls = np.column_stack([x, np.where(x * 1e3 % 1.0 < 0.5, 0.025, 2.025)])
    field = ScoreField.from_points(walls)
    seen = walls[np.abs(x) < 3.0] + rng.normal(0.0, 0.01, 2)
    found = approach(field, seen, Pose2(0.3, 0.05, 0.02), SIGMA_M)
    assert found.x == pytest.approx(0.3, abs=0.05)
    assert found.y == pytest.approx(0.0, abs=0.02)


WIDE = Window(distance_m=1.0, angle_rad=0.3, step_m=0.1)
NARROW = Window(distance_m=0.3, angle_rad=0.1, step_m=0.1)
BEARINGS = np.linspace(-math.pi, math.pi, 720, endpoint=False)


def assert_near(found: Pose2, true: Pose2, metres: float, radians: float) -> None:
    away = true.inverse() @ found
    assert away.distance < metres
    assert abs(away.theta) < radians


def test_without_points_on_the_field_every_answer_is_the_guess() -> None:
    nothing = np.zeros((0, 2))
    guess = Pose2(1.0, 2.0, 0.3)
    assert search(FIELD, nothing, guess, WIDE).pose == guess
    assert refine(FIELD, nothing, guess).pose == guess
    assert matching.search_everywhere(FIELD, nothing, 1, 0.2, [0.0]) == []
    assert ScoreField.from_points(nothing).score(np.ones((3, 2)), IDENTITY) == 0.0
    lone = np.array([[100.0, 100.0], [-200.0, 3.0], [50.0, -70.0]])
    assert search(FIELD, lone, IDENTITY, WIDE).score == 0.0


@few(15)
@given(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(-3.1, 3.1))
def test_a_scan_is_found_from_a_guess(dx: float, dy: float, turn: float, heading: float) -> None:
    true = Pose2(0.4, -0.3, heading)
    scan = true.inverse().apply(ROOM[::3])
    guess = Pose2(true.x + dx, true.y + dy, heading + turn)
    rough = search(FIELD, scan, guess, Window(distance_m=0.4, angle_rad=0.35, step_m=0.05))
    assert_near(rough.pose, true, 0.1, 0.05)
    # walls on the very edge of cells are drawn half a cell away
    assert_near(refine(FIELD, scan, rough.pose).pose, true, 0.04, 0.01)


@pytest.mark.parametrize("heading", [-2.5, -0.4, 0.0, 1.3, 3.0])
def test_a_scan_is_found_without_a_guess_and_places_are_apart(heading: float) -> None:
    true = Pose2(6.0, -9.0, heading)
    scan = true.inverse().apply(ROOM[::2])
    angles = np.arange(0.0, 2.0 * np.pi, 0.05)
    found = matching.search_everywhere(FIELD, scan, count=5, step=0.2, angles=angles)
    assert len(found) == 5
    best, *others = found
    assert_near(refine(FIELD, scan, best.pose).pose, true, 0.05, 0.02)
    assert all(other.score < best.score for other in others)
    centre = scan.mean(axis=0)[None, :]
    for a, b in itertools.combinations(found, 2):
        gap = np.hypot(*(a.pose.apply(centre) - b.pose.apply(centre))[0])
        assert gap >= 0.99 or abs(wrap_angle(a.pose.theta - b.pose.theta)) >= 0.29
    for match in found:  # scores are never below the true ones
        assert match.score <= 1.0
        assert 0.0 <= FIELD.score(scan, match.pose) <= match.score + 1e-9
        assert search(FIELD, scan, match.pose, NARROW).score >= FIELD.score(scan, match.pose)


def test_a_place_beyond_either_end_of_the_field_is_found_and_ties_go_to_the_first() -> None:
    field = ScoreField.from_points(np.array([[1.0, 2.0]]), 0.1)
    two = np.array([[-3.0, -3.0], [3.0, 3.0]])  # one of them on the point, the other off the field
    found = matching.search_everywhere(field, two, count=2, step=0.1, angles=[0.0])
    places = [(match.pose.x, match.pose.y) for match in found]
    assert places == [pytest.approx((-2.0, -1.0), abs=0.1), pytest.approx((4.0, 5.0), abs=0.1)]
    assert found[0].score == pytest.approx(found[1].score) == pytest.approx(0.5, abs=0.02)


def lattice(window: Window, resolution: float, turns: int) -> list[tuple[float, float, float]]:
    """Every pose of a window: shifts in cells, angles either way."""
    stride = round(window.step_m / resolution)
    n = round(window.distance_m / resolution) // stride
    shifts = stride * resolution * np.arange(-n, n + 1)
    angles = window.angle_rad * np.arange(-turns, turns + 1) / max(turns, 1)
    return [(x, y, a) for x in shifts for y in shifts for a in angles]


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


def test_of_poses_that_fit_alike_the_search_takes_the_nearest() -> None:
    corridor = np.vstack([wall(-9, 0, 9, 0), wall(-9, 2, 9, 2)])
    field = ScoreField.from_points(corridor)
    middle = corridor[np.abs(corridor[:, 0]) < 2]
    for place in (field, ScoreField(np.zeros((50, 50), dtype=np.float32), 0.1, (0.0, 0.0))):
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
    expected = np.cov(offsets.T, aweights=np.exp((scores - scores.max()) / 0.05), ddof=0)
    turn("grids", spread_temperature=0.05, spread_m=reach, spread_rad=angle)
    found = matching.covariance(field, points, pose)
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-9)


def box(length_m: float, width_m: float, range_m: float, noise_m: float) -> FloatArray:
    """What a laser in the middle of a box sees, its long side along x."""
    rng = np.random.default_rng(0)
    to_end = 0.5 * length_m / np.maximum(np.abs(np.cos(BEARINGS)), 1e-9)
    ranges = np.minimum(to_end, 0.5 * width_m / np.maximum(np.abs(np.sin(BEARINGS)), 1e-9))
    seen = ranges < range_m
    ranges = ranges + rng.normal(0.0, noise_m, len(ranges))
    return np.column_stack([ranges * np.cos(BEARINGS), ranges * np.sin(BEARINGS)])[seen]


@pytest.mark.parametrize("noise_m", [0.0, 0.01, 0.03])
@pytest.mark.parametrize("width_m", [1.5, 2.5])
@pytest.mark.parametrize("turn", [0.0, 0.7, -2.0])
def test_a_bare_corridor_is_open_along_itself(noise_m: float, width_m: float, turn: float) -> None:
    points = Pose2(0.0, 0.0, turn).apply(box(60.0, width_m, 8.0, noise_m))
    weakest = matching.weakest_direction(points)
    assert weakest.count < 0.01 * len(points)
    assert abs(math.sin(weakest.heading - turn)) < 0.05
    along = weakest.fisher[:2, :2] @ (math.cos(turn), math.sin(turn))
    assert np.abs(along).max() < 0.05 * np.trace(weakest.fisher[:2, :2])


@pytest.mark.parametrize("noise_m", [0.0, 0.01, 0.03])
def test_an_end_in_sight_closes_it_and_a_square_fixes_all_directions_alike(noise_m: float) -> None:
    assert (ends := matching.weakest_direction(box(12.0, 2.5, 8.0, noise_m))).count > 5.0
    square = matching.weakest_direction(points := box(5.0, 5.0, 10.0, noise_m))
    assert square.count == pytest.approx(0.45 * len(points), rel=0.15)
    assert square.precision_m(0.05) == pytest.approx(0.05 / math.sqrt(square.count))
    assert ends.precision_m(0.05) > 1.8 * square.precision_m(0.05)
    for count in range(3):  # too few points fix nothing
        assert matching.weakest_direction(np.ones((count, 2))).count == 0.0


def test_walls_that_are_not_known_fix_nothing() -> None:
    """The ends of a corridor that only now come into sight do not say how far the robot came."""
    points = box(12.0, 2.5, 8.0, 0.0)
    known = (np.abs(points[:, 1]) > 1.2).astype(np.float64)
    known[np.abs(points[:, 0]) > 5.9] = 0.0
    assert matching.weakest_direction(points, known).count < 0.02 * len(points)
    whole, less = (matching.weakest_direction(points, np.full(len(points), of)) for of in (1, 0.5))
    assert less.count == pytest.approx(0.5 * whole.count)
    assert less.heading == pytest.approx(whole.heading)


def scatter(seed: int) -> FloatArray:
    """Random walls of a small place."""
    return np.random.default_rng(seed).uniform(-4.0, 4.0, (60, 2))


@few(8)
@given(seeds)
def test_a_place_within_the_prior_is_the_first_answer(seed: int) -> None:
    rng, points = np.random.default_rng(seed), scatter(seed)
    there = Pose2(*rng.uniform((-9.0, -9.0, -3.0), (9.0, 9.0, 3.0)).tolist())
    field = ScoreField.from_points(there.apply(points), 0.1, 0.15)
    off = rng.uniform(-1.0, 1.0, 3) * (5.0, 1.0, 0.4)
    guess = Pose2(there.x + off[0], there.y + off[1], there.theta + off[2])
    found = answers(field, points, Prior(guess, np.diag([2.0, 0.6, 0.2]) ** 2), 0.3, 0.04)
    assert np.hypot(found[0].pose.x - there.x, found[0].pose.y - there.y) < 0.5
    assert abs(wrap_angle(found[0].pose.theta - there.theta)) < 0.06
    assert [one.score for one in found] == sorted((one.score for one in found), reverse=True)


def test_two_places_alike_are_two_answers_and_the_prior_leaves_one() -> None:
    points = scatter(3)
    field = ScoreField.from_points(np.concatenate([points, points + (0.0, 12.0)]), 0.1, 0.15)
    wide = Prior(Pose2(0.0, 6.0, 0.0), np.diag([0.3, 3.0, 0.05]) ** 2)
    first, second = sorted(one.pose.y for one in answers(field, points, wide, 0.3, 0.04)[:2])
    assert [first, second] == pytest.approx([0.0, 12.0], abs=0.4)
    narrow = Prior(Pose2(0.0, 11.0, 0.0), np.diag([0.3, 1.0, 0.05]) ** 2)
    assert all(one.pose.y > 7.0 for one in answers(field, points, narrow, 0.3, 0.04))


def test_where_no_wall_is_there_is_no_answer() -> None:
    field = ScoreField.from_points(scatter(1), 0.1, 0.15)
    prior = Prior(Pose2(90.0, 0.0, 0.0), np.diag([0.3, 0.3, 0.05]) ** 2)
    assert answers(field, scatter(1), prior, 0.3, 0.04) == []


def test_a_guess_turns_as_far_as_its_error() -> None:
    angles = Prior(Pose2(10.0, 5.0, 0.5), np.diag([4.0, 0.01, 0.1**2])).angles(0.05)
    assert angles.min() == pytest.approx(0.2, abs=0.051)
    assert angles.max() == pytest.approx(0.8, abs=0.051)
    unknown = Prior(Pose2(0.0, 0.0, 0.0), np.diag([1.0, 1.0, 100.0]))
    assert np.ptp(unknown.angles(0.1)) == pytest.approx(2 * np.pi, abs=0.2)
