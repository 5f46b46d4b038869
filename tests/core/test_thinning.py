"""One point a cell, the first, in order."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given

from specmap_cli.core.arrays import first_in_cells
from tests.strategies import seeds


@given(seeds)
def test_the_first_point_of_each_cell_is_kept(seed: int) -> None:
    points = np.random.default_rng(seed).uniform(-3.0, 3.0, (200, 3))
    first: dict[tuple[float, ...], int] = {}
    for number, point in enumerate(points):
        first.setdefault(tuple(np.floor(point / 0.7).tolist()), number)
    assert first_in_cells(points, 0.7).tolist() == sorted(first.values())


@pytest.mark.parametrize("count", [0, 1])
def test_nothing_is_left_of_nothing_and_one_of_one(count: int) -> None:
    assert first_in_cells(np.zeros((count, 2)), 1.0).tolist() == list(range(count))


@pytest.mark.parametrize("away", [1e3, 1e6, 1e12])
def test_cells_too_many_to_number_are_told_apart(away: float) -> None:
    points = np.array([[0, 0, 0], [away, -away, away], [0.05, 0, 0], [away, -away, away]])
    assert first_in_cells(points, 0.1).tolist() == [0, 1]
    assert first_in_cells(points[:, :2], 0.1).tolist() == [0, 1]
