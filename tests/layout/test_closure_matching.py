"""Closures told more precisely by the walls around the keyframes that they tie."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from specmap_cli.core.geometry import FloatArray, Pose2, compose, invert
from specmap_cli.core.settings import RelaxationConfig
from specmap_cli.grids.gridmap import FREE, OCCUPIED, GridMap
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.closure_matching import Place, place_around, sharpened
from specmap_cli.layout.motion_edges import MATCH_RANGE_M
from specmap_cli.layout.path_graph import Graph
from tests.layout.driving import between, scans_of

CONFIG = RelaxationConfig()
SECOND_LAP = 480
Perfect = tuple[KeyframeStore, Graph]


def place(store: KeyframeStore, keyframe: int) -> Place:
    """What was seen around a keyframe of its lap."""
    first = 0 if keyframe < SECOND_LAP else SECOND_LAP
    lap = range(first, SECOND_LAP if first == 0 else len(store))
    return place_around(store, lap, keyframe - first)


def of_scan(points: FloatArray) -> Place:
    """A place that one scan shows."""
    return Place((points,), np.zeros((1, 3)), 0)


@pytest.mark.parametrize("seed", range(8))
def test_a_rough_closure_is_brought_to_the_truth(perfect: Perfect, seed: int) -> None:
    store, _ = perfect
    rng = np.random.default_rng(seed)
    new = SECOND_LAP + int(rng.integers(20, 220))
    old = new - SECOND_LAP + int(rng.integers(-5, 6))
    truth = between(store.poses, old, new)
    guess = truth @ Pose2(*rng.uniform((-0.1, -0.1, -0.03), (0.1, 0.1, 0.03)).tolist())
    found = sharpened(place(store, old), place(store, new), guess)
    missed = truth.inverse() @ found
    assert missed.distance < 0.01
    assert abs(missed.theta) < 0.002


def test_what_was_seen_the_other_way_round_is_tied_by_what_both_showed(perfect: Perfect) -> None:
    """Few of the walls that one pass shows are on the other one; those decide."""
    store, _ = perfect
    old, new = place(store, 30), place(store, SECOND_LAP + 48)
    ahead = tuple(scan[scan[:, 0] > 0.3] for scan in old.scans)
    behind = tuple(scan[scan[:, 0] < 0.6] for scan in new.scans)
    truth = between(store.poses, 30, SECOND_LAP + 48)
    guess = truth @ Pose2(0.06, -0.05, 0.015)
    off = truth.inverse() @ sharpened(replace(old, scans=ahead), replace(new, scans=behind), guess)
    assert off.distance < 0.02
    assert abs(off.theta) < 0.004


def test_where_the_walls_do_not_fit_the_guess_stays(perfect: Perfect) -> None:
    store, _ = perfect
    guess = Pose2(0.3, -0.2, 0.1)
    assert sharpened(place(store, 25), place(store, 120), guess) == guess
    assert sharpened(place(store, 25), of_scan(np.zeros((3, 2))), guess) == guess


def test_a_closure_does_not_leave_what_was_compared(perfect: Perfect) -> None:
    """Walls that fit better half a metre away are not those that the grids were matched by."""
    store, _ = perfect
    old, new = 30, SECOND_LAP + 30
    truth = between(store.poses, old, new)
    for off in (Pose2(0.45, 0.0, 0.0), Pose2(0.0, 0.45, 0.0), Pose2(0.0, 0.0, 0.12)):
        guess = truth @ off
        found = sharpened(place(store, old), place(store, new), guess)
        moved = guess.inverse() @ found
        assert moved.distance <= 0.3
        assert abs(moved.theta) <= 0.06


def test_along_a_bare_corridor_nothing_is_made_up() -> None:
    cells = np.full((60, 1000), OCCUPIED, dtype=np.uint8)
    cells[10:50] = FREE
    (scan,) = scans_of(GridMap(cells, 0.05), np.array([[25.0, 1.5, 0.0]]), 720)
    walls = of_scan(scan.hits(6.0))
    guess = Pose2(0.2, 0.08, 0.02)
    found = sharpened(walls, walls, guess)
    assert found.x == pytest.approx(0.2, abs=0.01)
    assert abs(found.y) < 0.02
    assert abs(found.theta) < 0.006


def test_a_place_is_what_was_seen_within_a_few_metres_of_path(perfect: Perfect) -> None:
    """Of a path of 60 keyframes, 10 cm apart, those within 2.5 m, in the frame of the middle."""
    store, _ = perfect
    whole = place_around(store, range(60), 30)
    assert len(whole.scans) == 51
    assert whole.own == 25
    np.testing.assert_array_equal(whole.poses, compose(invert(store.poses[30]), store.poses[5:56]))
    np.testing.assert_array_equal(whole.scans[25], store.points(30, MATCH_RANGE_M))
    alone = place_around(store, [30], 0)
    assert len(alone.scans) == 1
    assert 0 < len(alone.walls) < len(whole.walls)


@pytest.mark.parametrize("own", [0, 7, 50])
def test_of_a_place_a_few_scans_stand_for_all(perfect: Perfect, own: int) -> None:
    store, _ = perfect
    whole = place_around(store, range(100, 151), own)
    few = whole.of_few(8)
    assert len(few.scans) == 9
    np.testing.assert_allclose(few.poses[few.own], np.zeros(3), atol=1e-12)
    assert set(map(tuple, few.poses.tolist())) <= set(map(tuple, whole.poses.tolist()))
    assert len(few.scans[few.own]) <= len(whole.scans[whole.own])
