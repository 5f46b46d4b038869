"""Branch and bound against a search of every cell and angle; places among the walls of a map."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import BoolArray
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.grids.score_field import ScoreField
from specmap_cli.layout.path_graph import Graph
from specmap_cli.layout.place_search import Guess, Pyramid, WallMap, Wanted, best_places
from specmap_cli.layout.walls import Walls
from tests.layout.driving import missed
from tests.strategies import angles, few, seeds
from tests.turning import turned

ANGLES = np.arange(0.0, 2 * np.pi, 0.4)
CELL_M = 0.25
ALL = Wanted(least=0.0, lead=0.0, most=10**6)


def scatter(seed: int, count: int = 40, side_m: float = 9.0) -> FloatArray:
    """Random walls of a small map."""
    return np.random.default_rng(seed).uniform(0.0, side_m, (count, 2))


def field_of(points: FloatArray) -> ScoreField:
    """Their field in coarse cells."""
    return ScoreField.from_points(points, CELL_M, 0.3)


def tried_everywhere(
    field: ScoreField, points: FloatArray, angles: FloatArray, free: BoolArray | None = None
) -> float:
    """The best score of points on all cells of the field at all angles, one by one.

    The robot, at the origin of the points, stands in a free cell.
    """
    bytes_ = np.pad(np.round(field.values * 255).astype(int), 200)
    allowed = np.ones(bytes_.shape, dtype=bool) if free is None else np.pad(free, 200)
    middle, best = points.mean(axis=0), 0.0
    for angle in angles.tolist():
        turn = Pose2(0.0, 0.0, angle)
        x, y = np.round(turn.apply(points - middle) / CELL_M).astype(int).T
        across, down = np.round(turn.apply(-middle[None])[0] / CELL_M).astype(int)
        for row, column in np.ndindex(field.values.shape):
            if allowed[row + down + 200, column + across + 200]:
                best = max(best, bytes_[y + row + 200, x + column + 200].mean() / 255)
    return float(best)


@few(2)
@given(seeds)
def test_the_best_score_is_that_of_trying_everything(seed: int) -> None:
    field, source = field_of(scatter(seed)), scatter(seed + 1, 12, 4.0)
    pyramid = Pyramid.of(field, 8.0)
    wanted = Wanted(least=0.0, lead=0.02, most=10**6)
    scores = [
        match.score for match in best_places(pyramid, source, pyramid.blocks(), ANGLES, wanted, 3)
    ]
    assert scores[0] >= tried_everywhere(field, source, ANGLES) - 1e-12
    assert scores == sorted(scores, reverse=True)
    assert scores[-1] >= scores[0] - 0.02


@few(4)
@given(seeds)
def test_the_robot_stands_in_free_cells_alone(seed: int) -> None:
    """The best score is that of trying every cell from which the robot stands in a free one."""
    field, source = field_of(scatter(seed)), scatter(seed + 1, 12, 4.0)
    free = np.random.default_rng(seed).random(field.values.shape) < 0.05
    pyramid = Pyramid.of(field, 8.0, free)
    found = best_places(pyramid, source, pyramid.blocks(), np.zeros(1), ALL, 1)
    assert found[0].score >= tried_everywhere(field, source, np.zeros(1), free) - 1e-12
    at = np.round((np.array(found[0].pose[:2]) - pyramid.corner) / CELL_M).astype(int)
    near = np.pad(free, pyramid.border)[at[1] - 1 : at[1] + 2, at[0] - 1 : at[0] + 2]
    assert near.any(), "to a cell: the robot's place is rounded, as points are"


def test_a_robot_beyond_the_border_may_stand_anywhere() -> None:
    """Its walls are all on one side, farther off than the pyramid reaches."""
    room = scatter(4, 60, 5.0)
    field = field_of(room)
    pyramid = Pyramid.of(field, 4.0, np.zeros(field.values.shape, dtype=bool))
    far = room + (60.0, 0.0)
    wanted = Wanted(least=0.5, lead=0.1, most=10**6)
    found = best_places(pyramid, far, pyramid.blocks(), np.zeros(1), wanted, 1)
    assert found[0].pose.x == pytest.approx(-60.0, abs=CELL_M)


def test_nothing_is_found_of_nothing() -> None:
    pyramid = Pyramid.of(field_of(scatter(5)), 8.0)
    blocks, none = pyramid.blocks(), np.zeros((0, 2))
    assert best_places(pyramid, none, blocks, ANGLES, ALL, 1) == []
    assert best_places(pyramid, scatter(1), blocks[:0], ANGLES, ALL, 1) == []
    strict = Wanted(least=1.0, lead=0.0, most=10**6)
    assert best_places(pyramid, scatter(1), blocks, ANGLES, strict, 1) == []


@pytest.fixture(scope="module")
def older(graph: Graph, walls: Walls) -> WallMap:
    """The walls of the first lap."""
    return WallMap.of(walls.of_all(np.flatnonzero(graph.parts == 0).tolist(), graph.poses))


@few(6)
@given(angles)
def test_a_place_is_found_at_any_angle(
    graph: Graph, walls: Walls, older: WallMap, turn: float
) -> None:
    row = int(np.argmax(graph.parts == 1)) + 20
    source = walls.around(row, 8, graph.poses)
    truth, turned = Pose2(*graph.poses[row].tolist()), Pose2(0.0, 0.0, turn)
    fit = older.place_of(turned.inverse().apply(source))
    assert fit is not None
    assert np.less(missed(truth, fit.target_from_source @ turned.inverse()), (0.1, 0.03)).all()


def rooms(*plans: tuple[int, int]) -> FloatArray:
    """The walls of rectangular rooms side by side, each 5 m from the last, in cells of 5 cm."""
    cells = np.full((160, 100 * len(plans) + 40), FREE, dtype=np.uint8)
    for number, (width, height) in enumerate(plans):
        left = 20 + 100 * number
        cells[20 : 21 + height, [left, left + width]] = OCCUPIED
        cells[[20, 20 + height], left : left + width + 1] = OCCUPIED
        cells[20 : 30 + height // 4, left + width // 3] = OCCUPIED  # so that no turn fits
    grid = GridMap(cells, 0.05)
    return grid.centres_of(np.argwhere(grid.occupied))


def test_what_fits_two_places_is_found_in_neither() -> None:
    source = rooms((60, 90))
    only = WallMap.of(rooms((60, 90), (80, 40))).place_of(source)
    twice = WallMap.of(rooms((60, 90), (60, 90))).place_of(source)
    assert only is not None
    assert np.hypot(*only.target_from_source[:2]) < 0.1
    assert twice is None


def test_a_bare_corridor_too_few_points_and_no_walls_are_no_place(older: WallMap) -> None:
    x = np.arange(0.0, 40.0, 0.05)
    walls = np.vstack([np.column_stack([x, 0 * x]), np.column_stack([x, 0 * x + 2.0])])
    assert WallMap.of(walls).place_of(walls[np.abs(walls[:, 0] - 20.0) < 5.0]) is None
    few = np.column_stack([np.arange(0.0, 4.0, 0.25), np.zeros(16)])
    assert older.place_of(few) is None
    assert older.place_of(np.zeros((0, 2))) is None
    assert WallMap.of(np.zeros((0, 2))).place_of(rooms((60, 90))) is None


@pytest.mark.parametrize(("cells", "coarsened"), [(512, False), (40, True)])
def test_a_large_map_is_searched_coarser(older: WallMap, cells: int, coarsened: bool) -> None:
    with turned("layout.place_search", _MAP_CELLS=cells):
        limited = WallMap.of(older.points)
    assert limited.coarsened is coarsened
    side = np.sqrt(limited.field.values.size) * limited.field.resolution
    assert limited.step_m == pytest.approx(max(0.3, side / cells))


def test_no_place_is_taken_where_the_robot_would_stand_in_the_wall() -> None:
    """Two rooms alike, one of them a drawing on a wall: nobody saw the space in it free."""
    source = rooms((60, 90))
    walls = rooms((60, 90), (60, 90))

    def first_room(field: ScoreField, _: float = 0.0) -> BoolArray:
        columns = field.origin[0] + field.resolution * np.arange(field.values.shape[1])
        return np.broadcast_to(columns < 4.5, field.values.shape)

    middle = source - (2.5, 3.0)  # the robot stands amid them
    assert WallMap.of(walls).place_of(middle) is None
    nowhere = WallMap.of(
        walls, lambda field, _: np.zeros(field.values.shape, dtype=bool), standing=True
    )
    assert nowhere.place_of(middle) is None
    found = WallMap.of(walls, first_room, standing=True).place_of(middle)
    assert found is not None
    assert found.target_from_source[:2] == pytest.approx((2.5, 3.0), abs=0.1)


def test_a_guess_reaches_along_its_error_and_turns_as_far() -> None:
    guess = Guess(Pose2(10.0, 5.0, 0.5), np.diag([4.0, 0.01, 0.1**2]))
    places = np.array([[15.0, 5.0], [10.0, 9.0], [18.0, 5.0], [10.0, 6.0]])
    assert guess.reaches(places, np.zeros(2)).tolist() == [True, False, False, True]
    angles = guess.angles(0.05)
    assert angles.min() == pytest.approx(0.2, abs=0.051)
    assert angles.max() == pytest.approx(0.8, abs=0.051)
    unknown = Guess(Pose2(0.0, 0.0, 0.0), np.diag([1.0, 1.0, 100.0]))
    assert np.ptp(unknown.angles(0.1)) == pytest.approx(2 * np.pi, abs=0.2)
