"""Closures told more precisely by the walls around their keyframes; scans laid on lines."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2, compose, invert
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.closure_matching import Place, on_lines, onto_lines, place_around, sharpened
from specmap_cli.layout.path_graph import MATCH_RANGE_M
from tests.layout.driving import SECOND_LAP, Laps, between, corridor, missed

SPREAD = (0.15, 0.03)
NOISE_M = 0.01


def place(store: KeyframeStore, keyframe: int) -> Place:
    """What was seen around a keyframe of its lap."""
    first = 0 if keyframe < SECOND_LAP else SECOND_LAP
    lap = range(first, SECOND_LAP if first == 0 else len(store))
    return place_around(store, lap, keyframe - first)


def of_scan(points: FloatArray) -> Place:
    """A place that one scan shows."""
    return Place((points,), np.zeros((1, 3)), 0)


@pytest.mark.parametrize("seed", range(8))
def test_a_rough_closure_is_brought_to_the_truth(perfect: Laps, seed: int) -> None:
    store, _ = perfect
    rng = np.random.default_rng(seed)
    new = SECOND_LAP + int(rng.integers(20, 220))
    old = new - SECOND_LAP + int(rng.integers(-5, 6))
    truth = between(store.poses, old, new)
    guess = truth @ Pose2(*rng.uniform((-0.1, -0.1, -0.03), (0.1, 0.1, 0.03)).tolist())
    assert np.less(
        missed(truth, sharpened(place(store, old), place(store, new), guess)), (0.01, 0.002)
    ).all()


def test_what_was_seen_the_other_way_round_is_tied_by_what_both_showed(perfect: Laps) -> None:
    """Few of the walls that one pass shows are on the other one; those decide."""
    store, _ = perfect
    old, new = place(store, 30), place(store, SECOND_LAP + 48)
    ahead = tuple(scan[scan[:, 0] > 0.3] for scan in old.scans)
    behind = tuple(scan[scan[:, 0] < 0.6] for scan in new.scans)
    truth = between(store.poses, 30, SECOND_LAP + 48)
    guess = truth @ Pose2(0.06, -0.05, 0.015)
    found = sharpened(replace(old, scans=ahead), replace(new, scans=behind), guess)
    assert np.less(missed(truth, found), (0.02, 0.004)).all()


def test_where_the_walls_do_not_fit_the_guess_stays(perfect: Laps) -> None:
    store, _ = perfect
    guess = Pose2(0.3, -0.2, 0.1)
    assert sharpened(place(store, 25), place(store, 120), guess) == guess
    assert sharpened(place(store, 25), of_scan(np.zeros((3, 2))), guess) == guess


def test_a_closure_does_not_leave_what_was_compared(perfect: Laps) -> None:
    """Walls that fit better half a metre away are not those that the grids were matched by."""
    store, _ = perfect
    old, new = 30, SECOND_LAP + 30
    truth = between(store.poses, old, new)
    for off in (Pose2(0.45, 0.0, 0.0), Pose2(0.0, 0.45, 0.0), Pose2(0.0, 0.0, 0.12)):
        guess = truth @ off
        found = sharpened(place(store, old), place(store, new), guess)
        assert np.less_equal(missed(guess, found), (0.3, 0.06)).all()


def test_along_a_bare_corridor_nothing_is_made_up() -> None:
    walls = of_scan(corridor())
    found = sharpened(walls, walls, Pose2(0.2, 0.08, 0.02))
    assert (np.abs(np.subtract(found, (0.2, 0.0, 0.0))) < (0.01, 0.02, 0.006)).all()


def test_a_place_is_what_was_seen_within_a_few_metres_of_path(perfect: Laps) -> None:
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
def test_of_a_place_a_few_scans_stand_for_all(perfect: Laps, own: int) -> None:
    store, _ = perfect
    whole = place_around(store, range(100, 151), own)
    few = whole.of_few(8)
    assert len(few.scans) == 9
    np.testing.assert_allclose(few.poses[few.own], np.zeros(3), atol=1e-12)
    assert set(map(tuple, few.poses.tolist())) <= set(map(tuple, whole.poses.tolist()))
    assert len(few.scans[few.own]) <= len(whole.scans[whole.own])


def outline(corners: FloatArray, every_m: float = 0.04) -> FloatArray:
    """Points (N, 2) along the walls between corners, all round."""
    walls = []
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        share = np.arange(0.0, 1.0, every_m / np.hypot(*(b - a)))[:, None]
        walls.append(a + share * (b - a))
    return np.concatenate(walls)


ROOM = outline(np.array([[-3.0, -2.0], [3.0, -2.0], [3.0, 2.5], [0.5, 2.5], [0.5, 1.5], [-3, 1.5]]))


def seen(rng: np.random.Generator, pose: FloatArray, half: bool = True) -> FloatArray:
    """What a laser shows from a pose, in its frame: with noise, of the half before it."""
    points = Pose2(*pose.tolist()).inverse().apply(ROOM)
    points = points[points[:, 0] > 0.0] if half else points
    points = points[rng.random(len(points)) < 0.5]
    return points + rng.normal(0.0, NOISE_M, points.shape)


@pytest.mark.parametrize("seed", range(6))
def test_scans_that_were_registered_roughly_are_laid_on_each_other(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = rng.uniform((-1.0, -0.7, -3.0), (1.0, 0.7, 3.0), (12, 3))
    truth[1:6, 2] = truth[0, 2] + rng.uniform(-0.5, 0.5, 5)
    rough = compose(truth, rng.normal(0.0, (0.015, 0.015, 0.006), truth.shape))
    found = on_lines([seen(rng, pose) for pose in truth], rough)
    off = [
        compose(invert(compose(invert(truth[0]), truth[1:])), compose(invert(p[0]), p[1:]))
        for p in (rough, found)
    ]
    before, after = (np.median(np.abs(each), axis=0) for each in off)
    assert (after < (0.004, 0.004, 0.002)).all()
    assert (after < 0.5 * before).all()


@pytest.mark.parametrize("seed", range(8))
def test_a_place_is_found_among_the_lines_of_another(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = Pose2(*rng.uniform((-1.0, -1.0, -3.0), (1.0, 1.0, 3.0)).tolist())
    source = seen(rng, np.array(truth), half=False)
    guess = truth @ Pose2(*rng.uniform((-0.2, -0.2, -0.05), (0.2, 0.2, 0.05)).tolist())
    fit = onto_lines(source, seen(rng, np.zeros(3), half=False), guess, SPREAD)
    assert np.less(missed(truth, fit.target_from_source), (0.01, 0.003)).all()
    assert fit.share > 0.9
    assert fit.points > 100


def test_what_only_one_of_two_places_shows_does_not_count() -> None:
    """Looks into one corner from two sides, and each shows a room that the other does not."""
    rng = np.random.default_rng(3)
    truth = Pose2(0.4, -0.3, 1.2)
    source, target = seen(rng, np.array(truth)), seen(rng, np.zeros(3))
    elsewhere = outline(np.array([[4.0, 0.0], [7.0, 0.0], [7.0, 3.0], [4.0, 3.0]]))
    aside = truth.inverse().apply(elsewhere + (0.0, 40.0))
    guess = truth @ Pose2(0.12, -0.1, 0.02)
    alone = onto_lines(source, target, guess, SPREAD)
    more = np.concatenate([source, aside]), np.concatenate([target, elsewhere])
    assert onto_lines(*more, guess, SPREAD) == alone
    assert (truth.inverse() @ alone.target_from_source).distance < 0.01


def test_what_was_moved_hardly_draws() -> None:
    rng = np.random.default_rng(4)
    source, target = (seen(rng, np.zeros(3), half=False) for _ in range(2))
    table = outline(np.array([[-1.0, -1.0], [0.0, -1.0], [0.0, 0.0], [-1.0, 0.0]]))
    moved = np.concatenate([source, table + (0.1, 0.0)])
    fit = onto_lines(moved, np.concatenate([target, table]), IDENTITY, SPREAD)
    assert fit.target_from_source.distance < 0.02
    assert 0.6 < fit.share < 0.9


def test_along_a_bare_wall_nothing_moves() -> None:
    wall = outline(np.array([[-5.0, 1.0], [5.0, 1.0]]))
    rng = np.random.default_rng(5)
    scans = [wall + rng.normal(0.0, NOISE_M, wall.shape) for _ in range(3)]
    rough = np.array([[0.0, 0.0, 0.0], [0.3, 0.04, 0.01], [0.6, -0.03, 0.0]])
    placed = on_lines(scans, rough)
    np.testing.assert_allclose(placed[:, 0], rough[:, 0], atol=0.01)
    assert np.ptp(placed[:, 1]) < 0.01


def test_without_lines_everything_stays() -> None:
    nothing, few = np.zeros((0, 2)), np.array([[1.0, 0.0], [3.0, 2.0]])
    poses = np.array([[0.0, 0.0, 0.0], [0.1, 0.2, 0.3]])
    guess = Pose2(0.1, 0.2, 0.3)
    for scan in (nothing, few):
        np.testing.assert_array_equal(on_lines([scan, scan], poses), poses)
        fit = onto_lines(scan, scan + (0.5, 5.0), guess, SPREAD)
        assert (fit.target_from_source, fit.points, fit.share) == (guess, 0, 0.0)
