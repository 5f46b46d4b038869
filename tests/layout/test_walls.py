"""The walls around nodes: gathered from the store, their sides, and the space seen free."""

from __future__ import annotations

import math
from dataclasses import astuple

import numpy as np
import pytest
from hypothesis import given
from scipy.spatial import cKDTree

from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2, compose
from specmap_cli.grids.score_field import ScoreField, thinned
from specmap_cli.layout.path_graph import Graph
from specmap_cli.layout.walls import Sides, Walls, from_behind
from tests.layout.driving import Drive, Laps, between, building, graph_by_hand, stored
from tests.strategies import poses
from tests.turning import turned

LOWER, UPPER = -1.0, 1.0  # y of a viewer on either side of a wall along x


def seen_from(perfect: Laps, row: int) -> FloatArray:
    """The thinned points of one node in its own frame."""
    store, graph = perfect
    return thinned(store.points(int(graph.nodes[row]), 30.0), 0.05)


def test_walls_are_those_of_neighbours_of_a_part_in_its_frame(perfect: Laps, walls: Walls) -> None:
    graph = perfect[1]
    first = int(np.argmax(graph.parts == 1))
    for row, reach in ((10, 3), (1, 3), (50, 0), (first, 4), (first - 1, 4)):
        expected = [
            between(graph.poses, row, k).apply(seen_from(perfect, k))
            for k in range(max(0, row - reach), row + reach + 1)
            if graph.parts[k] == graph.parts[row]
        ]
        assert np.allclose(walls.around(row, reach, graph.poses), np.concatenate(expected)), row


def test_farther_returns_are_no_walls(perfect: Laps, walls: Walls) -> None:
    poses = perfect[1].poses
    with turned("layout.path_graph", MATCH_RANGE_M=2.0):
        near = Walls(*perfect).around(20, 0, poses)
    assert 0 < len(near) < len(walls.around(20, 0, poses))
    assert np.hypot(*near.T).max() <= 2.0


def test_the_walls_of_many_nodes_lie_in_the_map_a_cell_apart(perfect: Laps, walls: Walls) -> None:
    rows, moved = list(range(0, 120, 2)), compose(np.array([5.0, -3.0, 0.7]), perfect[1].poses)
    gathered = walls.of_all(rows, moved)
    every = np.concatenate([Pose2(*moved[k].tolist()).apply(seen_from(perfect, k)) for k in rows])
    assert cKDTree(every).query(gathered)[0].max() < 1e-9, "points are seen ones"
    assert cKDTree(gathered).query(every)[0].max() < 0.05 * np.sqrt(2), "all are near one"
    cells = np.floor(gathered / 0.05)
    assert len(np.unique(cells, axis=0)) == len(cells)
    assert len(gathered) < 0.5 * len(every)
    assert walls.of_all([], moved).shape == (0, 2)


def test_more_nodes_than_are_remembered_are_read_again(drive: Drive) -> None:
    truth, scans = drive
    with stored(truth, scans) as store:
        walls = Walls(store, graph_by_hand(truth))
        before = walls.around(0, 0, truth)
        for row in range(300):
            walls.around(row, 0, truth)
        assert np.array_equal(walls.around(0, 0, truth), before)


def wall(y: float = 0.0, left: float = -2.0, right: float = 2.0) -> FloatArray:
    """Points 5 cm apart along x."""
    x = np.arange(left, right, 0.05)
    return np.column_stack([x, np.full(len(x), y)])


def seen(points: FloatArray, y: float) -> Sides:
    """The sides that a viewer at (0, y) sees."""
    return Sides.of(points, (0.0, y))


@pytest.mark.parametrize("y", [LOWER, UPPER])
@pytest.mark.parametrize("step", [1, -1])
def test_normals_point_to_the_viewer_whichever_way_the_beams_turn(y: float, step: int) -> None:
    sides = seen(wall()[::step], y)
    assert np.allclose(sides.normals[2:-2], (0.0, y))
    assert not sides.normals[[0, 1, -2, -1]].any(), "ends have no neighbours on both sides"


def test_posts_have_no_side() -> None:
    posts = np.column_stack([np.arange(8.0), np.zeros(8)])
    assert not seen(posts, LOWER).normals.any()
    assert not seen(np.zeros((9, 2)), LOWER).normals.any()
    assert seen(np.zeros((0, 2)), LOWER).normals.shape == (0, 2)


@given(poses)
def test_sides_turn_with_their_frame(pose: Pose2) -> None:
    here = seen(wall(), LOWER)
    x, y = pose.apply(np.array([[0.0, LOWER]]))[0].tolist()
    there = Sides.of(pose.apply(here.points), (x, y))
    assert np.allclose(here.placed(pose).normals, there.normals, atol=1e-6)
    assert np.array_equal(here.placed(pose).points, there.points)


@pytest.mark.parametrize("thick_m", [0.0, 0.1, 0.25])
@pytest.mark.parametrize("off_m", [0.0, -0.3, 0.3])
def test_the_other_side_is_known_as_such(thick_m: float, off_m: float) -> None:
    target, source = seen(wall(), LOWER), seen(wall(thick_m), UPPER)
    behind = from_behind(source, target, Pose2(0.0, off_m, 0.0), 0.3)
    assert behind[2:-2].all()
    assert not behind[[0, 1, -2, -1]].any(), "of these no side is known"


def test_what_is_not_seen_from_behind() -> None:
    """The same side, a wall seen from both sides, walls around a corner, and new walls."""
    lower, upper = seen(wall(), LOWER), seen(wall(0.2), UPPER)
    assert not from_behind(lower, lower, Pose2(0.0, 0.2, 0.1), 0.3).any()
    both = Sides(*np.concatenate([astuple(lower), astuple(upper)], axis=1))
    assert not from_behind(lower, both, IDENTITY, 0.3).any()
    assert not from_behind(upper, both, IDENTITY, 0.3).any()
    across = Pose2(-2.0, 0.0, math.pi / 2)
    for away in (across, Pose2(0.0, 3.0, 0.0), Pose2(50.0, 0.0, 0.0)):
        assert not from_behind(seen(wall(), UPPER).placed(away), lower, IDENTITY, 0.3).any()
    nothing = seen(np.zeros((0, 2)), UPPER)
    assert not from_behind(lower, nothing, IDENTITY, 0.3).any()
    assert from_behind(nothing, lower, IDENTITY, 0.3).shape == (0,)


def test_the_corridor_driven_is_free_and_the_rock_is_not(perfect: Laps, walls: Walls) -> None:
    graph, plan = perfect[1], building()
    rows = np.flatnonzero(graph.parts == 0).tolist()
    field = ScoreField.from_points(walls.of_all(rows, graph.poses), 0.25, 0.3)
    free = walls.seen_of_all(rows, graph.poses, field, 0.6)
    height, width = free.shape
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    centres = np.column_stack([x.ravel(), y.ravel()]) * 0.25 + field.origin
    cells = plan.cells_of(centres)
    inside = plan.inside(cells)
    wall_m = np.zeros(len(centres))
    wall_m[inside] = plan.obstacle_distance()[tuple(cells[inside].T)]
    middle = (centres[:, 0] > 1.8) & (centres[:, 0] < 17.2) & (wall_m > 0.6)
    middle &= (np.abs(centres[:, 1] - 2.5) < 0.3) | (np.abs(centres[:, 1] - 12.5) < 0.3)
    assert middle.sum() > 50
    assert free.ravel()[middle].all()
    rock = (np.abs(centres[:, 0] - 11.0) < 1.0) & (np.abs(centres[:, 1] - 8.5) < 0.5)
    assert rock.any()
    assert not free.ravel()[rock].any(), "the block inside the ring"


def test_what_is_free_lies_where_the_poses_put_it(graph: Graph, walls: Walls) -> None:
    poses, rows = graph.poses, [3, 40]
    moved = compose(np.array([50.0, -20.0, 0.0]), poses)
    here, there = (ScoreField.from_points(walls.of_all(rows, p), 0.25, 0.3) for p in (poses, moved))
    free = walls.seen_of_all(rows, poses, here, 0.6)
    assert free.any()
    assert not walls.seen_of_all(rows, moved, here, 0.6).any(), "far off this field"
    assert walls.seen_of_all(rows, moved, there, 0.6).sum() == free.sum()
    assert not walls.seen_of_all([], poses, here, 0.6).any()
