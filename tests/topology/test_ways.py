"""Doors of plans that are known to the centimetre, anchors, and ways; some are forbidden."""

import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import cv2
import networkx as nx
import numpy as np
import pytest
from scipy import ndimage

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import IntArray
from specmap_cli.core.settings import WaysConfig
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, CellArray, GridMap
from specmap_cli.topology.doors import passages
from specmap_cli.topology.navigation import Shut, with_detours, with_shut, with_ways
from specmap_cli.topology.regions import NOBODY, Regions, Space
from specmap_cli.topology.topological_map import Door, Edge, Submap, TopologicalMap, Traversal
from specmap_cli.topology.ways import Anchor, Way, anchors_of, cells_on, tree, ways
from tests.topology.rooms import Box, regions_of, two_rooms


def found_between(
    regions: Regions, *traversals: Traversal, least_m: float = 0.5
) -> tuple[tuple[Door, ...], dict[tuple[int, int], FloatArray]]:
    return passages(Space.of(regions), {(0, 1): traversals}, least_m)


def door_of(regions: Regions) -> Door:
    (door,), _ = found_between(regions)
    return door


def crossing(x: float, y: float, stamp: int = 0) -> Traversal:
    return Traversal(stamp, 0, 1, x, y, 0.0)


@pytest.mark.parametrize("width", [0.6, 0.7, 0.75, 0.9, 1.0, 1.4, 2.0])
def test_a_door_is_where_its_walls_are_and_as_wide(width: float) -> None:
    door = door_of(two_rooms((5.3, 1.5, 5.5, 1.5 + width)))
    assert (door.id, door.between, door.driven) == (0, (0, 1), False)
    assert (door.x, door.y) == pytest.approx((5.4, 1.5 + width / 2), abs=0.12)
    assert door.width_m == pytest.approx(width, abs=0.01)
    assert door.theta == pytest.approx(0.0)
    low, high = door.sides
    assert (low[1], high[1]) == pytest.approx((1.5, 1.5 + width), abs=0.01)
    assert low[0] == high[0]


@pytest.mark.parametrize("degrees", [0, 15, 30, 45, 70, 90, 135, 200, 300])
def test_a_building_may_stand_at_any_angle(degrees: int) -> None:
    upright = two_rooms((5.3, 2.5, 5.5, 3.4))
    to_picture = cv2.getRotationMatrix2D((98.0, 66.0), -degrees, 1.0)
    to_picture = to_picture + [[0.0, 0.0, 60.0], [0.0, 0.0, 100.0]]

    def turned(picture: CellArray, outside: int) -> CellArray:
        found = cv2.warpAffine(
            picture, to_picture, (320, 330), flags=cv2.INTER_NEAREST, borderValue=(outside,)
        )
        return np.asarray(found, dtype=np.uint8)

    cells = turned(upright.grid.cells, UNKNOWN)
    owner = turned((upright.owner + 1).astype(np.uint8), 0).astype(np.int64) - 1
    door = door_of(Regions.of(GridMap(cells, 0.05), owner))
    assert door.width_m == pytest.approx(0.9, abs=0.1)
    assert math.cos(door.theta - math.radians(degrees)) > math.cos(0.25)
    assert math.dist((door.x, door.y), to_picture @ [5.4 / 0.05, 2.95 / 0.05, 1.0] * 0.05) < 0.2


def test_two_doors_between_two_rooms_are_two_and_each_has_its_traversals() -> None:
    through = crossing(5.5, 1.1), crossing(5.2, 4.9, 1), crossing(5.4, 1.3, 2)
    (low, high), _ = found_between(two_rooms((5.3, 4.4, 5.5, 5.1), (5.3, 0.8, 5.5, 1.7)), *through)
    assert (low.id, high.id) == (0, 1)
    assert (low.width_m, high.width_m) == pytest.approx((0.9, 0.7), abs=0.01)
    assert (low.y, high.y) == pytest.approx((1.25, 4.75), abs=0.05)
    assert low.crossings == (through[0], through[2])
    assert high.crossings == (through[1],)
    assert low.driven
    assert high.driven


def test_two_doors_are_two_though_the_border_lies_beyond_both() -> None:
    """Where the robot did not drive, a border lies in the room, and is one for both doors."""
    rooms = {1: [(5.5, 0.3, 9.5, 6.3)], 0: [(0.3, 0.3, 5.3, 6.3), (5.3, 2.0, 5.9, 4.0)]}
    posts = [(5.3, 2.0, 5.5, 2.1), (5.3, 3.0, 5.5, 3.1), (5.3, 3.9, 5.5, 4.0)]
    doors, _ = found_between(regions_of((9.8, 6.6), rooms, posts))
    assert [door.y for door in doors] == pytest.approx([2.55, 3.5], abs=0.1)
    assert [door.width_m for door in doors] == pytest.approx([0.9, 0.8], abs=0.01)


@pytest.mark.parametrize(
    "rooms",
    [
        {0: [(0.3, 0.3, 5.0, 2.3)], 1: [(5.0, 0.3, 9.5, 2.3)]},  # a corridor in two pieces
        {0: [(0.3, 0.3, 5.0, 2.3)], 1: [(5.0, 0.3, 9.5, 6.3)]},  # a corridor that ends in a hall
        {0: [(0.3, 0.3, 9.5, 2.3)], 1: [(2.0, 2.3, 8.0, 6.3)]},  # an alcove
    ],
    ids=["corridor", "hall", "alcove"],
)
def test_a_border_in_the_open_is_no_door(rooms: dict[int, list[Box]]) -> None:
    doors, openings = found_between(regions_of((9.8, 6.6), rooms))
    assert doors == ()
    assert list(openings) == [(0, 1)]


def test_a_gap_too_narrow_for_a_door_is_none_nor_are_there_any_without_borders() -> None:
    narrow = two_rooms((5.3, 1.5, 5.5, 1.9))
    assert found_between(narrow) == ((), {})
    assert len(found_between(narrow, least_m=0.4)[0]) == 1
    assert found_between(regions_of((4.0, 4.0), {0: [(0.3, 0.3, 3.7, 3.7)]})) == ((), {})


def test_a_door_ends_at_what_nobody_saw_and_at_the_edge_of_the_map() -> None:
    plan = two_rooms((5.3, 1.5, 5.5, 2.6))
    cells = plan.grid.cells.copy()
    cells[30:36, 106:110] = UNKNOWN  # 0.3 m of the 1.1 m
    owner = np.where(cells == FREE, plan.owner, NOBODY)
    assert door_of(Regions.of(GridMap(cells, 0.05), owner)).width_m == pytest.approx(0.8)
    cells = np.full((40, 80), FREE, dtype=np.uint8)
    cells[14:, 38:42] = OCCUPIED
    owner = np.where(cells == FREE, (np.arange(80) >= 40)[None, :] * 1, NOBODY)
    assert door_of(Regions.of(GridMap(cells, 0.05), owner)).width_m == pytest.approx(0.7)


def test_who_crosses_in_the_open_goes_through_no_door() -> None:
    rooms = {0: [(0.3, 0.3, 5.3, 6.3)], 1: [(5.3, 0.3, 9.5, 6.3)]}
    regions = regions_of((9.8, 6.6), rooms, [(5.2, 1.5, 5.4, 3.0)])
    doors, openings = found_between(regions, crossing(5.3, 5.0))
    assert (0, 1) in openings
    assert not any(door.driven for door in doors)


def test_a_crossing_counts_for_a_door_no_farther_than_that_is_wide() -> None:
    plan = two_rooms((5.3, 1.5, 5.5, 2.4))
    for y, driven in ((2.0, True), (3.2, True), (3.4, False)):
        ((door,), _) = found_between(plan, crossing(5.4, y))
        assert door.driven == driven


def test_what_narrows_within_one_submap_is_no_door_of_another_along_it() -> None:
    """A person split a corridor along its wall: a strip of it is part of the room at its foot."""
    room = [(0.3, 0.3, 4.2, 2.3), (4.0, 2.3, 4.2, 11.7)]
    corridor = {0: [(4.2, 0.3, 6.0, 11.7)], 1: room}
    doors, openings = found_between(regions_of((6.3, 12.0), corridor, [(5.4, 6.0, 6.0, 7.0)]))
    assert doors == ()
    assert list(openings) == [(0, 1)]


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


def way_of(regions: Regions) -> Any:
    space = Space.of(regions)
    return ways(space, anchors(space), [(0, 1)], RADIUS_M)[0, 1]


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
    np.testing.assert_allclose(space.clearance(), np.maximum(room_of(space.grid), 0.0))
    corridor = Space.of(regions_of((4.0, 1.0), {0: [(0.2, 0.2, 3.8, 0.75)]}))  # 11 cells wide
    assert corridor.clearance().max() == pytest.approx(0.55 / 2)


def test_an_anchor_keeps_off_a_door_though_the_middle_of_the_submap_is_there() -> None:
    """The middle of a bent corridor lies beside it, and the nearest of its cells in a doorway."""
    bent = [(0.3, 0.3, 1.9, 9.3), (1.9, 7.7, 9.3, 9.3), (1.9, 5.6, 2.1, 6.6)]
    space = Space.of(regions_of((9.6, 9.6), {0: bent, 1: [(2.1, 3.0, 9.3, 7.5)]}))
    door = Door(id=0, x=2.0, y=6.1, width_m=1.0, theta=0.0, between=(0, 1))
    for doors, is_off in (((), False), ((door,), True)):
        found = anchors_of(space, NOWHERE, RADIUS_M, 0.1, doors)[0]
        x, y = space.place(np.array(found.cell))
        away_m = math.hypot(x - 2.0, max(abs(y - 6.1) - 0.5, 0.0))
        assert (away_m >= 2.0 * RADIUS_M + 0.1) == is_off
        assert found.clearance_m >= RADIUS_M + 0.1


def test_an_anchor_is_in_the_middle_of_a_room_but_keeps_off_a_table_there() -> None:
    room = [(0.3, 0.3, 4.7, 3.7)]
    _, anchor, place = anchored((5.0, 4.0), room)
    assert place == pytest.approx((2.5, 2.0), abs=0.05)
    assert anchor.clearance_m == pytest.approx(1.7, abs=0.06)
    space, anchor, place = anchored((5.0, 4.0), room, (2.0, 1.5, 3.0, 2.5))
    assert anchor.clearance_m >= 0.3
    assert math.dist(place, (2.5, 2.0)) < 1.0
    assert anchor.clearance_m == pytest.approx(room_of(space.grid)[anchor.cell])


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
    free, price = rng.random((12, 20)) < 0.75, 1.0 + rng.random((12, 20))
    free[0, 0] = True
    found = tree(np.argwhere(free) + np.array([3, 5]), price[free], (3, 5))
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


def told(cells: IntArray) -> set[tuple[int, ...]]:
    return {tuple(cell) for cell in cells.tolist()}


@pytest.mark.parametrize("seed", range(6))
def test_all_cells_under_a_line_are_known(seed: int) -> None:
    start, end = np.random.default_rng(seed).integers(0, 30, (2, 2))
    cells, lengths = cells_on(start, end)
    assert lengths.sum() == pytest.approx(math.dist(start, end))
    points = start + np.linspace(0.0, 1.0, 5000)[:, None] * (end - start)
    assert told(np.rint(points).astype(int)) <= told(cells)
    corner, _ = cells_on(np.array([0, 0]), np.array([1, 1]))
    assert told(corner) == {(0, 0), (0, 1), (1, 0), (1, 1)}, "through a corner it touches four"


def test_a_way_leads_straight_through_a_door_in_line() -> None:
    way = way_of(two_rooms((5.3, 2.85, 5.5, 3.75)))
    assert way.path[[0, -1]] == pytest.approx(np.array([[2.8, 3.3], [7.5, 3.3]]), abs=0.06)
    assert way.length_m == pytest.approx(4.7, abs=0.1)
    assert way.clearance_m == pytest.approx(0.45, abs=0.03)
    assert len(way.path) <= 4


@pytest.mark.parametrize("seed", range(8))
def test_ways_keep_the_radius_off_all_things(seed: int) -> None:
    regions = cluttered(seed)
    way = way_of(regions)
    least = least_room(regions.grid, way.path)
    assert least >= RADIUS_M
    assert least == pytest.approx(way.clearance_m, abs=0.03)
    assert way.length_m >= math.dist(way.path[0], way.path[-1]) - 1e-9


def test_ways_stay_in_their_two_submaps() -> None:
    """A corridor joins both rooms, too: that is the way of other edges."""
    rooms = {
        0: [(0.3, 0.3, 4.3, 4.0), (4.3, 1.0, 4.5, 1.25)],  # and a slit
        1: [(4.5, 0.3, 9.0, 4.0)],
        2: [(0.3, 4.2, 9.0, 6.0), (1.0, 4.0, 2.0, 4.2), (7.0, 4.0, 8.0, 4.2)],
    }
    way = way_of(regions_of((9.3, 6.3), rooms))
    assert way.path is None
    assert way.clearance_m == pytest.approx(0.125, abs=0.026)


def test_a_way_may_leave_and_enter_a_submap_in_two_pieces() -> None:
    """Room 0 has a piece on both sides of a strip of room 1: only both together hold a way."""
    regions = two_rooms((5.3, 2.5, 5.5, 3.4))
    columns = np.arange(regions.owner.shape[1])[None, :]
    strip = (columns >= 95) & (columns < 100)
    owner = np.where(strip & (regions.owner == 0), 1, regions.owner)
    assert least_room(regions.grid, way_of(Regions.of(regions.grid, owner)).path) >= RADIUS_M


def test_a_submap_where_the_robot_does_not_fit_has_an_anchor_and_no_way() -> None:
    cells = np.full((40, 60), OCCUPIED, dtype=np.uint8)
    cells[5:35, 5:35], cells[18:21, 35:55] = FREE, FREE
    owner = np.where(cells == FREE, (np.arange(60) >= 35)[None, :] * 1, NOBODY)
    way = way_of(Regions.of(GridMap(cells, 0.05), owner))
    assert way.path is None
    assert way.clearance_m == pytest.approx(0.075)
    assert way_of(two_rooms()) == Way(None, None), "they do not touch"


CONFIG = WaysConfig()
GRID = GridMap(np.zeros((2, 2), dtype=np.uint8), 0.1)
DRIVEN = Edge(source=0, target=1, kind="traversed", traversals=(crossing(5.4, 4.8, 7),))
NORTH, SOUTH = (5.3, 4.4, 5.5, 5.3), (5.3, 1.5, 5.5, 2.2)


def map_of(regions: Regions, *edges: Edge) -> TopologicalMap:
    """The submaps of some regions, one a metre from the other, and edges."""
    submaps = {
        id_: Submap(id=id_, map_from_submap=Pose2(float(id_), 0.0, 0.0), grid=GRID)
        for id_ in regions.outlines
    }
    return TopologicalMap(submaps=submaps, edges={(e.source, e.target): e for e in edges})


def found_in(regions: Regions, *edges: Edge, **more: Any) -> TopologicalMap:
    return with_ways(map_of(regions, *edges), regions, CONFIG, **more)


def test_a_driven_edge_gets_its_way_and_its_door() -> None:
    found = found_in(two_rooms(NORTH), DRIVEN)
    (door,) = found.doors
    edge = found.edges[0, 1]
    assert (edge.kind, edge.doors, len(edge.traversals)) == ("traversed", (0,), 1)
    assert (edge.x, edge.y, edge.width_m) == (door.x, door.y, door.width_m)
    assert edge.crossing == (door.x, door.y)
    assert door.crossings == edge.traversals
    assert edge.path is not None
    assert edge.path[[0, -1]].tolist() == [list(found.submaps[id_].anchor or ()) for id_ in (0, 1)]
    assert (edge.clearance_m or 0.0) >= CONFIG.robot_radius_m
    assert found.robot_radius_m == 0.2
    assert found.joined == [(0, 1)]


@pytest.mark.parametrize("kind", ["seen", "doorway"])
def test_submaps_that_only_touch_are_joined(kind: str) -> None:
    found = found_in(two_rooms(NORTH), kind=kind)
    edge = found.edges[0, 1]
    assert (edge.kind, edge.traversals, edge.doors) == (kind, (), (0,))
    assert edge.source_from_target == Pose2(1.0, 0.0, 0.0)
    assert not found.doors[0].driven
    assert found.joined == ([] if kind == "seen" else [(0, 1)])


def test_an_edge_in_the_open_has_a_way_and_no_door() -> None:
    regions = regions_of((9.8, 2.6), {0: [(0.3, 0.3, 5.0, 2.3)], 1: [(5.0, 0.3, 9.5, 2.3)]})
    edge = found_in(regions).edges[0, 1]
    assert (edge.doors, edge.x, edge.y, edge.width_m) == ((), None, None, None)
    assert edge.length_m == pytest.approx(4.4, abs=0.1)


def test_an_edge_without_a_way_names_all_doors_and_the_widest_clearance() -> None:
    regions = two_rooms(NORTH, SOUTH)
    edge = with_ways(map_of(regions), regions, WaysConfig(robot_radius_m=0.6)).edges[0, 1]
    assert (edge.path, edge.length_m, edge.doors) == (None, None, (0, 1))
    assert edge.clearance_m == pytest.approx(0.45, abs=0.03)


def test_submaps_without_cells_have_no_anchor_and_their_edges_no_way() -> None:
    regions = two_rooms()
    lone = Submap(id=5, map_from_submap=Pose2(0.0, 0.0, 0.0), grid=GRID)
    topology = map_of(regions, Edge(source=0, target=5, kind="loose"))
    topology = replace(topology, submaps={**topology.submaps, 5: lone})
    found = with_ways(topology, regions, CONFIG)
    assert found.submaps[5].anchor is None
    edge = found.edges[0, 5]
    assert (edge.kind, edge.path, edge.clearance_m) == ("loose", None, None)


def test_where_a_laser_hit_a_wall_its_surface_is_inside_the_cell() -> None:
    regions = two_rooms(NORTH)
    drawn = found_in(regions).doors[0]
    scanned = found_in(regions, stood=np.array([[2.0, 2.0]])).doors[0]
    assert drawn.width_m == pytest.approx(0.9)
    assert scanned.width_m == pytest.approx(0.9 + regions.grid.resolution)


def test_a_map_of_nothing_stays_one_and_the_robot_may_have_stood_off_the_grid() -> None:
    found = found_in(regions_of((1.0, 1.0), {}))
    assert (found.doors, dict(found.edges), dict(found.submaps)) == ((), {}, {})
    stood = np.array([[2.0, 2.0, 0.0], [-50.0, 3.0, 0.0]])
    assert found_in(two_rooms(NORTH), stood=stood).submaps[0].anchor is not None


CROSSINGS = crossing(0.0, 3.0, 1), crossing(2.0, 4.0, 2)


@pytest.mark.parametrize(
    ("known", "crossing"),
    [
        ({}, None),
        ({"x": 5.0, "y": 6.0}, (5.0, 6.0)),
        ({"traversals": CROSSINGS}, (1.0, 3.5)),
        ({"traversals": CROSSINGS, "x": 1.000001, "y": 3.5}, (1.0, 3.5)),  # as it was written
        ({"traversals": CROSSINGS[:1], "doors": (0,), "x": 5.0, "y": 6.0}, (5.0, 6.0)),
    ],
)
def test_an_edge_is_crossed_at_its_door_or_where_it_was_driven(
    known: dict[str, Any], crossing: tuple[float, float] | None
) -> None:
    assert Edge(source=0, target=1, kind="traversed", **known).crossing == crossing


NARROW = (5.3, 1.5, 5.5, 1.8)  # the robot does not fit through


def two_doors(*doors: Box) -> tuple[TopologicalMap, Regions]:
    regions = two_rooms(*doors)
    return found_in(regions, DRIVEN), regions


def forbidden(topology: TopologicalMap, regions: Regions, *doors: int) -> TopologicalMap:
    shut = Shut(doors=frozenset(doors))
    return with_shut(with_detours(topology, regions, shut.doors), shut)


def test_the_way_leads_through_the_door_that_is_left() -> None:
    topology, regions = two_doors(NORTH, SOUTH)
    before = topology.edges[0, 1]
    (used,) = before.doors
    (other,) = {door.id for door in topology.doors} - {used}
    around = forbidden(topology, regions, used)
    edge = around.edges[0, 1]
    assert (edge.doors, edge.forbidden) == ((other,), False)
    assert (edge.x, edge.y) == (around.doors[other].x, around.doors[other].y)
    assert edge.path is not None
    assert edge.path[[0, -1]].tolist() == [list(around.submaps[k].anchor or ()) for k in (0, 1)]
    assert (edge.path[1:-1, 1] < 3.3).all(), "it was north of the middle before"
    assert edge.length_m == pytest.approx(np.hypot(*np.diff(edge.path, axis=0).T).sum())
    assert [door.forbidden for door in around.doors] == [door.id == used for door in topology.doors]
    back = forbidden(around, regions)  # allowed again
    assert replace(back.edges[0, 1], path=None) == replace(before, path=None)
    assert back.doors == topology.doors
    beside = forbidden(topology, regions, other).edges[0, 1]  # not on the way
    assert not beside.forbidden
    for same in (back.edges[0, 1], beside):
        np.testing.assert_array_equal(same.path, before.path)


@pytest.mark.parametrize("doors", [(NORTH, NARROW), (NORTH, SOUTH), (NORTH,)])
def test_a_link_without_another_way_is_forbidden(doors: tuple[Box, ...]) -> None:
    topology, regions = two_doors(*doors)
    shut = [door.id for door in topology.doors if NARROW not in doors or door.y > 3.0]
    around = forbidden(topology, regions, *shut)
    assert around.edges[0, 1].forbidden
    np.testing.assert_array_equal(around.edges[0, 1].path, topology.edges[0, 1].path)
