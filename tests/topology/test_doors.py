"""Doors of small plans whose walls are known to the centimetre."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, CellArray, GridMap
from specmap_cli.topology.doors import Passages, passages
from specmap_cli.topology.regions import NOBODY, Regions, Space
from specmap_cli.topology.topological_map import Door, Traversal
from tests.topology.rooms import Box, regions_of, two_rooms

LEAST_M = 0.5


def found(regions: Regions, *traversals: Traversal, least_m: float = LEAST_M) -> Passages:
    return passages(Space.of(regions), {(0, 1): traversals}, least_m)


def door_of(regions: Regions) -> Door:
    (door,) = found(regions).doors
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
    middle = to_picture @ [5.4 / 0.05, 2.95 / 0.05, 1.0] * 0.05
    assert math.dist((door.x, door.y), middle) < 0.2


def test_a_door_leads_from_the_smaller_id_to_the_larger() -> None:
    plan = two_rooms((5.3, 1.5, 5.5, 2.4))
    swapped = np.where(plan.owner == NOBODY, NOBODY, 1 - plan.owner)
    assert abs(door_of(Regions.of(plan.grid, swapped)).theta) == pytest.approx(math.pi)


def test_two_doors_between_two_rooms_are_two_and_each_has_its_traversals() -> None:
    through = crossing(5.5, 1.1), crossing(5.2, 4.9, 1), crossing(5.4, 1.3, 2)
    low, high = found(two_rooms((5.3, 4.4, 5.5, 5.1), (5.3, 0.8, 5.5, 1.7)), *through).doors
    assert (low.id, high.id) == (0, 1)
    assert (low.width_m, high.width_m) == pytest.approx((0.9, 0.7), abs=0.01)
    assert (low.y, high.y) == pytest.approx((1.25, 4.75), abs=0.05)
    assert low.crossings == (through[0], through[2])
    assert high.crossings == (through[1],)
    assert low.driven
    assert high.driven


def test_two_doors_are_two_though_the_border_lies_beyond_both() -> None:
    """Where the robot did not drive, a border lies in the room, and is one for both doors."""
    regions = regions_of(
        (9.8, 6.6),
        {1: [(5.5, 0.3, 9.5, 6.3)], 0: [(0.3, 0.3, 5.3, 6.3), (5.3, 2.0, 5.9, 4.0)]},
        [(5.3, 2.0, 5.5, 2.1), (5.3, 3.0, 5.5, 3.1), (5.3, 3.9, 5.5, 4.0)],
    )
    doors = found(regions).doors
    assert [door.y for door in doors] == pytest.approx([2.55, 3.5], abs=0.1)
    assert [door.width_m for door in doors] == pytest.approx([0.9, 0.8], abs=0.01)


def test_a_door_is_found_where_a_border_lies_beside_it() -> None:
    regions = two_rooms((5.3, 2.5, 5.5, 3.4))
    columns = np.arange(regions.owner.shape[1])[None, :]
    leaked = np.where((regions.owner == 1) & (columns < 120), 0, regions.owner)  # half a metre
    door = door_of(Regions.of(regions.grid, leaked))
    assert (door.x, door.width_m) == pytest.approx((5.4, 0.9), abs=0.12)


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
    ways = found(regions_of((9.8, 6.6), rooms))
    assert ways.doors == ()
    assert list(ways.openings) == [(0, 1)]


def test_a_gap_too_narrow_for_a_door_is_none_nor_are_there_any_without_borders() -> None:
    narrow = two_rooms((5.3, 1.5, 5.5, 1.9))
    assert found(narrow) == Passages((), {})
    assert len(found(narrow, least_m=0.4).doors) == 1
    assert found(regions_of((4.0, 4.0), {0: [(0.3, 0.3, 3.7, 3.7)]})) == Passages((), {})


def test_what_nobody_saw_is_no_part_of_a_door() -> None:
    plan = two_rooms((5.3, 1.5, 5.5, 2.6))
    cells = plan.grid.cells.copy()
    cells[30:36, 106:110] = UNKNOWN  # 0.3 m of the 1.1 m
    owner = np.where(cells == FREE, plan.owner, NOBODY)
    assert door_of(Regions.of(GridMap(cells, 0.05), owner)).width_m == pytest.approx(0.8)


def test_a_door_at_the_edge_of_the_map_ends_there() -> None:
    cells = np.full((40, 80), FREE, dtype=np.uint8)
    cells[14:, 38:42] = OCCUPIED
    owner = np.where(cells == FREE, (np.arange(80) >= 40)[None, :] * 1, NOBODY)
    assert door_of(Regions.of(GridMap(cells, 0.05), owner)).width_m == pytest.approx(0.7)


def test_who_crosses_in_the_open_goes_through_no_door() -> None:
    regions = regions_of(
        (9.8, 6.6), {0: [(0.3, 0.3, 5.3, 6.3)], 1: [(5.3, 0.3, 9.5, 6.3)]}, [(5.2, 1.5, 5.4, 3.0)]
    )
    ways = found(regions, crossing(5.3, 5.0))
    assert (0, 1) in ways.openings
    assert not any(door.driven for door in ways.doors)
