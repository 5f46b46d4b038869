"""Which directions walls fix: all in a room, one in a corridor."""

from __future__ import annotations

import math

import numpy as np
import pytest

from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2
from specmap_cli.core.records import PlanarScan
from specmap_cli.registration.motion import fixed_directions

AHEAD, ASIDE = Pose2(0.5, 0.0, 0.0), Pose2(0.0, 0.5, 0.0)


def scan_of(half_x: float, half_y: float, noise_m: float = 0.0) -> PlanarScan:
    """A laser amid a box; what lies beyond 8 m returns nothing."""
    bearings = np.linspace(-math.pi, math.pi, 360, endpoint=False)
    ranges = np.minimum(
        half_x / np.maximum(np.abs(np.cos(bearings)), 1e-9),
        half_y / np.maximum(np.abs(np.sin(bearings)), 1e-9),
    )
    ranges += np.random.default_rng(0).normal(0.0, noise_m, 360) if noise_m else 0.0
    return PlanarScan(0, bearings, np.where(ranges < 8.0, ranges, np.inf), 8.0, full_circle=True)


@pytest.mark.parametrize("noise_m", [0.0, 0.003])
@pytest.mark.parametrize(
    ("half_x", "half_y", "motion", "fixed"),
    [
        (3.0, 2.0, AHEAD, (True, True)),
        (50.0, 1.0, AHEAD, (False, True)),
        (50.0, 1.0, ASIDE, (True, False)),
        (1.0, 50.0, AHEAD, (True, False)),
        (50.0, 1.0, IDENTITY, (False, True)),
    ],
)
def test_a_corridor_fixes_the_place_across_it_only(
    half_x: float, half_y: float, motion: Pose2, fixed: tuple[bool, bool], noise_m: float
) -> None:
    scan = scan_of(half_x, half_y, noise_m)
    assert fixed_directions(scan, IDENTITY, motion) == fixed


def test_the_mounting_of_the_laser_turns_the_directions() -> None:
    scan = scan_of(50.0, 1.0)
    assert fixed_directions(scan, Pose2(0.2, 0.1, math.pi / 2), AHEAD) == (True, False)


@pytest.mark.parametrize("ranges", [np.full(9, np.inf), np.full(9, np.nan)])
def test_without_walls_nothing_is_fixed(ranges: FloatArray) -> None:
    scan = PlanarScan(0, np.linspace(-1.0, 1.0, 9), ranges, 8.0, full_circle=False)
    assert fixed_directions(scan, IDENTITY, AHEAD) == (False, False)
