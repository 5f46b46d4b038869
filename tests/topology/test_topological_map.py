"""The parts of the topological map: what they hold, and that nobody changes them."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from specmap_cli.core.geometry import IDENTITY
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.topology.topological_map import (
    Edge,
    LogInfo,
    Submap,
    TopologicalMap,
    Traversal,
    Visit,
)

GRID = GridMap(np.zeros((2, 2), dtype=np.uint8), 0.1)
SUBMAP = Submap(id=3, map_from_submap=IDENTITY, grid=GRID)
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


def test_a_region_of_a_finished_map_was_never_visited() -> None:
    assert (SUBMAP.keyframes, SUBMAP.visits, SUBMAP.polygon, SUBMAP.name) == ((), (), None, "")


@pytest.mark.parametrize(
    ("record", "field"),
    [
        (SUBMAP, "name"),
        (Edge(source=0, target=1, kind="loose"), "kind"),
        (TopologicalMap(), "submaps"),
        (CROSSINGS[0], "theta"),
        (Visit(0, 1), "end_ns"),
        (LogInfo("a.mcap"), "scans"),
    ],
)
def test_nobody_changes_a_part_of_the_map(record: object, field: str) -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(record, field, None)


@pytest.mark.parametrize("record", [Submap, Edge, TopologicalMap])
def test_fields_are_given_by_name(record: type) -> None:
    with pytest.raises(TypeError, match="positional"):
        record(0, 1, "loose")


def test_another_name_is_another_submap() -> None:
    named = dataclasses.replace(SUBMAP, name="kitchen")
    assert (named.name, named.id, SUBMAP.name) == ("kitchen", 3, "")
    assert TopologicalMap() == TopologicalMap(submaps={}, edges={}, closures=())
