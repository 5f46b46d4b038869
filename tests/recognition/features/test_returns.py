"""The returns of scans: order, segments, pairs of points."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.records import PlanarScan
from specmap_cli.recognition.features.returns import (
    ReturnsBatch,
)
from tests.recognition.features.one_scan import readings, returns_of, scan_of
from tests.strategies import planar_scans


@given(readings, st.booleans())
def test_readings_are_returns_at_points_or_no_returns_or_invalid(
    ranges: list[float], full: bool
) -> None:
    returns = returns_of(scan_of(np.array(ranges), full))
    assert returns.no_return == sum(r >= 30.0 for r in ranges)
    assert returns.beams == len(ranges)
    kept = [r for r in ranges if 0.0 < r < 30.0]
    assert sorted(returns.ranges) == sorted(kept)
    assert full or returns.ranges.tolist() == kept  # in the order of the beams
    polar = zip(returns.ranges.tolist(), returns.bearings.tolist(), strict=True)
    expected = [(r * math.cos(b), r * math.sin(b)) for r, b in polar]
    assert returns.points == pytest.approx(np.reshape(expected, (-1, 2)))
    assert returns.steps.tolist() == pytest.approx([math.dist(a, b) for a, b in pairwise(expected)])


@given(planar_scans(), st.integers(1, 71))
def test_returns_of_a_circle_begin_behind_its_widest_step_however_the_robot_turns(
    scan: PlanarScan, shift: int
) -> None:
    turned = returns_of(scan_of(np.roll(scan.ranges, shift)))
    still = returns_of(scan_of(scan.ranges))
    assert turned.ranges.tolist() == still.ranges.tolist()
    assert turned.steps == pytest.approx(still.steps)
    left_out = math.dist(still.points[-1], still.points[0])
    assert still.steps.max() <= left_out + 1e-9


def test_the_polygon_of_a_half_circle_holds_the_laser() -> None:
    half, whole = (scan_of(np.full(181, 2.0), full=full) for full in (False, True))
    batch = ReturnsBatch.of([half, whole])
    segments, vertices = batch.polygons
    assert segments.counts.tolist() == [182, 181]
    assert vertices[:, 0].tolist() == [0.0, 0.0]
    areas, perimeters = batch.areas_and_perimeters
    assert areas == pytest.approx([math.pi * 2.0, math.pi * 4.0], rel=0.01)  # discs of 2 m
    assert perimeters[0] == pytest.approx(math.pi * 2.0 + 4.0, rel=0.01)


@given(st.lists(st.tuples(readings, st.booleans()), max_size=5))
def test_a_batch_holds_each_of_its_scans(scans: list[tuple[list[float], bool]]) -> None:
    given_scans = [scan_of(np.array(ranges), full) for ranges, full in scans]
    batch = ReturnsBatch.of(given_scans)
    assert len(batch) == len(scans)
    for k, scan in enumerate(given_scans):
        alone = returns_of(scan)
        assert batch[k].ranges.tolist() == alone.ranges.tolist()
        assert batch[k].points.tolist() == alone.points.tolist()
        assert batch[k].steps.tolist() == alone.steps.tolist()
        assert (batch[k].closed, batch[k].beams) == (alone.closed, alone.beams)
        assert batch[k].no_return == alone.no_return
