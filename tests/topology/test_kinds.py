"""What a submap is by its shape."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.topology.shapes import kind_of


def rectangle(width: float, height: float) -> FloatArray:
    return np.array([[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]])


@pytest.mark.parametrize(
    ("width", "height", "kind"),
    [
        (5.0, 4.0, "room"),
        (2.0, 2.0, "room"),
        (6.0, 2.5, "room"),
        (7.0, 6.5, "room"),
        (12.0, 4.0, "room"),
        (10.0, 2.0, "corridor"),
        (1.5, 6.2, "corridor"),
        (1.5, 5.8, "room"),
        (40.0, 3.0, "corridor"),
        (8.0, 8.0, "hall"),
        (30.0, 5.0, "hall"),
        (60.0, 40.0, "hall"),
    ],
)
def test_rectangles(width: float, height: float, kind: str) -> None:
    assert kind_of(rectangle(width, height)) == kind


def test_a_corridor_may_bend_and_branch() -> None:
    bent = np.array([[0, 0], [8, 0], [8, 2], [2, 2], [2, 9], [0, 9]], dtype=np.float64)
    tee = np.array([[0, 0], [9, 0], [9, 2], [5.5, 2], [5.5, 7], [3.5, 7], [3.5, 2], [0, 2]])
    assert kind_of(bent) == "corridor"
    assert kind_of(tee) == "corridor"


def test_furniture_along_the_walls_makes_no_corridor_of_a_room() -> None:
    """Shelves 0.5 m apart stand out from both long walls of 6 m x 5 m."""
    lower = [
        (x, y) for k in range(6) for x, y in ((k, 0), (k + 0.5, 0), (k + 0.5, 1.5), (k + 1, 1.5))
    ]
    upper = [(6 - x, 5 - y) for x, y in lower]
    assert kind_of(np.array([*lower, (6, 0), *upper, (0, 5)], dtype=np.float64)) == "room"


@pytest.mark.parametrize("shape", [np.zeros((0, 2)), np.zeros((2, 2)), np.zeros((5, 2))])
def test_what_has_no_area_has_no_kind(shape: FloatArray) -> None:
    assert kind_of(shape) is None
    assert kind_of(rectangle(9.0, 0.05)) is None


def test_the_work_does_not_grow_with_the_size() -> None:
    assert kind_of(rectangle(1e7, 1e7)) == "hall"


@given(
    st.sampled_from([(4.0, 4.0), (12.0, 2.0), (9.0, 9.0)]),
    st.floats(-math.pi, math.pi),
    st.floats(-50.0, 50.0),
)
def test_it_does_not_hang_on_where_the_shape_lies(
    sides: tuple[float, float], turn: float, shift: float
) -> None:
    shape = rectangle(*sides)
    assert kind_of(Pose2(shift, -shift, turn).apply(shape)) == kind_of(shape)
