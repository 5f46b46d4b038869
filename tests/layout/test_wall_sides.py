"""Sides of walls: which way they face, and which of them another place sees from behind."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given

from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2
from specmap_cli.layout.wall_sides import Sides, from_behind
from tests.strategies import poses

LOWER, UPPER = -1.0, 1.0  # y of a viewer on either side of a wall along x


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


def test_the_same_side_is_not() -> None:
    side = seen(wall(), LOWER)
    assert not from_behind(side, side, Pose2(0.0, 0.2, 0.1), 0.3).any()


def test_a_wall_that_was_seen_from_both_sides_is_not_seen_from_behind() -> None:
    both = Sides.joined([seen(wall(), LOWER), seen(wall(0.2), UPPER)])
    for side in (seen(wall(), LOWER), seen(wall(0.2), UPPER)):
        assert not from_behind(side, both, IDENTITY, 0.3).any()


def test_walls_around_a_corner_and_new_walls_are_not_seen_from_behind() -> None:
    across = Pose2(-2.0, 0.0, math.pi / 2)
    target = seen(wall(), LOWER)
    for away in (across, Pose2(0.0, 3.0, 0.0), Pose2(50.0, 0.0, 0.0)):
        assert not from_behind(seen(wall(), UPPER).placed(away), target, IDENTITY, 0.3).any()
    nothing = seen(np.zeros((0, 2)), UPPER)
    assert not from_behind(target, nothing, IDENTITY, 0.3).any()
    assert from_behind(nothing, target, IDENTITY, 0.3).shape == (0,)
