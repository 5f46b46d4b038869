"""Parts whose place nobody knows, looked for among all older walls."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given

from specmap_cli.core.geometry import FloatArray, Pose2, compose
from specmap_cli.core.records import BoolArray
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.grids.score_field import ScoreField
from specmap_cli.layout.motion_edges import MATCH_RANGE_M
from specmap_cli.layout.path_graph import NODE_M, Draft, Graph, graph_of
from specmap_cli.layout.strays import OlderWalls, Search, rejoin
from specmap_cli.layout.walls import Walls
from tests.layout.driving import between, building, round_trip, scans_of, stored, worst
from tests.strategies import angles, few
from tests.turning import turned

Perfect = tuple[KeyframeStore, Graph]


@pytest.fixture(scope="module")
def older(perfect: Perfect) -> OlderWalls:
    """The walls of the first lap."""
    store, graph = perfect
    rows = np.flatnonzero(graph.parts == 0).tolist()
    points = Walls(store, graph, MATCH_RANGE_M).of_all(rows, graph.poses)
    return OlderWalls.of(1, points)


@few(6)
@given(angles)
def test_a_place_is_found_at_any_angle(perfect: Perfect, older: OlderWalls, turn: float) -> None:
    store, graph = perfect
    row = int(np.argmax(graph.parts == 1)) + 20
    source = Walls(store, graph, MATCH_RANGE_M).around(row, 8, graph.poses)
    truth, turned = Pose2(*graph.poses[row].tolist()), Pose2(0.0, 0.0, turn)
    fit = older.place_of(turned.inverse().apply(source))
    assert fit is not None
    gap = truth.inverse() @ fit.target_from_source @ turned.inverse()
    assert gap.distance < 0.1
    assert abs(gap.theta) < 0.03


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
    only = OlderWalls.of(1, rooms((60, 90), (80, 40))).place_of(source)
    twice = OlderWalls.of(1, rooms((60, 90), (60, 90))).place_of(source)
    assert only is not None
    assert np.hypot(*only.target_from_source[:2]) < 0.1
    assert twice is None


def test_a_bare_corridor_is_no_place() -> None:
    x = np.arange(0.0, 40.0, 0.05)
    walls = np.vstack([np.column_stack([x, 0 * x]), np.column_stack([x, 0 * x + 2.0])])
    older = OlderWalls.of(1, walls)
    assert older.place_of(walls[np.abs(walls[:, 0] - 20.0) < 5.0]) is None


def test_too_few_points_and_no_walls_are_no_place(older: OlderWalls) -> None:
    few = np.column_stack([np.arange(0.0, 4.0, 0.25), np.zeros(16)])
    assert older.place_of(few) is None
    assert older.place_of(np.zeros((0, 2))) is None
    nothing = OlderWalls.of(1, np.zeros((0, 2)))
    assert nothing.place_of(rooms((60, 90))) is None


@pytest.mark.parametrize(("cells", "coarsened"), [(512, False), (40, True)])
def test_a_large_map_is_searched_coarser(older: OlderWalls, cells: int, coarsened: bool) -> None:
    with turned("layout.strays", _STRAY_CELLS=cells):
        limited = OlderWalls.of(1, older.points)
    assert limited.coarsened is coarsened
    side = np.sqrt(limited.field.values.size) * limited.field.resolution
    assert limited.step_m == pytest.approx(max(0.3, side / cells))


def search_along(
    store: KeyframeStore, graph: Graph, rows: list[int]
) -> tuple[Draft, Search | None]:
    """The search for the part of some rows, one try at each, until it is found."""
    draft, search = Draft(poses=graph.poses), None
    walls = Walls(store, graph, MATCH_RANGE_M)
    for row in rows:
        draft, search = rejoin(row, graph, draft, walls, search)
        if int(graph.parts[row]) in draft.tied:
            break
    return draft, search


def test_a_part_is_moved_when_enough_finds_agree() -> None:
    """The second lap was put metres away and turned; three places along it say where it belongs."""
    truth = round_trip(1.25)[::2]
    kidnapped = np.array(truth)
    kidnapped[260:] = compose(np.array([3.0, -2.0, 0.9]), truth[260:])
    with stored(kidnapped, scans_of(building(), truth)) as store:
        graph = graph_of(store, [], [260])
        rows = np.flatnonzero(graph.parts == 1).tolist()[::4]
        draft, search = search_along(store, graph, rows)
        with turned("layout.strays", _STRAY_VOTES=1):
            hasty, first = search_along(store, graph, rows)
    assert search is not None
    assert draft.tied == {0, 1}
    assert len(search.finds) == 3
    assert draft.tries[1] >= 3
    assert worst(draft.poses, truth[graph.nodes]) < 0.3
    for find in search.finds:
        gap = find.source_from_target.inverse() @ between(truth, find.source, find.target)
        assert gap.distance < 0.2
    assert first is not None
    assert hasty.tied == {0, 1}
    assert len(first.finds) == 1


def test_a_part_is_given_up_and_the_finds_of_another_part_do_not_count(perfect: Perfect) -> None:
    store, whole = perfect
    graph = graph_of(store, [], [480, 600])
    rows = np.flatnonzero(graph.parts >= 1).tolist()
    first, second = ([row for row in rows if graph.parts[row] == part] for part in (1, 2))
    with turned("layout.strays", STRAY_TRIES=2, _STRAY_VOTES=4):
        draft, search = search_along(store, graph, [*first[8:24:4], *second[8:24:4]])
    assert draft.tries == {1: 2, 2: 2}
    assert search is not None
    assert search.older.part == 2
    assert len(search.finds) == 2, "two of each part, and none of the part before"
    assert draft.tied == {0}
    assert np.array_equal(draft.poses, graph.poses)
    with turned("layout.strays", STRAY_TRIES=0):
        never, nothing = search_along(store, graph, first[:4])
    assert nothing is None
    assert never.tries == {}
    assert len(whole.part_numbers) == 2


def test_the_more_tries_fail_the_farther_apart_they_are(perfect: Perfect) -> None:
    store, _ = perfect
    graph = graph_of(store, [], [480])
    rows = np.flatnonzero(graph.parts == 1).tolist()
    draft, search, at = Draft(poses=graph.poses), None, []
    walls = Walls(store, graph, MATCH_RANGE_M)
    for row in rows:
        before = draft.tries.get(1, 0)
        with (
            turned("layout.path_graph", LOOP_EVERY_M=0.6),
            turned("layout.strays", STRAY_TRIES=4, _STRAY_VOTES=9),
        ):
            draft, search = rejoin(row, graph, draft, walls, search)
        if draft.tries[1] > before:
            at.append(float(graph.path[row] - graph.path[rows[0]]))
    due = [0.6 * tries * (1.0 + tries / 20) for tries in range(4)]
    assert len(at) == 4
    assert all(0.0 <= way - least <= NODE_M + 0.2 for way, least in zip(at, due, strict=True))


def test_no_place_is_taken_where_the_robot_would_stand_in_the_wall() -> None:
    """Two rooms alike, one of them a drawing on a wall: nobody saw the space in it free."""
    source = rooms((60, 90))
    walls = rooms((60, 90), (60, 90))

    def first_room(field: ScoreField) -> BoolArray:
        columns = field.origin[0] + field.resolution * np.arange(field.values.shape[1])
        return np.broadcast_to(columns < 4.5, field.values.shape)

    middle = source - (2.5, 3.0)  # the robot stands amid them
    assert OlderWalls.of(1, walls).place_of(middle) is None
    found = OlderWalls.of(1, walls, first_room).place_of(middle)
    assert found is not None
    assert found.target_from_source[:2] == pytest.approx((2.5, 3.0), abs=0.1)
