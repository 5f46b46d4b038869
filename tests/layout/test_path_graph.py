"""The graph of the path: its nodes, its parts, the way between them, and how far to trust it."""

import dataclasses
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2
from specmap_cli.core.odometry import SIGMAS, UNMEASURED, Slack
from specmap_cli.core.records import PlanarScan
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.grids.matching import observability
from specmap_cli.layout.path_graph import (
    _NODE_RAD,
    _RANGE_NOISE_M,
    GUESS_INFORMATION,
    GUESS_M,
    LOOP_PATH_M,
    NODE_M,
    chosen_nodes,
    graph_of,
    rows_every,
    step_information,
)
from tests.casting import store_of
from tests.layout.driving import between, chained
from tests.maps.test_keyframe_log import posed
from tests.strategies import angles, seeds

NOTHING = np.zeros((0, 2))
BLIND = PlanarScan(0, np.array([0.0, 0.1]), np.full(2, np.inf), 10.0, False)


@given(st.integers(0, 1000), st.integers(1, 60), st.sets(st.integers(0, 59), max_size=4))
def test_nodes_are_a_step_or_turn_apart_or_must_be(seed: int, count: int, always: set[int]) -> None:
    steps = np.random.default_rng(seed).uniform((0.0, 0.0, -0.3), (0.2, 0.0, 0.3), (count - 1, 3))
    poses = chained(np.zeros(3), steps)
    nodes = chosen_nodes(poses, always).tolist()
    due = {0, count - 1} | {k for k in always if k < count}
    assert nodes == sorted(set(nodes))
    assert due <= set(nodes)
    for k in range(1, count):
        motion = between(poses, max(node for node in nodes if node < k), k)
        far = motion.distance >= NODE_M or abs(motion.theta) >= _NODE_RAD
        assert (k in nodes) == (far or k in due)


def test_parts_begin_at_breaks_and_the_path_jumps_there(store: KeyframeStore) -> None:
    graph = graph_of(store, [33], {0: None, 200: None, 450: None})
    assert {33, 200, 450} <= set(graph.nodes.tolist())
    assert graph.part_numbers == range(3)
    starts = [graph.nodes[graph.parts == part][0] for part in graph.part_numbers]
    assert starts == [0, 200, 450], "keyframe 0 is no break: there is nothing before it"
    steps = np.diff(graph.path)
    over = np.flatnonzero(np.diff(graph.parts))
    assert np.allclose(steps[over], 2 * LOOP_PATH_M)
    driven = np.hypot(*np.diff(store.poses[graph.nodes, :2], axis=0).T)
    assert np.allclose(np.delete(steps, over), np.delete(driven, over))
    assert graph.path[0] == 0.0
    loose = [edge.kind == "loose" for edge in graph.odometry]
    assert loose == [bool(k in over) for k in range(len(graph.nodes) - 1)]
    for edge, ends in zip(graph.odometry, pairwise(graph.nodes.tolist()), strict=True):
        assert (edge.source, edge.target) == ends
        assert edge.source_from_target == pytest.approx(between(store.poses, *ends), abs=1e-12)
        assert np.array_equal(edge.information, GUESS_INFORMATION) == (edge.kind == "loose")
    assert graph.odometry[0].information[0, 0] > 100 * GUESS_INFORMATION[0, 0]
    assert [graph.row[number] for number in graph.nodes.tolist()] == list(range(len(graph.nodes)))
    assert np.array_equal(graph.poses, store.poses[graph.nodes])
    with pytest.raises(dataclasses.FrozenInstanceError):
        graph.nodes = np.zeros(1, dtype=np.int64)  # type: ignore[misc]


@given(st.lists(st.floats(0.0, 3.0), min_size=1, max_size=30), st.floats(0.1, 5.0))
def test_rows_to_look_from_are_first_past_a_stretch(steps: list[float], every_m: float) -> None:
    path = np.cumsum(steps)
    chosen = rows_every(path, every_m)
    ways = [0.0, *path[chosen].tolist()]
    assert (np.diff(ways) >= every_m).all()
    for k in set(range(len(path))) - set(chosen):
        assert path[k] - max(way for way in ways if way <= path[k]) < every_m


def spread_of(
    step: Pose2,
    points: FloatArray,
    guessed_m: tuple[float, float] = (0.0, 0.0),
    slacks: Slack = UNMEASURED,
) -> FloatArray:
    """Covariance of one motion that ends where these points are seen, some of it guessed."""
    fisher = observability(points, _RANGE_NOISE_M)[None]
    known = step_information([step], fisher, np.array([slacks]), np.array([guessed_m]))
    return np.asarray(np.linalg.inv(known[0]))


def test_a_guess_is_told_along_its_own_direction() -> None:
    step = Pose2(0.3, 0, 0)
    guessed, measured = spread_of(step, outline(1), (0.3, 0.4)), spread_of(step, outline(1))
    assert np.allclose((guessed - measured)[:2, :2], np.outer((0.3, 0.4), (0.3, 0.4)))


def test_without_walls_a_motion_errs_as_the_odometry_that_measured_it() -> None:
    """No more than a guess at the worst; and each step of a store by what it was worth there."""
    step = Pose2(0.3, 0.0, 0.0)
    wheels, bad = Slack(0.5, 0.4, 2.0), Slack(30.0, 30.0, 30.0)
    for slacks, sigmas in ((wheels, (0.055, 0.078)), (bad, (0.9, 0.6))):
        place, turn = np.minimum(np.array(sigmas) / SIGMAS, (GUESS_M, 0.2))
        spread = np.diag(spread_of(step, NOTHING, slacks=slacks))
        assert spread[:2] == pytest.approx(place**2 + 0.019**2)
        assert spread[2] == pytest.approx(turn**2 + 0.003**2)
    blind = replace(posed(0), planar=BLIND, map_from_base=IDENTITY)
    on = replace(blind, map_from_base=step, odometry_slacks=wheels)
    with store_of([blind, on, replace(blind, map_from_base=step @ step)]) as some:
        motions = graph_of(some, [], {}).odometry
    told, guessed = (np.linalg.inv(motion.information) for motion in motions)
    assert np.allclose(told, spread_of(step, NOTHING, slacks=wheels))
    assert np.allclose(guessed, spread_of(step, NOTHING))


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
    sides = np.vstack([np.column_stack([x, x * 0 - 1]), np.column_stack([-x, x * 0 + 1])])
    fisher = observability(sides, 0.1)
    assert fisher[0, 0] < 1e-6 * fisher[1, 1]
    sigma = np.sqrt(np.diag(spread_of(Pose2(0.3, 0, 0), sides)))
    assert sigma[0] > 0.25
    assert sigma[1] < 0.05
    end = np.column_stack([x * 0 + 5, np.linspace(-1, 1, 100)])
    assert np.sqrt(spread_of(Pose2(0.3, 0, 0), np.vstack([sides, end]))[0, 0]) < 0.05


@given(seeds, st.floats(0.01, 0.5), angles)
def test_what_walls_tell_is_the_sum_over_points(seed: int, noise_m: float, angle: float) -> None:
    points, turned_by = outline(seed), Pose2(0.0, 0.0, angle)
    assert np.allclose(observability(points, noise_m), by_loops(points, noise_m))
    turn = np.eye(3)
    turn[:2, :2] = turned_by.rotation()
    seen = observability(turned_by.apply(points), 0.1)
    assert np.allclose(seen, turn @ observability(points, 0.1) @ turn.T, atol=1e-6)


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
    guess = np.linalg.inv(GUESS_INFORMATION)
    least = np.diag([0.01**2, 0.01**2, 0.003**2])
    assert np.allclose(spread_of(Pose2(0.0, 0.0, 0.0), points), guess + least)


@given(st.lists(st.floats(0.01, 1.0), min_size=1, max_size=8))
def test_guesses_in_a_row_err_in_one_way_and_others_do_not(sizes: list[float]) -> None:
    """The errors of a stretch add up; a motion that walls fixed ends it."""
    row = [(size, 0.0) for size in sizes]
    steps = [Pose2(0.3, 0, 0.5)] * (2 * len(row) + 1)
    fisher = np.repeat(1e15 * np.eye(3)[None], len(steps), axis=0)
    slacks, guessed_m = np.full((len(steps), 3), np.inf), np.array([*row, (0.0, 0.0), *row])
    spread = np.linalg.inv(step_information(steps, fisher, slacks, guessed_m))
    grown = spread[:, 0, 0] - 0.019**2
    for stretch in (grown[: len(row)], grown[-len(row) :]):
        assert stretch.sum() == pytest.approx(sum(sizes) ** 2)
    assert (grown[len(row)], spread[len(row), 2, 2]) == pytest.approx((0.0, 0.013**2), abs=1e-6)


def test_what_was_guessed_counts_in_the_frame_in_which_a_motion_ends() -> None:
    first = replace(posed(0), map_from_base=IDENTITY, guessed_m=(0.0, 0.0))
    second = replace(posed(1), map_from_base=Pose2(0.0, 1.0, np.pi / 2), guessed_m=(0.0, 0.5))
    with store_of([first, second]) as store:
        spread = np.linalg.inv(graph_of(store, [], {}).odometry[0].information)
    assert spread[0, 0] > 0.2 > 0.1 > spread[1, 1]


@given(st.floats(0, 5), st.floats(0, 5), st.floats(0, 3), st.floats(0, 3))
def test_longer_motions_err_more(short: float, more: float, turn: float, further: float) -> None:
    near = spread_of(Pose2(short, 0.0, turn), outline(1))
    far = spread_of(Pose2(short + more, 0.0, turn + further), outline(1))
    assert (np.diag(far) >= np.diag(near) - 1e-12).all()
    assert np.allclose(near, near.T)
    assert (np.linalg.eigvalsh(near) > 0).all()
