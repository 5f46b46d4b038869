"""A room of points, shared by the tests of fields and of the matcher."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from specmap_cli.core.geometry import FloatArray
from specmap_cli.grids.score_field import ScoreField


def wall(x0: float, y0: float, x1: float, y1: float) -> FloatArray:
    """Points every 4 cm along a wall."""
    n = int(np.hypot(x1 - x0, y1 - y0) / 0.04) + 1
    return np.column_stack([np.linspace(x0, x1, n), np.linspace(y0, y1, n)])


@pytest.fixture(scope="session")
def room() -> FloatArray:
    """An L-shaped room with a pillar: no symmetry."""
    corners = [(-3, -2), (4, -2), (4, 1), (1, 1), (1, 3), (-3, 3), (-3, -2)]
    sides = [wall(*a, *b) for a, b in itertools.pairwise(corners)]
    return np.concatenate([*sides, wall(2, -1, 2.4, -1), wall(2.4, -1, 2.4, -0.6)])


@pytest.fixture(scope="session")
def field(room: FloatArray) -> ScoreField:
    return ScoreField.from_points(room)


@pytest.fixture(scope="session")
def corridor() -> FloatArray:
    """Two walls of 18 m, 2 m apart."""
    return np.vstack([wall(-9, 0, 9, 0), wall(-9, 2, 9, 2)])
