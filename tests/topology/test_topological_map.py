"""The parts of the topological map: where an edge is crossed."""

from __future__ import annotations

from typing import Any

import pytest

from specmap_cli.topology.topological_map import Edge, Traversal

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
