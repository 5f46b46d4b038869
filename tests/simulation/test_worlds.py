"""Worlds of a simulation: what stops a beam, and how far walls are."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given

from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from specmap_cli.simulation.worlds import World
from tests.strategies import grid_maps


def test_beams_end_at_unknown_cells_too() -> None:
    cells = np.full((20, 40), FREE, dtype=np.uint8)
    cells[:, 30:] = UNKNOWN
    world = World.of(GridMap(cells, 0.1, (5.0, 0.0)))
    ahead, back = world.cast(np.array([[6.0, 1.05]] * 2), np.array([0.0, np.pi]), 10.0)
    assert ahead == pytest.approx(2.0, abs=1e-5)
    assert back == np.inf  # off the plan


@given(grid_maps())
def test_everything_that_is_not_free_is_a_wall(plan: GridMap) -> None:
    before = plan.cells.copy()
    world = World.of(plan)
    np.testing.assert_array_equal(world.plan.cells == FREE, plan.cells == FREE)
    np.testing.assert_array_equal(world.plan.cells == OCCUPIED, plan.cells != FREE)
    np.testing.assert_array_equal(plan.cells, before)


@given(grid_maps(largest=12))
def test_clearance_is_that_to_the_nearest_wall_cell_less_half_a_cell(plan: GridMap) -> None:
    """Against every wall, one by one; what is off the plan is a wall, too."""
    world = World.of(plan)
    height, width = plan.cells.shape
    framed = np.pad(plan.free, 1)
    walls = np.argwhere(~framed) - 1
    everywhere = np.argwhere(np.ones((height, width), dtype=bool))
    gaps = np.linalg.norm(everywhere[:, None] - walls[None], axis=2).min(axis=1)
    expected = np.maximum(gaps * plan.resolution - 0.5 * plan.resolution, 0.0)
    expected[~plan.free.reshape(-1)] = 0.0
    found = world.clearance_at(plan.centres_of(everywhere))
    np.testing.assert_allclose(found, expected, atol=1e-6)
