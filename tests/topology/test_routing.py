"""Routes through plans whose doors are known: the length, what they go through, and why not."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from specmap_cli.topology.navigation import Roads, Route
from tests.topology.rooms import regions_of, two_rooms
from tests.topology.test_ways import NARROW, NORTH, SOUTH, forbidden, two_doors

RADIUS_M = 0.2


def roads(*doors: Any, shut: tuple[int, ...] = ()) -> Roads:
    topology, regions = two_doors(*doors)
    topology = forbidden(topology, regions, *shut)
    return Roads(regions, topology.doors, topology.edges.values(), RADIUS_M)


def test_a_route_leads_from_place_to_place_through_the_door() -> None:
    (door,) = two_doors(NORTH)[0].doors
    found = roads(NORTH).route((1.0, 1.0), (9.0, 1.0))
    assert found
    assert found.why == ""
    assert found.points[[0, -1]].tolist() == [[1.0, 1.0], [9.0, 1.0]]
    assert found.length_m == pytest.approx(np.hypot(*np.diff(found.points, axis=0).T).sum())
    straight = sum(math.dist((door.x, door.y), end) for end in [(1.0, 1.0), (9.0, 1.0)])
    assert straight <= found.length_m < 1.1 * straight
    assert found.rooms == (0, 1)
    assert found.doors == (door,)
    assert found.clearance_m >= RADIUS_M


def test_a_route_within_a_room_is_straight_and_one_to_the_same_place_has_no_length() -> None:
    inside = roads(NORTH).route((1.0, 1.0), (4.0, 2.0))
    assert inside.length_m == pytest.approx(math.dist((1.0, 1.0), (4.0, 2.0)), rel=0.02)
    assert (inside.rooms, inside.doors) == ((0,), ())
    assert roads(NORTH).route((1.0, 1.0), (1.0, 1.0)).length_m == 0.0


def test_no_route_leads_through_what_is_forbidden_but_round_it_by_another_door() -> None:
    shut = roads(NORTH, shut=(0,)).route((1.0, 1.0), (9.0, 1.0))
    assert not shut
    assert (shut.rooms, shut.doors, len(shut.points), shut.length_m) == ((), (), 0, math.inf)
    assert shut.why == "it leads through what is forbidden: door 0, the link 0-1"
    direct = roads(NORTH, SOUTH).route((1.0, 1.0), (9.0, 1.0))
    (near,) = direct.doors
    around = roads(NORTH, SOUTH, shut=(near.id,)).route((1.0, 1.0), (9.0, 1.0))
    (far,) = around.doors
    assert far.id != near.id
    assert around.length_m > direct.length_m + 1.0
    regions = regions_of((9.8, 2.6), {0: [(0.3, 0.3, 5.0, 2.3)], 1: [(5.0, 0.3, 9.5, 2.3)]})
    topology, _ = two_doors(NORTH)
    link = replace(topology.edges[0, 1], forbidden=True)
    in_the_open = Roads(regions, (), [link], RADIUS_M).route((1.0, 1.0), (9.0, 1.0))
    assert in_the_open.why == "it leads through what is forbidden: the link 0-1"
    assert Roads(regions, (), [replace(link, forbidden=False)], RADIUS_M).route((1, 1), (9, 1))


@pytest.mark.parametrize(
    ("door", "goal", "why"),
    [
        (NARROW, (9.0, 1.0), "the widest way keeps 0.1"),
        ((5.3, 1.5, 5.3, 1.5), (9.0, 1.0), "no free cells of rooms join the two"),
        (NORTH, (50.0, 1.0), "can stand nowhere in a room within 1 m of 50, 1"),
    ],
)
def test_why_there_is_none(door: Any, goal: tuple[float, float], why: str) -> None:
    found: Route = Roads(two_rooms(door), (), [], RADIUS_M).route((1.0, 1.0), goal)
    assert why in found.why
