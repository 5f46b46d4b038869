"""How far a motion can be trusted: by its length, and by the walls in sight."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.grids.matching import observability
from specmap_cli.layout.motion_edges import (
    _RANGE_NOISE_M,
    guess_information,
    motion_links,
    step_information,
)
from tests.layout.driving import between
from tests.strategies import angles, seeds
from tests.turning import turned

NOTHING = np.zeros((0, 2))


def information_of(step: Pose2, points: FloatArray) -> FloatArray:
    """Of one motion that ends where these points are seen."""
    fisher = observability(points, _RANGE_NOISE_M)[None]
    (information,) = step_information([step], fisher)
    return np.asarray(information)


def outline(seed: int) -> FloatArray:
    """Points of a wobbly room in order of bearing, some too far apart for one surface."""
    rng = np.random.default_rng(seed)
    bearings = np.linspace(-np.pi, np.pi, 90, endpoint=False)
    ranges = 2.0 + rng.uniform(0, 0.05, 90) + (rng.random(90) < 0.1)
    return np.column_stack([ranges * np.cos(bearings), ranges * np.sin(bearings)])


def by_loops(points: FloatArray, noise_m: float) -> FloatArray:
    """The sum of J^T J / sigma^2, a point at a time."""
    total = np.zeros((3, 3))
    for before, (x, y), after in zip(points, points[1:], points[2:], strict=False):
        dx, dy = after - before
        length = np.hypot(dx, dy)
        if 1e-6 < length < 0.6:
            nx, ny = -dy / length, dx / length
            row = np.array([nx, ny, x * ny - y * nx]) / noise_m
            total += np.outer(row, row)
    return total


def test_a_bare_corridor_leaves_the_way_along_it_open() -> None:
    x = np.linspace(-5, 5, 100)
    walls = np.vstack([np.column_stack([x, x * 0 - 1]), np.column_stack([-x, x * 0 + 1])])
    fisher = observability(walls, 0.1)
    assert fisher[0, 0] < 1e-6 * fisher[1, 1]
    sigma = np.sqrt(np.diag(np.linalg.inv(information_of(Pose2(0.3, 0, 0), walls))))
    assert sigma[0] > 0.25
    assert sigma[1] < 0.05
    end = np.column_stack([x * 0 + 5, np.linspace(-1, 1, 100)])
    closed = information_of(Pose2(0.3, 0, 0), np.vstack([walls, end]))
    assert np.sqrt(np.linalg.inv(closed)[0, 0]) < 0.05


@given(seeds, st.floats(0.01, 0.5))
def test_what_walls_tell_is_the_sum_over_their_points(seed: int, noise_m: float) -> None:
    points = outline(seed)
    assert np.allclose(observability(points, noise_m), by_loops(points, noise_m))


@given(seeds, angles)
def test_a_turned_robot_sees_as_much(seed: int, angle: float) -> None:
    points = outline(seed)
    turn = np.eye(3)
    turn[:2, :2] = Pose2(0.0, 0.0, angle).rotation()
    turned = observability(Pose2(0.0, 0.0, angle).apply(points), 0.1)
    assert np.allclose(turned, turn @ observability(points, 0.1) @ turn.T, atol=1e-6)


@pytest.mark.parametrize(
    "points",
    [
        NOTHING,
        np.array([[1.0, 0.0], [1.0, 0.1]]),
        np.array([[1.0, 0.0], [1.0, 1.0], [1.0, 2.0]]),  # a metre apart
        np.ones((5, 2)),  # no direction
    ],
)
def test_too_few_or_scattered_points_tell_nothing(points: FloatArray) -> None:
    assert np.array_equal(observability(points, 0.1), np.zeros((3, 3)))
    blind = np.linalg.inv(information_of(Pose2(0.0, 0.0, 0.0), points))
    guess = np.linalg.inv(guess_information())
    assert np.allclose(blind, guess + np.diag([0.01**2, 0.01**2, 0.003**2]))


@given(st.floats(0, 5), st.floats(0, 5), st.floats(0, 3), st.floats(0, 3))
def test_a_longer_motion_is_known_less_well(
    short: float, more: float, turn: float, further: float
) -> None:
    points = outline(1)
    near = np.linalg.inv(information_of(Pose2(short, 0.0, turn), points))
    far = np.linalg.inv(information_of(Pose2(short + more, 0.0, turn + further), points))
    assert (np.diag(far) >= np.diag(near) - 1e-12).all()
    assert np.allclose(near, near.T)
    assert (np.linalg.eigvalsh(near) > 0).all()


def test_the_noise_of_a_motion_is_set() -> None:
    noise = {"_STEP_SHARE": 0.3, "_TURN_SHARE": 0.2, "GUESS_M": 1e-6, "_GUESS_RAD": 1e-6}
    with turned("layout.motion_edges", **noise):
        spread = np.linalg.inv(information_of(Pose2(2.0, 0.0, 0.5), NOTHING))
    assert np.sqrt(np.diag(spread)) == pytest.approx([0.61, 0.61, 0.103], rel=1e-4)


def test_each_node_is_linked_to_the_next_and_loosely_over_a_break(store: KeyframeStore) -> None:
    nodes = np.array([0, 3, 7, 20])
    links = motion_links(store, nodes, {7: None})
    assert [(edge.source, edge.target, edge.kind) for edge in links] == [
        (0, 3, "odometry"),
        (3, 7, "loose"),
        (7, 20, "odometry"),
    ]
    for edge in links:
        expected = between(store.poses, edge.source, edge.target)
        assert edge.source_from_target == pytest.approx(expected, abs=1e-12)
    assert np.array_equal(links[1].information, guess_information())
    assert links[0].information[0, 0] > 100 * links[1].information[0, 0]
    assert motion_links(store, nodes[:1], {}) == ()
