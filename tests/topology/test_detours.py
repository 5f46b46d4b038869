"""Of two doors one is forbidden: the way leads through the other, and back when it is allowed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from specmap_cli.core.settings import WaysConfig
from specmap_cli.topology.navigation import Shut, with_detours, with_shut, with_ways
from specmap_cli.topology.regions import Regions
from specmap_cli.topology.topological_map import TopologicalMap
from tests.topology.rooms import two_rooms
from tests.topology.test_navigation import NORTH, SOUTH, driven, map_of

NARROW = (5.3, 1.5, 5.5, 1.8)  # the robot does not fit through


def two_doors(*doors: tuple[float, float, float, float]) -> tuple[TopologicalMap, Regions]:
    regions = two_rooms(*doors)
    return with_ways(map_of(regions, driven(4.8)), regions, WaysConfig()), regions


def forbidden(topology: TopologicalMap, regions: Regions, *doors: int) -> TopologicalMap:
    shut = Shut(doors=frozenset(doors))
    return with_shut(with_detours(topology, regions, shut.doors), shut)


def test_the_way_leads_through_the_door_that_is_left() -> None:
    topology, regions = two_doors(NORTH, SOUTH)
    (used,) = topology.edges[0, 1].doors
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


def test_allowed_again_the_way_is_as_before() -> None:
    topology, regions = two_doors(NORTH, SOUTH)
    (used,) = topology.edges[0, 1].doors
    back = forbidden(forbidden(topology, regions, used), regions)
    assert np.array_equal(back.edges[0, 1].path, topology.edges[0, 1].path)  # type: ignore[arg-type]
    assert replace(back.edges[0, 1], path=None) == replace(topology.edges[0, 1], path=None)
    assert back.doors == topology.doors


@pytest.mark.parametrize("doors", [(NORTH, NARROW), (NORTH, SOUTH), (NORTH,)])
def test_a_link_without_another_way_is_forbidden(
    doors: tuple[tuple[float, float, float, float], ...],
) -> None:
    topology, regions = two_doors(*doors)
    shut = [door.id for door in topology.doors if NARROW not in doors or door.y > 3.0]
    around = forbidden(topology, regions, *shut)
    assert around.edges[0, 1].forbidden
    assert np.array_equal(around.edges[0, 1].path, topology.edges[0, 1].path)  # type: ignore[arg-type]


def test_a_door_that_is_not_on_the_way_changes_nothing() -> None:
    topology, regions = two_doors(NORTH, SOUTH)
    (used,) = topology.edges[0, 1].doors
    (other,) = {door.id for door in topology.doors} - {used}
    around = forbidden(topology, regions, other)
    assert np.array_equal(around.edges[0, 1].path, topology.edges[0, 1].path)  # type: ignore[arg-type]
    assert not around.edges[0, 1].forbidden
