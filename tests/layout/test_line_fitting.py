"""Scans laid on each other's lines: to millimetres, whatever only one of them shows."""

from __future__ import annotations

import numpy as np
import pytest

from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2, compose, invert
from specmap_cli.layout.line_fitting import on_lines, onto_lines

SPREAD = (0.15, 0.03)
NOISE_M = 0.01


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
    off = truth.inverse() @ fit.target_from_source
    assert off.distance < 0.01
    assert abs(off.theta) < 0.003
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
    both = onto_lines(
        np.concatenate([source, aside]), np.concatenate([target, elsewhere]), guess, SPREAD
    )
    np.testing.assert_allclose(both.target_from_source, alone.target_from_source, atol=1e-9)
    assert both == alone
    assert (truth.inverse() @ alone.target_from_source).distance < 0.01


def test_what_was_moved_hardly_draws() -> None:
    rng = np.random.default_rng(4)
    source, target = (seen(rng, np.zeros(3), half=False) for _ in range(2))
    table = outline(np.array([[-1.0, -1.0], [0.0, -1.0], [0.0, 0.0], [-1.0, 0.0]]))
    fit = onto_lines(
        np.concatenate([source, table + (0.1, 0.0)]),
        np.concatenate([target, table]),
        IDENTITY,
        SPREAD,
    )
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
        assert fit.target_from_source == guess
        assert fit.points == 0
        assert fit.share == 0.0
