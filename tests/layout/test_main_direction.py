"""The frame of a map follows the walls."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.geometry import FloatArray, Pose2, compose, wrap_angle
from specmap_cli.core.records import Sweep
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.result import Layout, along_walls, wall_direction
from tests.layout.driving import CONFIG, stored


@pytest.fixture(scope="module")
def toured(flat_tour: list[tuple[Sweep, Pose2]]) -> Iterator[tuple[KeyframeStore, FloatArray]]:
    """Some scans of the flat, and the true poses; the walls of the plan lie along its axes."""
    scans, poses = zip(*flat_tour[::40], strict=True)
    with stored(np.array(poses), [sweep.planar for sweep in scans]) as store:
        yield store, store.poses


@given(st.floats(-44.0, 44.0))
def test_walls_of_any_recorded_frame_end_up_along_the_axes(
    toured: tuple[KeyframeStore, FloatArray], degrees: float
) -> None:
    store, truth = toured
    recorded = compose(np.array([3.0, -2.0, math.radians(degrees)]), truth)
    layout = along_walls(Layout(poses=recorded), store, CONFIG)
    turned = wrap_angle(float(layout.poses[0, 2] - recorded[0, 2]))
    assert math.degrees(turned) == pytest.approx(-degrees, abs=0.3)
    turn = np.array([0.0, 0.0, turned])
    np.testing.assert_allclose(layout.poses, compose(turn, recorded), atol=1e-9)
    asked = CONFIG.model_copy(update={"follow_walls": False})
    as_recorded = Layout(poses=recorded)
    assert along_walls(as_recorded, store, asked) is as_recorded


@given(st.integers(0, 10_000), st.floats(-0.7, 0.7))
def test_the_direction_of_most_walls_counts_whatever_quarter_they_are_in(
    seed: int, direction: float
) -> None:
    rng = np.random.default_rng(seed)
    quarters = rng.integers(0, 4, 300) * (math.pi / 2.0)
    walls = direction + quarters + rng.normal(0.0, 0.01, 300)
    others = rng.uniform(-math.pi, math.pi, 60)
    lengths = np.ones(360)
    found = wall_direction(np.concatenate([walls, others]), lengths)
    assert found == pytest.approx(direction, abs=0.01)


@pytest.mark.parametrize("count", [0, 3600])
def test_where_no_direction_stands_out_nothing_is_turned(count: int) -> None:
    directions = np.linspace(-math.pi, math.pi, count, endpoint=False)
    assert wall_direction(directions, np.ones(count)) == 0.0
