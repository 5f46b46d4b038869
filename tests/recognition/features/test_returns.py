"""The returns of scans: order, segments, pairs of points."""

from __future__ import annotations

import math
from itertools import combinations, pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import IntArray, PlanarScan
from specmap_cli.recognition.features.returns import (
    ReturnsBatch,
    Segments,
    pair_shares,
    ratio,
)
from tests.recognition.features.one_scan import batch_of, readings, returns_of, scan_of
from tests.strategies import planar_scans

pieces = st.lists(st.lists(st.floats(-5.0, 5.0), max_size=6), max_size=6)


@given(pieces)
def test_values_of_every_piece_are_those_of_a_loop(given_pieces: list[list[float]]) -> None:
    segments = Segments.of_counts(np.array([len(piece) for piece in given_pieces]))
    values = np.array([value for piece in given_pieces for value in piece])
    assert len(segments) == len(given_pieces)
    assert segments.sum(values) == pytest.approx([sum(piece) for piece in given_pieces])
    means = np.array([float(np.mean(piece)) if piece else 0.0 for piece in given_pieces])
    assert segments.mean(np.stack([values, -values])) == pytest.approx(np.stack([means, -means]))
    assert segments.max(values).tolist() == [max(piece, default=0.0) for piece in given_pieces]
    assert segments.sum(values > 0).tolist() == [
        sum(v > 0 for v in piece) for piece in given_pieces
    ]
    largest = segments.argmax(values) - segments.starts[:-1]
    assert largest.tolist() == [int(np.argmax(piece)) if piece else 0 for piece in given_pieces]
    summed = [total for piece in given_pieces for total in np.cumsum(piece)]
    assert segments.cumsum(values).tolist() == summed
    after = [value for piece in given_pieces for value in (*piece[1:], *piece[:1])]
    assert values[segments.following].tolist() == after
    rows = segments.padded(values, np.nan, width=2)
    assert [row[np.isfinite(row)].tolist() for row in rows] == given_pieces
    positive = segments.kept(values > 0.0)
    assert positive.counts.tolist() == [sum(v > 0 for v in piece) for piece in given_pieces]
    assert segments.last.sum() == sum(bool(piece) for piece in given_pieces)


def test_a_ratio_to_nothing_is_nought() -> None:
    assert ratio(np.array([1.0, 3.0]), np.array([0.0, 2.0])).tolist() == [0.0, 1.5]


@pytest.mark.parametrize("count", [0, 1, 2, 3, 5, 6, 30])
def test_each_pair_is_counted_once_and_none_with_what_is_missing(count: int) -> None:
    none = 30 * 30

    def bins(first: FloatArray, second: FloatArray) -> IntArray:
        pair = 30 * np.minimum(first, second) + np.maximum(first, second)
        return np.asarray(np.where(np.isnan(pair), none, pair)[0], dtype=np.intp)

    # beside a piece that is longer, and so has more places
    segments = Segments.of_counts(np.array([count, 30]))
    values = np.concatenate([np.arange(count), np.arange(30)])[None].astype(np.float64)
    shares = pair_shares(segments, values, bins, none + 1, none)[0]
    pairs = [30 * a + b for a, b in combinations(range(count), 2)]
    assert np.flatnonzero(shares).tolist() == pairs
    assert shares[pairs] == pytest.approx(1.0 / max(1, len(pairs)))


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


def test_a_dense_scan_is_thinned_for_its_pairs() -> None:
    rng = np.random.default_rng(0)
    dense = batch_of(scan_of(rng.uniform(2.0, 4.0, 1440)))
    sparse = batch_of(scan_of(dense.ranges[np.argsort(dense.bearings)][::4]))
    assert np.abs(np.cumsum(dense.pair_shares) - np.cumsum(sparse.pair_shares)).max() < 0.1


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
