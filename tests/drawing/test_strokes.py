"""The pieces of a trajectory: runs of a label, broken at jumps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from specmap_cli.core.geometry import FloatArray
from specmap_cli.drawing.sheet import Stroke, strokes
from tests.strategies import seeds


def way(steps_m: list[float]) -> FloatArray:
    """Places (n + 1, 2) along a line, so far from one to the next."""
    return np.column_stack([np.cumsum([0.0, *steps_m]), np.zeros(len(steps_m) + 1)])


@given(seeds, st.integers(1, 60))
def test_strokes_are_the_runs_between_jumps(seed: int, count: int) -> None:
    """Against a walk from scan to scan."""
    rng = np.random.default_rng(seed)
    labels = rng.integers(0, 3, count)
    jumps = rng.random(count - 1) < 0.05
    places = way(np.where(jumps, 40.0, 0.1).tolist())
    assume(jumps.sum() <= 0.08 * count)  # more of them would be usual steps
    expected, first = [], 0
    for k in range(1, count + 1):
        if k == count or jumps[k - 1] or labels[k] != labels[k - 1]:
            goes_on = k < count and not jumps[k - 1]
            expected.append(Stroke(first, k, k + 1 if goes_on else k))
            first = k
    assert strokes(places, labels) == expected


@pytest.mark.parametrize("count", [0, 1])
def test_few_places(count: int) -> None:
    places = np.zeros((count, 2))
    assert strokes(places) == [Stroke(0, 1, 1)] * count
    assert strokes(places, np.zeros(count)) == [Stroke(0, 1, 1)] * count


@pytest.mark.parametrize(("leap_m", "pieces"), [(1.4, 1), (1.6, 2), (30.0, 2)])
def test_without_labels_only_jumps_break_the_line(leap_m: float, pieces: int) -> None:
    found = strokes(way([0.1] * 30 + [leap_m] + [0.1] * 30))
    assert len(found) == pieces
    assert all(stroke.end == stroke.drawn_to for stroke in found)
    assert (found[0].first, found[-1].end) == (0, 62)


@pytest.mark.parametrize(("leap_m", "pieces"), [(5.5, 1), (6.5, 2)])
def test_the_long_steps_of_a_log_with_few_scans_are_no_jumps(leap_m: float, pieces: int) -> None:
    """One scan every two metres: the way is drawn, and a jump three times as long is none of it."""
    assert len(strokes(way([2.0] * 30 + [leap_m] + [2.0] * 30))) == pieces


def test_a_stay_makes_no_way_a_jump() -> None:
    assert len(strokes(way([0.0] * 500 + [1.0] * 20))) == 1
