"""Single features against plain loops, NumPy and SciPy."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import PlanarScan
from specmap_cli.recognition.features import point_pairs, shape, table1
from specmap_cli.recognition.features.returns import ReturnsBatch
from tests.recognition.features.one_scan import batch_of, boundary_of, of_one
from tests.strategies import planar_scans, seeds


def half_circle(ranges: FloatArray) -> ReturnsBatch:
    bearings = np.linspace(-np.pi / 2, np.pi / 2, len(ranges))
    return batch_of(PlanarScan(0, bearings, np.asarray(ranges), 30.0, full_circle=False))


def smooth(seed: int, beams: int = 180) -> ReturnsBatch:
    """A half circle of ranges that change slowly: one piece of wall."""
    rng = np.random.default_rng(seed)
    phase, height = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.1, 0.5)
    return half_circle(4.0 + height * np.sin(np.linspace(0.0, 3.0, beams) + phase))


@given(planar_scans())
def test_convexities_are_those_of_scipy_s_hull(scan: PlanarScan) -> None:
    returns = batch_of(scan)
    area, perimeter, convexity, smoothness = of_one(table1.area_and_convexity, returns)
    hull = ConvexHull(returns.polygons[1].T)  # its volume is the area, its area the length
    assert convexity == pytest.approx(min(1.0, area / hull.volume), abs=1e-5)
    assert smoothness == pytest.approx(min(1.0, hull.area / perimeter), abs=1e-5)


@given(planar_scans())
def test_the_aspect_is_the_ratio_of_the_principal_components(scan: PlanarScan) -> None:
    returns = batch_of(scan)
    smaller, larger = np.linalg.eigvalsh(np.cov(returns.points))
    assert of_one(table1.aspect_ratio, returns) == pytest.approx([larger / smaller])


def test_the_aspect_of_a_line_is_large_and_finite() -> None:
    bearings = np.linspace(-1.0, 1.0, 50)
    wall = PlanarScan(0, bearings, 2.0 / np.cos(bearings), 30.0, full_circle=False)
    assert of_one(table1.aspect_ratio, batch_of(wall)) == [1e6]


@given(planar_scans())
def test_distances_to_the_centroid_and_compactness(scan: PlanarScan) -> None:
    returns = batch_of(scan)
    x, y = np.mean(returns.points, axis=1)
    distances = [math.hypot(px - x, py - y) for px, py in returns.points.T.tolist()]
    assert of_one(table1.mean_distance_to_centroid, returns) == pytest.approx([np.mean(distances)])
    roundness, compactness = of_one(table1.circularity, returns)
    area, perimeter = (value[0] for value in returns.areas_and_perimeters)
    assert compactness == pytest.approx(area / (math.pi * max(distances) ** 2))
    assert roundness == pytest.approx(4.0 * math.pi * area / perimeter**2)
    assert roundness <= 1.0  # the isoperimetric inequality


@given(st.lists(st.floats(0.5, 20.0), min_size=2, max_size=60))
def test_changes_gaps_and_flips_by_loops(ranges: list[float]) -> None:
    returns = half_circle(np.array(ranges))
    changes = [abs(b - a) for a, b in pairwise(ranges)]
    expected = [np.mean(changes), np.std(changes)]
    assert of_one(table1.consecutive_differences, returns) == pytest.approx(expected)
    for threshold, counted in zip(
        table1.GAP_THRESHOLDS_M, of_one(table1.gaps, returns), strict=True
    ):
        assert counted == sum(change > threshold for change in changes)
    bends = [c - 2.0 * b + a for a, b, c in zip(ranges, ranges[1:], ranges[2:], strict=False)]
    if all(abs(bend) > 1e-9 for bend in bends):
        flips = sum((a > 0.0) != (b > 0.0) for a, b in pairwise(bends))
        assert of_one(table1.second_derivative_flips, returns) == [float(flips)]


@given(seeds, st.floats(0.3, 3.0), st.floats(-3.0, 3.0))
def test_moment_invariants_do_not_change_with_size_nor_direction(
    seed: int, scale: float, turn: float
) -> None:
    rng = np.random.default_rng(seed)
    bearings = np.linspace(-np.pi, np.pi, 60, endpoint=False)
    ranges = 3.0 + np.sin(2.0 * bearings + 1.0) + rng.uniform(-0.3, 0.3, 60)
    plain = batch_of(PlanarScan(0, bearings, ranges, 50.0, full_circle=True))
    changed = batch_of(PlanarScan(0, bearings + turn, scale * ranges, 50.0, full_circle=True))
    values = of_one(table1.moment_invariants, plain)
    assert of_one(table1.moment_invariants, changed) == pytest.approx(values, rel=1e-6, abs=1e-12)


def test_a_mirrored_room_differs_in_the_seventh_invariant_alone() -> None:
    bearings = np.linspace(-np.pi, np.pi, 60, endpoint=False)
    ranges = 3.0 + np.sin(2.0 * bearings + 1.0) + 0.8 * np.cos(3.0 * bearings)
    room = batch_of(PlanarScan(0, bearings, ranges, 50.0, full_circle=True))
    mirrored = batch_of(PlanarScan(0, -bearings[::-1], ranges[::-1], 50.0, full_circle=True))
    values = of_one(table1.moment_invariants, room)
    seen = of_one(table1.moment_invariants, mirrored)
    assert seen[:6] == pytest.approx(values[:6])
    assert seen[6] == pytest.approx(-values[6])
    assert abs(values[6]) > 1e-9


@given(planar_scans())
def test_quantiles_rings_and_clips_are_numpy_s(scan: PlanarScan) -> None:
    returns = batch_of(scan)
    ranges = returns.ranges
    expected = np.quantile(ranges, shape.QUANTILES)
    assert of_one(shape.range_quantiles, returns) == pytest.approx(expected.tolist())
    edges = [0.0, *shape.RING_EDGES_M, np.inf]
    rings = np.histogram(ranges, edges)[0] / len(ranges)
    assert of_one(shape.ring_histogram, returns) == pytest.approx(rings.tolist())
    clipped = iter(of_one(shape.clipped_ranges, returns))
    for clip in shape.CLIPS_M:
        cut = np.minimum(ranges, clip)
        values = [(ranges < clip).mean(), cut.mean(), cut.std()]
        assert [next(clipped) for _ in values] == pytest.approx(values, abs=1e-6)


def test_harmonics_are_the_terms_of_the_fourier_series() -> None:
    bearings = np.linspace(-np.pi, np.pi, 720, endpoint=False)
    ranges = 5.0 + 1.0 * np.cos(3.0 * bearings - 0.7) + 0.25 * np.sin(7.0 * bearings)
    scan = PlanarScan(0, bearings, ranges, 50.0, full_circle=True)
    values = of_one(shape.harmonics, batch_of(scan))
    expected = [{3: 0.5, 7: 0.125}.get(k, 0.0) for k in range(1, shape.HARMONICS + 1)]
    assert values == pytest.approx(expected, abs=2e-3)


def test_ranges_beyond_the_last_ring_weigh_no_more_for_being_farther() -> None:
    near, far = (np.where(np.arange(180) < 90, 3.0, reach) for reach in (13.0, 29.0))
    assert of_one(shape.harmonics, half_circle(far)) == of_one(shape.harmonics, half_circle(near))
    assert of_one(shape.ring_histogram, half_circle(far)) == of_one(
        shape.ring_histogram, half_circle(near)
    )


@given(seeds)
def test_pieces_by_a_loop(seed: int) -> None:
    ranges = np.random.default_rng(seed).choice([2.0, 2.1, 5.0], 60, p=[0.5, 0.3, 0.2])
    returns = half_circle(ranges)
    lengths, current = [], 0.0
    for k, step in enumerate(returns.onward[:-1].tolist()):
        if step > 0.25 + 0.03 * min(ranges[k], ranges[k + 1]):
            lengths.append(current)
            current = 0.0
        else:
            current += step
    lengths.append(current)
    longer = [sum(length > limit for length in lengths) for limit in (0.5, 1.0, 2.0)]
    expected = [len(lengths), *longer, max(lengths), np.mean(lengths)]
    assert of_one(shape.pieces, returns) == pytest.approx(expected)


@given(seeds)
def test_the_boundary_is_even_along_a_smooth_wall(seed: int) -> None:
    returns = smooth(seed)
    points, normals, length = boundary_of(returns)
    assert length == pytest.approx(returns.onward[:-1].sum())
    assert len(points) == 110  # the most: the wall is longer than 110 steps of 8 cm
    gaps = np.hypot(*np.diff(points, axis=0).T)
    assert gaps == pytest.approx(np.full(len(gaps), length / 110), rel=0.02)
    tangents = np.diff(points, axis=0) / gaps[:, None]
    assert np.abs((tangents * normals[:-1]).sum(axis=1)).max() < 0.2  # normals stand upright


def test_a_short_wall_has_a_point_every_eight_centimetres() -> None:
    points, _, length = boundary_of(half_circle(np.full(60, 0.4)))
    assert length == pytest.approx(0.4 * math.pi, rel=0.01)
    assert len(points) == round(length / 0.08)


def test_facing_walls_are_opposed_and_one_wall_is_parallel() -> None:
    bearings = np.linspace(-np.pi, np.pi, 720, endpoint=False)
    corridor = np.minimum(1.0 / np.maximum(np.abs(np.sin(bearings)), 1e-9), 8.0)
    corridor[np.abs(np.sin(bearings)) < 0.2] = np.inf  # its ends are open
    scan = PlanarScan(0, bearings, corridor, 30.0, full_circle=True)
    values = of_one(point_pairs.point_pair_histogram, batch_of(scan))
    shares = dict(zip(point_pairs.PAIR_COLUMNS, values[:-2], strict=True))
    parallel = sum(v for name, v in shares.items() if "parallel" in name)
    opposed = sum(v for name, v in shares.items() if "opposed" in name)
    assert parallel + opposed == pytest.approx(1.0)
    assert opposed == pytest.approx(0.5, abs=0.02)  # half of the pairs are on two walls
    near = [v for name, v in shares.items() if "opposed" in name and name.endswith(("_0m", "1.2m"))]
    assert sum(near) == 0.0  # opposite walls are 2 m apart
