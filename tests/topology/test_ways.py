"""Anchors, ways and their lines, against other searches and other distances."""

from __future__ import annotations

import math
from itertools import pairwise

import networkx as nx
import numpy as np
import pytest
from scipy import ndimage

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import IntArray
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.topology.regions import NOBODY, Regions, Space
from specmap_cli.topology.ways import Anchor, Way, anchors_of, cells_on, straightened, tree, ways
from tests.topology.rooms import Box, regions_of, two_rooms

RADIUS_M = 0.2
NOWHERE = np.zeros((0, 2), dtype=np.int64)


def anchors(space: Space, stood: IntArray = NOWHERE) -> dict[int, Anchor]:
    return anchors_of(space, stood, RADIUS_M, 0.1)


def anchored(
    size: tuple[float, float], boxes: list[Box], *things: Box, stood: IntArray = NOWHERE
) -> tuple[Space, Anchor, tuple[float, float]]:
    """A place of one submap, its anchor and where that is."""
    space = Space.of(regions_of(size, {0: boxes}, list(things)))
    (anchor,) = anchors(space, stood).values()
    return space, anchor, space.place(np.array(anchor.cell))


def way_of(regions: Regions, radius_m: float = RADIUS_M) -> Way:
    space = Space.of(regions)
    return ways(space, anchors(space), [(0, 1)], radius_m)[0, 1]


def room_of(grid: GridMap) -> FloatArray:
    """(H, W) metres from a cell to the side of the nearest that is not free, by SciPy."""
    away = ndimage.distance_transform_edt(np.pad(grid.free, 1))[1:-1, 1:-1]
    return np.asarray((away - 0.5) * grid.resolution)


def least_room(grid: GridMap, path: FloatArray) -> float:
    """The least room on the points of a path, half a centimetre apart."""
    points = []
    for a, b in pairwise(path):
        count = 2 + round(math.dist(a, b) / 0.005)
        points.append(a + np.linspace(0.0, 1.0, count)[:, None] * (b - a))
    return float(room_of(grid)[tuple(grid.cells_of(np.concatenate(points)).T)].min())


def cluttered(seed: int) -> Regions:
    """Two rooms with a door of 0.9 m, full of things of up to half a metre."""
    rng = np.random.default_rng(seed)
    corners = rng.uniform((0.3, 0.3), (9.0, 6.0), (25, 2))
    kept = corners[np.abs(corners[:, 0] - 5.2) > 1.0]
    things = [(x, y, x + 0.1 + 0.4 * rng.random(), y + 0.3) for x, y in kept.tolist()]
    rooms = {0: [(0.3, 0.3, 5.3, 6.3), (5.3, 2.5, 5.5, 3.4)], 1: [(5.5, 0.3, 9.5, 6.3)]}
    return regions_of((9.8, 6.6), rooms, things)


def test_clearance_is_measured_to_the_side_of_what_is_not_free() -> None:
    space = Space.of(two_rooms((5.3, 2.5, 5.5, 3.4)))
    np.testing.assert_allclose(space.clearance, np.maximum(room_of(space.grid), 0.0))
    corridor = Space.of(regions_of((4.0, 1.0), {0: [(0.2, 0.2, 3.8, 0.75)]}))  # 11 cells wide
    assert corridor.clearance.max() == pytest.approx(0.55 / 2)


def test_an_anchor_is_in_the_middle_of_a_room_but_keeps_off_a_table_there() -> None:
    room = [(0.3, 0.3, 4.7, 3.7)]
    _, anchor, place = anchored((5.0, 4.0), room)
    assert place == pytest.approx((2.5, 2.0), abs=0.05)
    assert anchor.clearance_m == pytest.approx(1.7, abs=0.06)
    space, anchor, place = anchored((5.0, 4.0), room, (2.0, 1.5, 3.0, 2.5))
    assert anchor.clearance_m >= 0.3
    assert math.dist(place, (2.5, 2.0)) < 1.0
    assert anchor.clearance_m == pytest.approx(room_of(space.grid)[anchor.cell])


def test_an_anchor_of_a_narrow_place_is_where_it_is_widest_and_tells_how_wide() -> None:
    space, anchor, _ = anchored((3.3, 1.2), [(0.3, 0.3, 3.0, 0.65), (1.0, 0.3, 1.3, 0.8)])
    assert anchor.clearance_m == pytest.approx(room_of(space.grid).max())
    assert anchor.clearance_m < RADIUS_M + 0.1


def test_an_anchor_is_where_the_robot_was_not_behind_glass_or_a_railing() -> None:
    rooms = [(0.3, 0.3, 2.0, 3.7), (2.2, 0.3, 8.0, 3.7)]
    stood = np.array([[20, 20], [40, 25]])
    _, behind, _ = anchored((8.3, 4.0), rooms)
    _, before, _ = anchored((8.3, 4.0), rooms, stood=stood)
    assert behind.cell[1] * 0.05 > 2.2
    assert before.cell[1] * 0.05 < 2.0
    # a railing with a gap far along
    rooms = [(0.3, 0.3, 9.7, 1.7), (0.3, 1.8, 9.7, 5.7), (9.0, 1.7, 9.7, 1.8)]
    stood = np.array([[28, column] for column in range(12, 120, 6)])
    _, anchor, _ = anchored((10.0, 6.0), rooms, stood=stood)
    assert anchor.cell[0] * 0.05 < 1.7


@pytest.mark.parametrize("seed", range(4))
def test_the_cheapest_way_is_that_of_another_search(seed: int) -> None:
    rng = np.random.default_rng(seed)
    window = slice(3, 15), slice(5, 25)
    free, price = rng.random((12, 20)) < 0.75, 1.0 + rng.random((12, 20))
    free[0, 0] = True
    found = tree(free, price, window, (3, 5))
    graph = nx.Graph()
    graph.add_node((0, 0))
    for row, column in np.argwhere(free).tolist():
        for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
            there = row + down, column + right
            inside = there[0] < 12 and 0 <= there[1] < 20
            sides = [(row, there[1]), (there[0], column)] if down and right and inside else []
            if inside and free[there] and all(free[side] for side in sides):
                length = math.hypot(down, right)
                mean = (price[row, column] + price[there]) / 2.0
                graph.add_edge((row, column), there, weight=length * mean)
    best = nx.single_source_dijkstra_path_length(graph, (0, 0))
    cells = np.argwhere(free)
    costs = found.cost_to(cells + np.array([3, 5]))
    for cell, cost in zip(cells.tolist(), costs.tolist(), strict=True):
        assert cost == pytest.approx(best.get(tuple(cell), math.inf))
        if math.isfinite(cost):
            way = found.way_to(np.array(cell) + [3, 5]) - [3, 5]
            assert way[[0, -1]].tolist() == [[0, 0], cell]
            steps = [(tuple(a), tuple(b)) for a, b in pairwise(way.tolist())]
            assert sum(graph.edges[step]["weight"] for step in steps) == pytest.approx(cost)


def test_a_search_that_starts_in_a_wall_leads_nowhere_and_one_cell_is_a_point() -> None:
    free = np.zeros((3, 3), dtype=np.bool_)
    free[2] = True
    found = tree(free, np.ones((3, 3)), (slice(0, 3), slice(0, 3)), (0, 0))
    assert np.isinf(found.cost_to(np.array([[0, 0], [2, 1]]))).all()
    assert straightened(np.array([[4, 4]]), np.ones((9, 9))).tolist() == [[4, 4]]


def told(cells: IntArray) -> set[tuple[int, ...]]:
    return {tuple(cell) for cell in cells.tolist()}


@pytest.mark.parametrize("seed", range(6))
def test_all_cells_under_a_line_are_known(seed: int) -> None:
    rng = np.random.default_rng(seed)
    start, end = rng.integers(0, 30, (2, 2))
    cells, lengths = cells_on(start, end)
    assert lengths.sum() == pytest.approx(math.dist(start, end))
    points = start + np.linspace(0.0, 1.0, 5000)[:, None] * (end - start)
    assert told(np.rint(points).astype(int)) <= told(cells)
    corner, _ = cells_on(np.array([0, 0]), np.array([1, 1]))
    assert told(corner) == {(0, 0), (0, 1), (1, 0), (1, 1)}, "through a corner it touches four"


def test_a_way_round_a_wall_keeps_its_corner_and_loses_the_others() -> None:
    price = np.ones((20, 20))
    price[:15, 10] = np.inf
    way = tree(np.isfinite(price), price, (slice(0, 20), slice(0, 20)), (2, 2)).way_to(
        np.array([2, 18])
    )
    corners = straightened(way, price)
    assert corners[[0, -1]].tolist() == [[2, 2], [2, 18]]
    assert 3 <= len(corners) <= 5
    for a, b in pairwise(corners):
        assert np.isfinite(price[tuple(cells_on(a, b)[0].T)]).all()


def test_a_way_leads_straight_through_a_door_in_line() -> None:
    regions = two_rooms((5.3, 2.85, 5.5, 3.75))
    way = way_of(regions)
    assert way.path is not None
    assert way.path[[0, -1]] == pytest.approx(np.array([[2.8, 3.3], [7.5, 3.3]]), abs=0.06)
    assert way.length_m == pytest.approx(4.7, abs=0.1)
    assert way.clearance_m == pytest.approx(0.45, abs=0.03)
    assert len(way.path) <= 4


@pytest.mark.parametrize("seed", range(8))
def test_ways_keep_the_radius_off_all_things(seed: int) -> None:
    regions = cluttered(seed)
    way = way_of(regions)
    assert way.path is not None
    assert way.clearance_m is not None
    least = least_room(regions.grid, way.path)
    assert least >= RADIUS_M
    assert least == pytest.approx(way.clearance_m, abs=0.03)
    assert way.length_m is not None
    assert way.length_m >= math.dist(way.path[0], way.path[-1]) - 1e-9


def test_a_robot_too_wide_for_a_door_is_told_how_wide_it_is() -> None:
    way = way_of(two_rooms((5.3, 2.5, 5.5, 3.4)), radius_m=0.6)
    assert (way.path, way.length_m) == (None, None)
    assert way.clearance_m == pytest.approx(0.45, abs=0.03)
    assert way_of(two_rooms()) == Way(None, None), "they do not touch"


def test_ways_stay_in_their_two_submaps() -> None:
    """A corridor joins both rooms, too: that is the way of other edges."""
    rooms = {
        0: [(0.3, 0.3, 4.3, 4.0)],
        1: [(4.5, 0.3, 9.0, 4.0)],
        2: [(0.3, 4.2, 9.0, 6.0), (1.0, 4.0, 2.0, 4.2), (7.0, 4.0, 8.0, 4.2)],
    }
    rooms[0].append((4.3, 1.0, 4.5, 1.25))  # a slit
    way = way_of(regions_of((9.3, 6.3), rooms))
    assert way.path is None
    assert way.clearance_m == pytest.approx(0.125, abs=0.026)


def test_a_way_may_leave_and_enter_a_submap_in_two_pieces() -> None:
    """Room 0 has a piece on both sides of a strip of room 1: only both together hold a way."""
    regions = two_rooms((5.3, 2.5, 5.5, 3.4))
    columns = np.arange(regions.owner.shape[1])[None, :]
    strip = (columns >= 95) & (columns < 100)
    owner = np.where(strip & (regions.owner == 0), 1, regions.owner)
    space = Space.of(Regions.of(regions.grid, owner))
    found = ways(space, anchors(space), [(0, 1)], RADIUS_M)[0, 1]
    assert found.path is not None
    assert least_room(regions.grid, found.path) >= RADIUS_M


def test_a_submap_where_the_robot_does_not_fit_has_an_anchor_and_no_way() -> None:
    cells = np.full((40, 60), OCCUPIED, dtype=np.uint8)
    cells[5:35, 5:35], cells[18:21, 35:55] = FREE, FREE
    owner = np.where(cells == FREE, (np.arange(60) >= 35)[None, :] * 1, NOBODY)
    way = way_of(Regions.of(GridMap(cells, 0.05), owner))
    assert way.path is None
    assert way.clearance_m == pytest.approx(0.075)
