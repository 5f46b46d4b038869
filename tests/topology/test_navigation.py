"""A topological map with its doors, anchors and ways, and ways round forbidden doors."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from specmap_cli.core.geometry import Pose2
from specmap_cli.core.settings import WaysConfig
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.topology.navigation import Shut, with_detours, with_shut, with_ways
from specmap_cli.topology.regions import Regions
from specmap_cli.topology.topological_map import Edge, Submap, TopologicalMap, Traversal
from tests.topology.rooms import Box, regions_of, two_rooms

CONFIG = WaysConfig()
GRID = GridMap(np.zeros((2, 2), dtype=np.uint8), 0.1)
NORTH, SOUTH = (5.3, 4.4, 5.5, 5.3), (5.3, 1.5, 5.5, 2.2)


def map_of(regions: Regions, *edges: Edge) -> TopologicalMap:
    """The submaps of some regions, one a metre from the other, and edges."""
    submaps = {
        id_: Submap(id=id_, map_from_submap=Pose2(float(id_), 0.0, 0.0), grid=GRID)
        for id_ in regions.outlines
    }
    return TopologicalMap(submaps=submaps, edges={(e.source, e.target): e for e in edges})


def driven(y: float) -> Edge:
    crossing = Traversal(7, 0, 1, 5.4, y, 0.0)
    return Edge(source=0, target=1, kind="traversed", traversals=(crossing,))


def found_in(regions: Regions, *edges: Edge, **more: Any) -> TopologicalMap:
    return with_ways(map_of(regions, *edges), regions, CONFIG, **more)


def test_a_driven_edge_gets_its_way_and_its_door() -> None:
    found = found_in(two_rooms(NORTH), driven(4.8))
    (door,) = found.doors
    edge = found.edges[0, 1]
    assert (edge.kind, edge.doors, len(edge.traversals)) == ("traversed", (0,), 1)
    assert (edge.x, edge.y, edge.width_m) == (door.x, door.y, door.width_m)
    assert edge.crossing == (door.x, door.y)
    assert door.crossings == edge.traversals
    assert edge.path is not None
    ends = [list(found.submaps[id_].anchor or ()) for id_ in (0, 1)]
    assert edge.path[[0, -1]].tolist() == ends
    assert edge.clearance_m is not None
    assert edge.clearance_m >= CONFIG.robot_radius_m
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


def test_of_two_doors_the_way_names_the_one_it_goes_through() -> None:
    found = found_in(two_rooms(NORTH, SOUTH), driven(1.8))
    assert [door.driven for door in found.doors] == [True, False]
    edge = found.edges[0, 1]
    assert edge.path is not None
    (used,) = edge.doors
    door = found.doors[used]
    nearest = np.abs(edge.path[:, 0] - door.x).argmin()
    assert abs(edge.path[nearest, 1] - door.y) < 0.4


def test_an_edge_in_the_open_has_a_way_and_no_door() -> None:
    regions = regions_of((9.8, 2.6), {0: [(0.3, 0.3, 5.0, 2.3)], 1: [(5.0, 0.3, 9.5, 2.3)]})
    edge = found_in(regions).edges[0, 1]
    assert (edge.doors, edge.x, edge.y, edge.width_m) == ((), None, None, None)
    assert edge.length_m == pytest.approx(4.4, abs=0.1)


def test_an_edge_without_a_way_names_all_doors_and_the_widest_clearance() -> None:
    regions = two_rooms(NORTH, SOUTH)
    wide = WaysConfig(robot_radius_m=0.6)
    edge = with_ways(map_of(regions), regions, wide).edges[0, 1]
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


CROSSINGS = tuple(
    Traversal(stamp, 0, 1, x, y, 0.0) for stamp, x, y in ((1, 0.0, 3.0), (2, 2.0, 4.0))
)


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
    return found_in(regions, driven(4.8)), regions


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
