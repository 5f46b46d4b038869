"""Ways driven, against plain loops."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.geometry import Pose2, moved, path_length, step_lengths, travelled
from tests.strategies import poses


@given(st.lists(poses, max_size=8))
def test_a_path_is_as_long_as_its_steps(track: list[Pose2]) -> None:
    array = np.array(track, dtype=np.float64).reshape(-1, 3)
    steps = [math.dist(a[:2], b[:2]) for a, b in itertools.pairwise(track)]
    assert step_lengths(array) == pytest.approx(steps)
    assert path_length(array) == pytest.approx(sum(steps))
    way = travelled(array)
    assert len(way) == len(track)
    assert way == pytest.approx([sum(steps[:k]) for k in range(len(track))])


def test_an_unknown_place_makes_its_steps_unknown() -> None:
    track = np.array([[0.0, 0.0], [math.nan, math.nan], [3.0, 4.0]])
    assert np.isnan(step_lengths(track)).all()


def test_a_robot_has_moved_by_distance_or_by_angle() -> None:
    here = Pose2(1.0, 2.0, 3.1)
    assert moved(None, here, 1.0, 1.0)
    assert not moved(here, here, 0.05, 0.05)
    assert moved(here, here @ Pose2(0.06, 0.0, 0.0), 0.05, 9.0)
    assert moved(here, here @ Pose2(0.0, 0.0, -0.06), 9.0, 0.05)  # over the border of the circle
    assert not moved(here, here @ Pose2(0.04, 0.0, 0.04), 0.05, 0.05)
