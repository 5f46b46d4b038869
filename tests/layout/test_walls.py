"""The walls around nodes, their sides, what was seen free; walls matched with walls of the ring."""

import math
from collections.abc import Iterator
from dataclasses import astuple
from functools import partial
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given
from scipy.spatial import cKDTree

from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2, compose
from specmap_cli.core.records import BoolArray
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.grids.matching import SPREAD_M, Prior, search
from specmap_cli.grids.score_field import ScoreField, thinned
from specmap_cli.layout.path_graph import Graph
from specmap_cli.layout.walls import (
    LEAST_EVIDENCE,
    Place,
    Sides,
    Surroundings,
    WallFit,
    Walls,
    everywhere,
    from_behind,
    link_to_nearest,
    match_passes,
    opened,
)
from tests.layout.driving import (
    Drive,
    Laps,
    between,
    building,
    corridor,
    graph_by_hand,
    missed,
    scans_of,
    stored,
)
from tests.strategies import angles, few, poses
from tests.turning import turned

LOWER, UPPER = -1.0, 1.0  # y of a viewer on either side of a wall along x


def seen_from(perfect: Laps, row: int) -> FloatArray:
    """The thinned points of one node in its own frame."""
    store, graph = perfect
    return thinned(store.points(int(graph.nodes[row]), 30.0), 0.05)


def test_walls_are_those_of_neighbours_of_a_part_in_its_frame(perfect: Laps, walls: Walls) -> None:
    graph = perfect[1]
    first = int(np.argmax(graph.parts == 1))
    for row, reach in ((10, 3), (1, 3), (50, 0), (first, 4), (first - 1, 4)):
        expected = [
            between(graph.poses, row, k).apply(seen_from(perfect, k))
            for k in range(max(0, row - reach), row + reach + 1)
            if graph.parts[k] == graph.parts[row]
        ]
        assert np.allclose(
            walls.around(row, reach, graph.poses).points, np.concatenate(expected)
        ), row


def test_farther_returns_are_no_walls(perfect: Laps, walls: Walls) -> None:
    poses = perfect[1].poses
    with turned("layout.path_graph", MATCH_RANGE_M=2.0):
        near = Walls(*perfect).around(20, 0, poses).points
    assert 0 < len(near) < len(walls.around(20, 0, poses).points)
    assert np.hypot(*near.T).max() <= 2.0


def test_the_walls_of_many_nodes_lie_in_the_map_a_cell_apart(perfect: Laps, walls: Walls) -> None:
    rows, moved = list(range(0, 120, 2)), compose(np.array([5.0, -3.0, 0.7]), perfect[1].poses)
    gathered = walls.of_all(rows, moved)
    every = np.concatenate([Pose2(*moved[k].tolist()).apply(seen_from(perfect, k)) for k in rows])
    assert cKDTree(every).query(gathered)[0].max() < 1e-9, "points are seen ones"
    assert cKDTree(gathered).query(every)[0].max() < 0.05 * np.sqrt(2), "all are near one"
    cells = np.floor(gathered / 0.05)
    assert len(np.unique(cells, axis=0)) == len(cells)
    assert len(gathered) < 0.5 * len(every)
    assert walls.of_all([], moved).shape == (0, 2)


def test_more_nodes_than_are_remembered_are_read_again(drive: Drive) -> None:
    truth, scans = drive
    with stored(truth, scans) as store:
        walls = Walls(store, graph_by_hand(truth))
        before = walls.around(0, 0, truth).points
        for row in range(300):
            walls.around(row, 0, truth)
        assert np.array_equal(walls.around(0, 0, truth).points, before)


def wall(y: float = 0.0, left: float = -2.0, right: float = 2.0) -> FloatArray:
    """Points 5 cm apart along x."""
    x = np.arange(left, right, 0.05)
    return np.column_stack([x, np.full(len(x), y)])


def seen(points: FloatArray, y: float) -> Sides:
    """The sides that a viewer at (0, y) sees."""
    return Sides.of(points, (0.0, y))


@pytest.mark.parametrize("y", [LOWER, UPPER])
@pytest.mark.parametrize("step", [1, -1])
def test_normals_point_to_the_viewer_whichever_way_the_beams_turn(y: float, step: int) -> None:
    sides = seen(wall()[::step], y)
    assert np.allclose(sides.normals[2:-2], (0.0, y))
    assert not sides.normals[[0, 1, -2, -1]].any(), "ends have no neighbours on both sides"


def test_posts_have_no_side() -> None:
    assert not seen(np.column_stack([np.arange(8.0), np.zeros(8)]), LOWER).normals.any()
    assert not seen(np.zeros((9, 2)), LOWER).normals.any()
    assert seen(np.zeros((0, 2)), LOWER).normals.shape == (0, 2)


@given(poses)
def test_sides_turn_with_their_frame(pose: Pose2) -> None:
    here = seen(wall(), LOWER)
    x, y = pose.apply(np.array([[0.0, LOWER]]))[0].tolist()
    there = Sides.of(pose.apply(here.points), (x, y))
    assert np.allclose(here.placed(pose).normals, there.normals, atol=1e-6)
    assert np.array_equal(here.placed(pose).points, there.points)


@pytest.mark.parametrize("thick_m", [0.0, 0.1, 0.25])
@pytest.mark.parametrize("off_m", [0.0, -0.3, 0.3])
def test_the_other_side_is_known_as_such(thick_m: float, off_m: float) -> None:
    target, source = seen(wall(), LOWER), seen(wall(thick_m), UPPER)
    behind = from_behind(source, target, Pose2(0.0, off_m, 0.0), 0.3)
    assert behind[2:-2].all()
    assert not behind[[0, 1, -2, -1]].any(), "of these no side is known"


def test_what_is_not_seen_from_behind() -> None:
    """The same side, a wall seen from both sides, walls around a corner, and new walls."""
    lower, upper = seen(wall(), LOWER), seen(wall(0.2), UPPER)
    assert not from_behind(lower, lower, Pose2(0.0, 0.2, 0.1), 0.3).any()
    both = Sides(*np.concatenate([astuple(lower), astuple(upper)], axis=1))
    assert not from_behind(lower, both, IDENTITY, 0.3).any()
    assert not from_behind(upper, both, IDENTITY, 0.3).any()
    for away in (Pose2(-2.0, 0.0, math.pi / 2), Pose2(0.0, 3.0, 0.0), Pose2(50.0, 0.0, 0.0)):
        assert not from_behind(seen(wall(), UPPER).placed(away), lower, IDENTITY, 0.3).any()
    nothing = seen(np.zeros((0, 2)), UPPER)
    assert not from_behind(lower, nothing, IDENTITY, 0.3).any()
    assert from_behind(nothing, lower, IDENTITY, 0.3).shape == (0,)


def test_the_corridor_driven_is_free_and_the_rock_is_not(perfect: Laps, walls: Walls) -> None:
    graph, plan = perfect[1], building()
    rows = np.flatnonzero(graph.parts == 0).tolist()
    field = ScoreField.from_points(walls.of_all(rows, graph.poses), 0.25, 0.3)
    free = walls.seen_of_all(rows, graph.poses, field, 0.6)
    height, width = free.shape
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    centres = np.column_stack([x.ravel(), y.ravel()]) * 0.25 + field.origin
    cells = plan.cells_of(centres)
    inside = plan.inside(cells)
    wall_m = np.zeros(len(centres))
    wall_m[inside] = plan.obstacle_distance()[tuple(cells[inside].T)]
    middle = (centres[:, 0] > 1.8) & (centres[:, 0] < 17.2) & (wall_m > 0.6)
    middle &= (np.abs(centres[:, 1] - 2.5) < 0.3) | (np.abs(centres[:, 1] - 12.5) < 0.3)
    assert middle.sum() > 50
    assert free.ravel()[middle].all()
    rock = (np.abs(centres[:, 0] - 11.0) < 1.0) & (np.abs(centres[:, 1] - 8.5) < 0.5)
    assert rock.any()
    assert not free.ravel()[rock].any(), "the block inside the ring"


def test_what_is_free_lies_where_the_poses_put_it(graph: Graph, walls: Walls) -> None:
    poses, rows = graph.poses, [3, 40]
    moved = compose(np.array([50.0, -20.0, 0.0]), poses)
    here, there = (ScoreField.from_points(walls.of_all(rows, p), 0.25, 0.3) for p in (poses, moved))
    free = walls.seen_of_all(rows, poses, here, 0.6)
    assert free.any()
    assert not walls.seen_of_all(rows, moved, here, 0.6).any(), "far off this field"
    assert walls.seen_of_all(rows, moved, there, 0.6).sum() == free.sum()
    assert not walls.seen_of_all([], poses, here, 0.6).any()


Pass = tuple[FloatArray, FloatArray, Pose2]
ANYWHERE = Prior(Pose2(0.0, 0.0, 0.0), np.diag([3.0, 3.0, 2.0]) ** 2)


def pass_of(graph: Graph, walls: Walls, row: int) -> Pass:
    """Walls of a node of the second lap, of the same place in the first, and the true pose."""
    poses = graph.poses
    old = int(np.argmin(np.hypot(*(poses[:100, :2] - poses[row, :2]).T)))
    return (
        walls.around(row, 3, poses).points,
        walls.around(old, 8, poses).points,
        between(poses, old, row),
    )


@pytest.fixture
def one(graph: Graph, walls: Walls) -> Pass:
    """A pass, where the ring shows much."""
    return pass_of(graph, walls, 190)


def matched(source: FloatArray, target: FloatArray, guess: Pose2, drift_m: float) -> WallFit:
    fit = Place.of(target).match(source, guess, drift_m)
    assert fit is not None
    return fit


def deviations(fit: WallFit) -> FloatArray:
    """Standard deviations of x, y and heading in the frame of the source."""
    return np.asarray(np.sqrt(np.diag(np.linalg.inv(fit.information))))


@pytest.mark.parametrize("seed", range(12))
def test_a_pass_is_matched_to_centimetres(graph: Graph, walls: Walls, seed: int) -> None:
    rng = np.random.default_rng(seed)
    source, target, truth = pass_of(graph, walls, int(rng.integers(142, 205)))
    error = Pose2(*rng.uniform((-0.7, -0.7, -0.14), (0.7, 0.7, 0.14)).tolist())
    fit = matched(source, target, truth @ error, 1.0)
    assert np.less(missed(truth, fit.target_from_source), (0.05, 0.02)).all()
    assert (np.linalg.eigvalsh(fit.information) > 0).all()
    assert np.allclose(fit.information, fit.information.T)


def test_another_place_does_not_fit(graph: Graph, walls: Walls) -> None:
    poses = graph.poses
    source, target = walls.around(10, 3, poses).points, walls.around(45, 8, poses).points
    assert Place.of(target).match(source, IDENTITY, 1.0) is None
    with turned("layout.walls", LOOP_SCORE=0.0):
        found = Place.of(target).match(source, IDENTITY, 1.0)
    assert found is not None, "the evidence alone refuses it"


@pytest.fixture
def searched(monkeypatch: pytest.MonkeyPatch) -> Mock:
    """The search of a window, counted from now on."""
    counted = Mock(wraps=search)
    monkeypatch.setattr("specmap_cli.layout.walls.search", counted)
    return counted


@pytest.mark.parametrize(
    ("off_m", "drift_m", "searches"),
    [
        (0.05, 0.4, 0),  # it fits where it is said to be
        (0.3, 0.4, 2),
        (0.0, 0.6, 2),  # doors in a row look alike: the next one may fit better still
    ],
)
def test_what_fits_where_it_is_said_to_be_is_not_searched(
    one: Pass, searched: Mock, off_m: float, drift_m: float, searches: int
) -> None:
    source, target, truth = one
    fit = matched(source, target, truth @ Pose2(off_m, 0.0, 0.0), drift_m)
    assert missed(truth, fit.target_from_source)[0] < 0.05
    assert searched.call_count == searches


def test_other_walls_are_given_up_after_the_rough_search(one: Pass, searched: Mock) -> None:
    target = np.column_stack([np.linspace(20.0, 25.0, 200), np.full(200, 20.0)])
    assert Place.of(target).match(one[0], IDENTITY, 0.4) is None
    searched.assert_called_once()


def test_what_lies_farther_off_than_the_drift_is_not_found(one: Pass) -> None:
    source, target, truth = one
    guess = truth @ Pose2(2.0, 0.0, 0.0)
    near, far = Place.of(target).match(source, guess, 0.5), matched(source, target, guess, 2.2)
    assert near is None or missed(truth, near.target_from_source)[0] > 0.5
    assert missed(truth, far.target_from_source)[0] < 0.05


def test_too_few_points_are_not_matched() -> None:
    points = corridor()
    few = points[:: len(points) // 40]
    for least, fits in ((20, True), (60, False)):
        with turned("layout.walls", MATCH_POINTS=least):
            assert (Place.of(points).match(few, IDENTITY, 0.3) is not None) is fits
    assert Place.of(points).match(np.zeros((0, 2)), IDENTITY, 0.3) is None


def test_along_a_corridor_a_match_is_loose_in_the_frame_of_the_source() -> None:
    """The target looks along the corridor, the source at a wall: it may be off aside."""
    points, turn = corridor(), Pose2(0.0, 0.0, np.pi / 2)
    deviation = deviations(matched(turn.inverse().apply(points), points, turn, 0.3))
    assert deviation[1] > 0.1
    assert deviation[0] < 0.05


def test_what_could_not_have_been_seen_says_nothing_and_a_short_overlap_little() -> None:
    """A corridor seen on, past its end: what lies there is no reason to refuse the match."""
    points = corridor()
    target = points[points[:, 0] < -1.0]
    source = points[np.abs(points[:, 0]) < 6.0]

    def before_it(field: ScoreField, _: float) -> BoolArray:
        columns = field.origin[0] + field.resolution * np.arange(field.values.shape[1])
        return np.broadcast_to(columns < -1.0, field.values.shape)

    assert Place.of(target).evidence.score(source, IDENTITY) < LEAST_EVIDENCE
    short = Place.of(target, before_it).match(source, IDENTITY, 0.3)
    whole = matched(source, points, IDENTITY, 0.3)
    assert short is not None
    assert missed(IDENTITY, short.target_from_source)[1] < 0.02
    assert short.information[1, 1] < 0.8 * whole.information[1, 1]


@pytest.mark.parametrize("heading", [0.0, 0.7, np.pi / 2, 2.5])
def test_a_window_that_fits_all_over_says_nothing_of_the_way(heading: float) -> None:
    window_m, turn = SPREAD_M / np.sqrt(3), Pose2(0.0, 0.0, heading).rotation()
    axis, across = turn.T

    def spread_of(along_m: float, across_m: float) -> FloatArray:
        spread = np.diag([0.0, 0.0, 0.01**2])
        spread[:2, :2] = turn @ np.diag([along_m**2, across_m**2]) @ turn.T
        return spread

    bare = opened(spread_of(window_m, 0.02))
    assert axis @ bare[:2, :2] @ axis == pytest.approx(4.0)
    assert across @ bare[:2, :2] @ across == pytest.approx(0.02**2)
    sharp = spread_of(0.02, 0.01)
    assert np.allclose(opened(sharp), sharp, rtol=0.02, atol=1e-9)
    half = opened(spread_of(0.1, 0.02))
    assert axis @ half[:2, :2] @ axis == pytest.approx(1.0 / (1.0 / 0.1**2 - 1.0 / window_m**2))
    assert half[2, 2] == 0.01**2


def test_in_a_bare_corridor_the_nearest_of_equal_places_is_taken() -> None:
    short = corridor(500)
    short = short[np.abs(short[:, 0]) < 3.0]
    fit = matched(short, corridor(), Pose2(0.5, 0.0, 0.0), 2.0)
    assert abs(fit.target_from_source.x - 0.5) < 0.35
    assert abs(fit.target_from_source.y) < 0.03
    assert deviations(fit)[0] > 0.5, "more than the window that was looked at"
    assert deviations(fit)[1] < 0.05


def test_a_place_found_in_the_map_is_linked_to_the_nearest_row(graph: Graph) -> None:
    place = Pose2(*graph.poses[30].tolist()) @ Pose2(0.1, 0.05, 0.5)
    made = link_to_nearest(graph, graph.poses, np.arange(60), 200, WallFit(place, np.eye(3)))
    assert (made.source, made.target) == (graph.nodes[30], graph.nodes[200])
    assert made.source_from_target == pytest.approx((0.1, 0.05, 0.5))
    assert made.kind == "nearby"


FIRST, SECOND, AGAIN = 4, 13, 22  # rows: in the lower room, in the upper one, in the lower one
Rooms = tuple[Graph, Walls]


@pytest.fixture(scope="module")
def rooms() -> Iterator[Rooms]:
    """Two rooms with a wall of 0.25 m between, driven below it, above it, and below it again."""
    cells = np.full((140, 140), OCCUPIED, dtype=np.uint8)
    cells[10:70, 10:130] = FREE
    cells[75:135, 10:130] = FREE
    x = np.linspace(2.5, 4.5, 9)
    stretches = [np.column_stack([x, np.full(9, y), np.zeros(9)]) for y in (2.2, 5.0, 1.5)]
    truth = np.concatenate(stretches)
    with stored(truth, scans_of(GridMap(cells, 0.05), truth)) as store:
        graph = graph_by_hand(truth)
        yield graph, Walls(store, graph)


def test_the_other_side_of_a_wall_is_no_match(rooms: Rooms) -> None:
    graph, walls = rooms
    guess = between(graph.poses, FIRST, SECOND)
    source, target = (walls.around(row, 4, graph.poses).points for row in (SECOND, FIRST))
    seen = partial(walls.seen_around, FIRST, 4, graph.poses)
    with turned("layout.walls", LOOP_SCORE=0.2):  # they have little else in common
        mistaken = Place.of(target, seen).match(source, guess, 0.3)
    assert mistaken is not None
    assert missed(guess, mistaken.target_from_source)[0] > 0.2, "a wall's thickness off"
    with turned("layout.walls", PLACE_NODES=4):
        found = match_passes(graph, walls, graph.poses, (FIRST, SECOND), guess, 0.3, 4)
    assert found is None


@pytest.mark.parametrize(("off_m", "fits"), [(0.0, True), (0.2, True), (-0.2, True), (20.0, False)])
def test_the_same_side_is_one(rooms: Rooms, off_m: float, fits: bool) -> None:
    graph, walls = rooms
    truth = between(graph.poses, FIRST, AGAIN)
    guess = truth @ Pose2(0.0, off_m, 0.0)
    with turned("layout.walls", PLACE_NODES=4):
        found = match_passes(graph, walls, graph.poses, (FIRST, AGAIN), guess, 0.3, 4)
    assert (found is not None) is fits
    if found is not None:
        assert (found.source, found.target, found.kind) == (FIRST, AGAIN, "nearby")
        assert missed(truth, found.source_from_target)[0] < 0.03


@few(6)
@given(angles)
def test_a_place_is_found_at_any_angle(graph: Graph, walls: Walls, turn: float) -> None:
    older = walls.of_all(np.flatnonzero(graph.parts == 0).tolist(), graph.poses)
    row = int(np.argmax(graph.parts == 1)) + 20
    source = walls.around(row, 8, graph.poses).points
    truth, turned = Pose2(*graph.poses[row].tolist()), Pose2(0.0, 0.0, turn)
    somewhere = Prior(Pose2(truth.x, truth.y, 0.0) @ turned, np.diag([1.0, 1.0, 2.0]) ** 2)
    fit = Surroundings.of(older).find(turned.inverse().apply(source), everywhere, somewhere)
    assert fit is not None
    assert np.less(missed(truth, fit.target_from_source @ turned.inverse()), (0.1, 0.03)).all()


def plans_of(*plans: tuple[int, int]) -> FloatArray:
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
    source = plans_of((60, 90))
    only = Surroundings.of(plans_of((60, 90), (80, 40))).find(source, everywhere, ANYWHERE)
    assert only is not None
    assert np.hypot(*only.target_from_source[:2]) < 0.1
    twins = plans_of((60, 90), (60, 90))
    assert Surroundings.of(twins).find(source, everywhere, ANYWHERE) is None
    near = Prior(Pose2(5.0, 0.4, 0.1), np.diag([0.3, 0.3, 0.05]) ** 2)
    second = Surroundings.of(twins).find(source, everywhere, near)
    assert second is not None, "the prior reaches the second of them alone"
    assert second.target_from_source[:2] == pytest.approx((5.0, 0.0), abs=0.1)


def test_a_bare_corridor_too_few_points_and_no_walls_are_no_place() -> None:
    x = np.arange(0.0, 40.0, 0.05)
    walls = np.vstack([np.column_stack([x, 0 * x]), np.column_stack([x, 0 * x + 2.0])])
    assert (
        Surroundings.of(walls).find(walls[np.abs(walls[:, 0] - 20.0) < 5.0], everywhere, ANYWHERE)
        is None
    )
    few = np.column_stack([np.arange(0.0, 4.0, 0.25), np.zeros(16)])
    assert Surroundings.of(walls).find(few, everywhere, ANYWHERE) is None
    assert Surroundings.of(np.zeros((0, 2))).find(plans_of((60, 90)), everywhere, ANYWHERE) is None
