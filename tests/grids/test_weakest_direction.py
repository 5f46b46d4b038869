from __future__ import annotations

import math

import numpy as np
import pytest

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.grids.matching import weakest_direction

BEARINGS = np.linspace(-math.pi, math.pi, 720, endpoint=False)


def box(
    length_m: float, width_m: float, range_m: float, noise_m: float, seed: int = 0
) -> FloatArray:
    """What a laser in the middle of a box sees, its long side along x."""
    rng = np.random.default_rng(seed)
    to_end = 0.5 * length_m / np.maximum(np.abs(np.cos(BEARINGS)), 1e-9)
    to_side = 0.5 * width_m / np.maximum(np.abs(np.sin(BEARINGS)), 1e-9)
    ranges = np.minimum(to_end, to_side)
    seen = ranges < range_m
    ranges = ranges + rng.normal(0.0, noise_m, len(ranges))
    return np.column_stack([ranges * np.cos(BEARINGS), ranges * np.sin(BEARINGS)])[seen]


@pytest.mark.parametrize("noise_m", [0.0, 0.01, 0.03])
@pytest.mark.parametrize("width_m", [1.5, 2.5])
@pytest.mark.parametrize("turn", [0.0, 0.7, -2.0])
def test_a_bare_corridor_is_open_along_itself(noise_m: float, width_m: float, turn: float) -> None:
    points = Pose2(0.0, 0.0, turn).apply(box(60.0, width_m, 8.0, noise_m))
    weakest = weakest_direction(points)
    assert weakest.open
    assert abs(math.sin(weakest.heading - turn)) < 0.05


@pytest.mark.parametrize("noise_m", [0.0, 0.01, 0.03])
def test_one_end_in_sight_closes_it(noise_m: float) -> None:
    assert not weakest_direction(box(12.0, 2.5, 8.0, noise_m)).open


@pytest.mark.parametrize("noise_m", [0.0, 0.03])
def test_a_square_room_fixes_all_directions_alike(noise_m: float) -> None:
    assert weakest_direction(box(5.0, 5.0, 10.0, noise_m)).share == pytest.approx(0.5, abs=0.06)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_too_few_points_fix_nothing(count: int) -> None:
    assert weakest_direction(np.ones((count, 2))).open
