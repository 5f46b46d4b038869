"""Grids prepared for matching: walls, known area, coarse cells, and which are kept."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import distance_transform_edt

from specmap_cli.core.geometry import wrap_angle
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from specmap_cli.grids.score_field import ScoreField
from specmap_cli.recognition.closure.prepared import (
    PreparedGrid,
    PreparedGrids,
    prepared,
    wall_direction,
)
from specmap_cli.recognition.closure.verification import verify
from tests.recognition.watching import watched
from tests.turning import turn


def box(degrees: float = 0.0) -> GridMap:
    """A rectangular room of 6 m by 4 m with thick walls, turned."""
    cells = np.full((200, 200), FREE, dtype=np.uint8)
    rows, columns = np.mgrid[:200, :200] - 100
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    along, across = c * columns + s * rows, -s * columns + c * rows
    outside = np.maximum(np.abs(along) - 60, np.abs(across) - 40)
    cells[(outside > 0) & (outside < 4)] = OCCUPIED
    cells[outside >= 4] = UNKNOWN
    return GridMap(cells, 0.05, (-5.0, -5.0))


def prepared_box(resolution: float = 0.05) -> PreparedGrid:
    grid = box()
    made = prepared(GridMap(grid.cells, resolution, grid.origin))
    assert made is not None
    return made


@pytest.mark.parametrize("degrees", [0, 10, 37, 80])
def test_the_direction_of_walls_turns_with_them(degrees: float) -> None:
    off = wrap_angle(4.0 * (wall_direction(box(degrees)) - np.radians(degrees))) / 4.0
    assert abs(np.degrees(off)) < 1.0


@pytest.mark.parametrize(("cells", "enough"), [(0, False), (9, False), (10, True)])
def test_a_grid_with_hardly_a_wall_cannot_be_prepared(cells: int, enough: bool) -> None:
    picture = np.full((30, 30), FREE, dtype=np.uint8)
    picture[4, :cells] = OCCUPIED
    assert (prepared(GridMap(picture, 0.05)) is not None) is enough


def test_walls_are_thinned_evenly() -> None:
    grid = box()
    walls = prepared_box().walls
    assert len(walls) == 1200 < np.count_nonzero(grid.occupied)
    assert (grid.values_at(walls) == OCCUPIED).all()
    everyone = grid.centres_of(np.argwhere(grid.occupied))
    assert walls.mean(axis=0) == pytest.approx(everyone.mean(axis=0), abs=0.05)


def test_distances_and_depth_are_those_of_scipy() -> None:
    area = prepared_box().area
    grid = box().cropped()
    assert area.origin == grid.origin
    for ours, inside in ((area.wall_distance, ~grid.occupied), (area.depth, grid.free)):
        expected = distance_transform_edt(inside) * 0.05
        assert np.abs(ours - expected).max() < 0.03 * expected.max() + 0.005  # OpenCV's mask of 5
    cells = np.full((40, 40), FREE, dtype=np.uint8)
    cells[20, 5:35] = OCCUPIED
    whole = prepared(GridMap(cells, 0.05))
    assert whole is not None
    assert whole.area.known.all()
    assert whole.area.depth.max() < 2.0


@pytest.mark.parametrize(("inlier_m", "margin"), [(0.15, 3), (0.25, 5), (0.01, 1)])
def test_the_known_area_grows_by_what_an_inlier_may_be_off(inlier_m: float, margin: int) -> None:
    cells = np.full((40, 40), UNKNOWN, dtype=np.uint8)
    cells[19, 2:38] = OCCUPIED
    cells[2, 2] = cells[37, 37] = FREE  # the crop keeps the rows between
    turn("recognition", inlier_m=inlier_m)
    made = prepared(GridMap(cells, 0.05))
    assert made is not None
    middle = made.area.known[:, 15]
    assert np.flatnonzero(middle).tolist() == list(range(17 - margin, 17 + margin + 1))


@pytest.mark.parametrize(
    ("resolution", "cell_m"),
    [(0.05, 0.3), (0.1, 0.3), (0.03, 0.3), (0.07, 0.28), (0.2, 0.2), (0.4, 0.4)],
)
def test_coarse_cells_are_whole_multiples_of_the_grid_s(resolution: float, cell_m: float) -> None:
    """And lie where the fine cells lie, so that transforms found on them are true."""
    made = prepared_box(resolution=resolution)
    coarse = made.coarse
    assert coarse.cell_m == pytest.approx(cell_m)
    scaled = GridMap(box().cells, resolution, box().origin)
    walls = scaled.centres_of(np.argwhere(scaled.occupied))
    corner = np.floor((walls - coarse.origin) / coarse.cell_m + 1e-9).astype(int)
    expected = {tuple(cell) for cell in corner.tolist()}
    found = np.floor((coarse.walls - coarse.origin) / coarse.cell_m).astype(int)
    assert {tuple(cell) for cell in found.tolist()} == expected


def test_coarse_layers_reward_walls_on_walls_and_punish_them_in_free_space() -> None:
    coarse = prepared_box().coarse
    of_walls, of_free = coarse.layers

    def values(layer: Any, points: Any) -> Any:
        columns, rows = np.floor((points - coarse.origin) / coarse.cell_m).astype(int).T
        return layer[rows, columns]

    assert values(of_walls, coarse.walls).min() >= 0.6
    assert values(of_walls, coarse.walls).max() <= 1.0
    assert values(of_walls, np.zeros((1, 2))) == pytest.approx(-0.5)  # the middle of the room
    assert values(of_free, coarse.walls).tolist() == [-0.5] * len(coarse.walls)
    assert not values(of_free, coarse.free).any()
    assert not {*map(tuple, coarse.walls)} & {*map(tuple, coarse.free)}


@given(st.lists(st.integers(0, 5), min_size=1, max_size=30))
def test_the_last_used_grids_are_kept_and_others_prepared_again(numbers: list[int]) -> None:
    """Those, too, that cannot be prepared: those of even numbers."""
    grids, asked = PreparedGrids(most=3), list[int]()
    held: list[int] = []  # the last used one last

    def answer(number: Any) -> Any:
        asked.append(number)
        return number if number % 2 else None

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("specmap_cli.recognition.closure.prepared.prepared", answer)
        for number in numbers:
            asked.clear()
            grid: Any = number
            found: Any = grids.of(number, grid)
            assert found == (number if number % 2 else None)
            assert asked == ([] if number in held else [number])
            held = [*(kept for kept in held if kept != number), number][-3:]


def test_fields_are_made_of_the_older_grid_alone_and_once(monkeypatch: pytest.MonkeyPatch) -> None:
    old, new = prepared_box(), prepared_box()
    asked = watched(monkeypatch, ScoreField, "from_grid")
    assert verify(old, new) == verify(old, new)
    assert [grid is old.grid for grid, *_ in asked] == [True]
