"""Space that was seen free, where a robot may stand."""

from __future__ import annotations

import numpy as np

from specmap_cli.core.geometry import compose
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.grids.score_field import ScoreField
from specmap_cli.layout.path_graph import Graph
from specmap_cli.layout.standable import seen_free
from specmap_cli.layout.walls import Walls
from tests.layout.driving import building

Perfect = tuple[KeyframeStore, Graph]


def test_the_corridor_that_was_driven_is_free_and_the_rock_is_not(perfect: Perfect) -> None:
    store, graph = perfect
    walls, plan = Walls(store, graph, 12.0), building()
    rows = np.flatnonzero(graph.parts == 0).tolist()
    field = ScoreField.from_points(walls.of_all(rows, graph.poses), 0.25, 0.3)
    seen = seen_free(walls, rows, graph.poses, field)
    height, width = seen.shape
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    centres = np.column_stack([x.ravel(), y.ravel()]) * 0.25 + field.origin
    cells = plan.cells_of(centres)
    inside = plan.inside(cells)
    wall_m = np.zeros(len(centres))
    wall_m[inside] = plan.obstacle_distance()[cells[inside, 0], cells[inside, 1]]
    ring = seen.ravel()
    middle = (centres[:, 0] > 1.8) & (centres[:, 0] < 17.2) & (wall_m > 0.6)
    middle &= (np.abs(centres[:, 1] - 2.5) < 0.3) | (np.abs(centres[:, 1] - 12.5) < 0.3)
    assert middle.sum() > 50
    assert ring[middle].all()
    rock = (np.abs(centres[:, 0] - 11.0) < 1.0) & (np.abs(centres[:, 1] - 8.5) < 0.5)
    assert rock.any()
    assert not ring[rock].any(), "the block inside the ring"


def test_it_lies_where_the_poses_put_it(perfect: Perfect) -> None:
    store, graph = perfect
    walls, rows, away = Walls(store, graph, 12.0), [3, 40], np.array([50.0, -20.0, 0.0])
    field = ScoreField.from_points(walls.of_all(rows, graph.poses), 0.25, 0.3)
    here = seen_free(walls, rows, graph.poses, field)
    moved = compose(away, graph.poses)
    there = seen_free(walls, rows, moved, field)
    assert here.any()
    assert not there.any(), "far off this field"
    field = ScoreField.from_points(walls.of_all(rows, moved), 0.25, 0.3)
    assert seen_free(walls, rows, moved, field).sum() == here.sum()
    assert not seen_free(walls, [], graph.poses, field).any()
