"""Branch and bound against a search that tries every cell and angle."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given

from specmap_cli.core.geometry import FloatArray, Pose2, wrap_angle
from specmap_cli.grids.score_field import ScoreField
from specmap_cli.layout.place_search import Pyramid, Wanted, best_places
from tests.strategies import few, seeds

ANGLES = np.arange(0.0, 2 * np.pi, 0.4)
CELL_M = 0.25
ALL = Wanted(least=0.0, lead=0.0, most=10**6)


def scatter(seed: int, count: int = 40, side_m: float = 9.0) -> FloatArray:
    """Random walls of a small map."""
    return np.random.default_rng(seed).uniform(0.0, side_m, (count, 2))


def field_of(points: FloatArray) -> ScoreField:
    """Their field in coarse cells."""
    return ScoreField.from_points(points, CELL_M, 0.3)


def tried_everywhere(field: ScoreField, points: FloatArray) -> float:
    """The best score of centred points on all cells of the field at all angles, one by one."""
    bytes_ = np.pad(np.round(field.values * 255).astype(int), 200)
    local, best = points - points.mean(axis=0), 0.0
    height, width = field.values.shape
    for angle in ANGLES:
        c, s = np.cos(angle), np.sin(angle)
        x = np.round((c * local[:, 0] - s * local[:, 1]) / CELL_M).astype(int)
        y = np.round((s * local[:, 0] + c * local[:, 1]) / CELL_M).astype(int)
        for row in range(height):
            for column in range(width):
                best = max(best, bytes_[y + row + 200, x + column + 200].mean() / 255)
    return float(best)


@few(2)
@given(seeds)
def test_the_best_score_is_that_of_trying_everything(seed: int) -> None:
    field, source = field_of(scatter(seed)), scatter(seed + 1, 12, 4.0)
    pyramid = Pyramid.of(field, 8.0)
    found, cut_short = best_places(pyramid, source, pyramid.blocks(), ANGLES, ALL, 1)
    assert not cut_short
    assert found[0].score >= tried_everywhere(field, source) - 1e-12


@few(10)
@given(seeds)
def test_levels_are_maxima_of_the_cells_they_stand_for(seed: int) -> None:
    pyramid = Pyramid.of(field_of(scatter(seed)), 2.0)
    cells, rng = pyramid.levels[0], np.random.default_rng(seed)
    for level, values in enumerate(pyramid.levels):
        for row, column in rng.integers(0, np.array(cells.shape), (20, 2)):
            block = cells[row : row + 2**level, column : column + 2**level]
            assert values[row, column] == block.max()


@pytest.mark.parametrize("angle", [0.0, 0.8, 2.4])
def test_points_are_found_where_they_are_from(angle: float) -> None:
    walls, pose = scatter(3, 120, 15.0), Pose2(4.0, -2.0, angle)
    source = walls[np.hypot(*(walls - (7.0, 7.0)).T) < 4.0]
    pyramid = Pyramid.of(field_of(pose.apply(walls)), 8.0)
    wanted = Wanted(least=0.5, lead=0.02, most=10**6)
    found, _ = best_places(pyramid, source, pyramid.blocks(), ANGLES, wanted, 3)
    gap = pose.inverse() @ found[0].pose
    middle = gap.apply(source.mean(axis=0)[None]) - source.mean(axis=0)
    assert np.hypot(*middle[0]) < 2 * CELL_M
    assert abs(wrap_angle(gap.theta)) < 0.01
    scores = [match.score for match in found]
    assert scores == sorted(scores, reverse=True)
    assert min(scores) >= scores[0] - 0.02


def test_a_search_that_follows_too_few_blocks_says_so() -> None:
    field, source = field_of(scatter(5)), scatter(6, 12, 4.0)
    pyramid = Pyramid.of(field, 8.0)
    wanted = Wanted(least=0.0, lead=1.0, most=5)
    found, cut_short = best_places(pyramid, source, pyramid.blocks(), ANGLES, wanted, 2)
    assert cut_short
    assert len(found) == 2


@few(4)
@given(seeds)
def test_the_robot_stands_in_free_cells_alone(seed: int) -> None:
    """The best score is that of trying every cell from which the robot stands in a free one."""
    field, source = field_of(scatter(seed)), scatter(seed + 1, 12, 4.0)
    height, width = field.values.shape
    free = np.random.default_rng(seed).random((height, width)) < 0.05
    pyramid = Pyramid.of(field, 8.0, free)
    found, _ = best_places(pyramid, source, pyramid.blocks(), np.zeros(1), ALL, 1)
    bytes_, middle = np.pad(np.round(field.values * 255).astype(int), 200), source.mean(axis=0)
    x, y = np.round((source - middle) / CELL_M).astype(int).T
    across, down = np.round(-middle / CELL_M).astype(int)
    best = 0.0
    for row, column in np.argwhere(np.pad(free, 60)) - 60 - (down, across):
        if 0 <= row < height and 0 <= column < width:
            best = max(best, bytes_[y + row + 200, x + column + 200].mean() / 255)
    assert found[0].score >= best - 1e-12
    at = np.round((np.array(found[0].pose[:2]) - pyramid.corner) / CELL_M).astype(int)
    near = np.pad(free, pyramid.border)[at[1] - 1 : at[1] + 2, at[0] - 1 : at[0] + 2]
    assert near.any(), "to a cell: the robot's place is rounded, as points are"


def test_of_two_rooms_alike_that_one_is_taken_where_the_robot_can_be() -> None:
    room = scatter(4, 60, 5.0)
    field = field_of(np.vstack([room, room + (8.0, 0.0)]))
    free = np.zeros(field.values.shape, dtype=bool)
    free[:, round((7.5 - field.origin[0]) / CELL_M) :] = True
    wanted = Wanted(least=0.5, lead=0.1, most=10**6)
    for allowed, places in ((free, {8}), (None, {0, 8}), (np.zeros_like(free), set())):
        pyramid = Pyramid.of(field, 8.0, allowed)
        found, _ = best_places(pyramid, room, pyramid.blocks(), np.zeros(1), wanted, 5)
        assert {round(match.pose.x) for match in found} == places


def test_a_robot_beyond_the_border_may_stand_anywhere() -> None:
    """Its walls are all on one side, farther off than the pyramid reaches."""
    room = scatter(4, 60, 5.0)
    field = field_of(room)
    pyramid = Pyramid.of(field, 4.0, np.zeros(field.values.shape, dtype=bool))
    far = room + (60.0, 0.0)
    wanted = Wanted(least=0.5, lead=0.1, most=10**6)
    found, _ = best_places(pyramid, far, pyramid.blocks(), np.zeros(1), wanted, 1)
    assert found[0].pose.x == pytest.approx(-60.0, abs=CELL_M)


def test_nothing_is_found_of_nothing() -> None:
    pyramid = Pyramid.of(field_of(scatter(5)), 8.0)
    blocks, none = pyramid.blocks(), np.zeros((0, 2))
    assert best_places(pyramid, none, blocks, ANGLES, ALL, 1) == ([], False)
    assert best_places(pyramid, scatter(1), blocks[:0], ANGLES, ALL, 1) == ([], False)
    strict = Wanted(least=1.0, lead=0.0, most=10**6)
    assert best_places(pyramid, scatter(1), blocks, ANGLES, strict, 1) == ([], False)
