"""Features of one scan: invariance, degenerate scans, and values known from geometry."""

from __future__ import annotations

import math
from itertools import combinations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import PlanarScan
from specmap_cli.recognition.features import point_pairs, shape, table1
from specmap_cli.recognition.features.sets import BUILT_IN, feature_names, scans_features
from tests.recognition.features.one_scan import Function, batch_of, boundary_of, of_one

GROUPS = [group.compute for group in BUILT_IN["full"]]


def scan_of(ranges: FloatArray, full: bool = True, turn: float = 0.0) -> PlanarScan:
    span = np.linspace(-np.pi, np.pi, len(ranges), endpoint=False)
    bearings = span if full else span / 2.0
    return PlanarScan(0, bearings + turn, np.asarray(ranges, dtype=np.float64), 30.0, full)


def rectangle(width: float, height: float, x: float, y: float, *, beams: int = 720) -> FloatArray:
    """Ranges in a rectangle of free space from (x, y) off its lower left corner."""
    angle = np.linspace(-np.pi, np.pi, beams, endpoint=False)
    with np.errstate(divide="ignore"):
        across = np.where(np.cos(angle) > 0, (width - x), x) / np.abs(np.cos(angle))
        along = np.where(np.sin(angle) > 0, (height - y), y) / np.abs(np.sin(angle))
    return np.asarray(np.minimum(across, along))


def room(seed: int, beams: int = 180, holes: float = 0.1) -> FloatArray:
    """Ranges of a random room with a step in its returns and beams without a return."""
    rng = np.random.default_rng(seed)
    width, height = rng.uniform(4.0, 9.0, 2).tolist()
    ranges = rectangle(width, height, *rng.uniform(1.0, 3.0, 2).tolist(), beams=beams)
    ranges = np.minimum(ranges, np.where(np.arange(beams) // 30 % 2, 20.0, 2.5))
    ranges = ranges + rng.normal(0.0, 0.01, beams)
    ranges[rng.random(beams) < holes] = np.inf
    return ranges


@pytest.mark.parametrize("group", GROUPS, ids=lambda g: g.__name__)
@given(seed=st.integers(0, 10_000), shift=st.integers(1, 179))
def test_every_group_is_unchanged_when_the_robot_turns(
    group: Function, seed: int, shift: int
) -> None:
    ranges = room(seed)
    still = of_one(group, batch_of(scan_of(ranges)))
    turned = of_one(group, batch_of(scan_of(np.roll(ranges, shift))))
    assert turned == pytest.approx(still, rel=2e-4, abs=2e-4)


@pytest.mark.parametrize("group", GROUPS, ids=lambda g: g.__name__)
@pytest.mark.parametrize("turn", [0.4, -1.3])
def test_every_group_ignores_where_a_narrow_laser_points(group: Function, turn: float) -> None:
    ranges = room(7)
    ahead = of_one(group, batch_of(scan_of(ranges, full=False)))
    aside = of_one(group, batch_of(scan_of(ranges, full=False, turn=turn)))
    assert aside == pytest.approx(ahead, rel=1e-3, abs=1e-3)


@pytest.mark.parametrize("returns", [0, 1, 2, 3])
@pytest.mark.parametrize("full", [True, False])
@pytest.mark.parametrize("same", [True, False])
def test_features_are_finite_with_hardly_a_return(returns: int, full: bool, same: bool) -> None:
    ranges = np.full(90, np.inf)
    ranges[10 : 10 + returns] = 2.0 if same else 2.0 + np.arange(returns)
    values = scans_features([scan_of(ranges, full)], "full")[0]
    assert values.shape == (len(feature_names("full")),)
    assert np.isfinite(values).all()


@given(
    st.lists(
        st.one_of(st.floats(0.0, 40.0), st.sampled_from([math.inf, math.nan, 30.0, 0.0])),
        min_size=0,
        max_size=40,
    ),
    st.booleans(),
)
def test_features_are_finite_for_any_readings(ranges: list[float], full: bool) -> None:
    assert np.isfinite(scans_features([scan_of(np.array(ranges), full)], "full")).all()


def test_table_1_has_its_twelve_groups() -> None:
    assert len(table1.GROUPS) == 12
    for group in table1.GROUPS:
        assert len(of_one(group.compute, batch_of(scan_of(room(3))))) == len(group.columns)


def test_readings_without_a_return_are_only_counted() -> None:
    ranges = room(5, holes=0.0)
    kept = scans_features([scan_of(ranges)], "table1")[0]
    ranges = np.insert(ranges, 50, [np.nan] * 20)  # invalid: not even counted as no return
    counted = of_one(table1.readings_at_max_range, batch_of(scan_of(ranges)))
    assert counted == [0.0]
    assert kept[feature_names("table1").index("no_return_share")] == 0.0
    ranges[60:80] = np.inf
    share = of_one(table1.readings_at_max_range, batch_of(scan_of(ranges)))[0]
    assert share == pytest.approx(np.count_nonzero(np.isinf(ranges)) / len(ranges))


def test_area_perimeter_and_convexity_of_a_rectangle() -> None:
    area, perimeter, convexity, smoothness = of_one(
        table1.area_and_convexity, batch_of(scan_of(rectangle(6.0, 4.0, 2.0, 1.0)))
    )
    assert area == pytest.approx(24.0, rel=0.01)
    assert perimeter == pytest.approx(20.0, rel=0.01)
    assert convexity == pytest.approx(1.0, abs=0.01)
    assert smoothness == pytest.approx(1.0, abs=0.01)


def test_a_disc_is_circular_and_its_aspect_is_one() -> None:
    returns = batch_of(scan_of(np.full(360, 3.0)))
    assert of_one(table1.circularity, returns) == pytest.approx([1.0, 1.0], abs=0.01)
    assert of_one(table1.aspect_ratio, returns) == pytest.approx([1.0], abs=0.01)
    assert of_one(table1.mean_distance_to_centroid, returns) == pytest.approx([3.0])


def test_moment_invariants_equal_opencv_s() -> None:
    returns = batch_of(scan_of(room(11, holes=0.0)))
    contour = returns.polygons[1].T.astype(np.float32).reshape(-1, 1, 2)
    expected = cv2.HuMoments(cv2.moments(contour)).ravel()
    ours = np.array(of_one(table1.moment_invariants, returns))
    # the seventh changes its sign with the direction in which the contour runs
    assert np.abs(ours) == pytest.approx(np.abs(expected), rel=1e-3, abs=1e-9)


def test_range_moments_equal_scipy_s() -> None:
    from scipy import stats

    returns = batch_of(scan_of(room(2)))
    r = returns.ranges
    expected = [r.mean(), r.std(), stats.skew(r), stats.kurtosis(r, fisher=False)]
    assert of_one(table1.range_moments, returns) == pytest.approx(expected)


def test_differences_and_gaps_of_a_step() -> None:
    ranges = np.where(np.arange(100) < 50, 2.0, 3.0)
    returns = batch_of(scan_of(ranges, full=False))
    assert of_one(table1.consecutive_differences, returns)[0] == pytest.approx(1.0 / 99)
    assert of_one(table1.gaps, returns) == [1.0, 1.0, 0.0]
    around = batch_of(scan_of(ranges))
    assert of_one(table1.gaps, around) == [2.0, 2.0, 0.0]


def test_extent_and_its_angle() -> None:
    ranges = np.full(360, 2.0)
    ranges[0], ranges[90] = 1.0, 5.0
    returns = batch_of(scan_of(ranges))
    assert of_one(table1.range_extent, returns) == pytest.approx([4.0, math.pi / 2])


def test_flips_count_the_bumps() -> None:
    bumpy = 3.0 + 0.5 * np.sin(np.linspace(0.0, 8.0 * np.pi, 400, endpoint=False))
    assert of_one(table1.second_derivative_flips, batch_of(scan_of(bumpy))) == [8.0]


@pytest.mark.parametrize(
    ("function", "edges"),
    [
        (table1.distance_histogram, table1.DISTANCE_EDGES_M),
        (shape.fine_distance_histogram, shape.FINE_EDGES_M),
    ],
)
def test_distance_histograms_count_every_pair(function: Function, edges: tuple[float, ...]) -> None:
    returns = batch_of(scan_of(room(4, beams=80), full=False))
    distances = [math.dist(a, b) for a, b in combinations(returns.points.T.tolist(), 2)]
    expected = np.histogram(distances, [0.0, *edges, np.inf])[0] / len(distances)
    assert of_one(function, returns) == pytest.approx(expected.tolist())


def test_point_pairs_count_every_pair_by_distance_and_orientation() -> None:
    returns = batch_of(scan_of(room(6)))
    points, normals, length = boundary_of(returns)
    expected = np.zeros((len(point_pairs.DISTANCE_EDGES_M) + 1, 4))
    for i, j in combinations(range(len(points)), 2):
        distance = math.dist(points[i], points[j])
        cosine = float(normals[i] @ normals[j])
        inward = float((points[j] - points[i]) @ (normals[i] - normals[j])) > 0.0
        across = 1 if inward else 2
        kind = 0 if cosine > math.sqrt(0.5) else 3 if cosine < -math.sqrt(0.5) else across
        expected[np.searchsorted(point_pairs.DISTANCE_EDGES_M, distance, side="right"), kind] += 1
    values = np.array(of_one(point_pairs.point_pair_histogram, returns))
    assert values[:-2] == pytest.approx((expected / expected.sum()).ravel(), abs=2e-3)
    assert values[-2:] == pytest.approx([length, len(points)])


def test_normals_of_the_boundary_point_to_the_robot() -> None:
    points, normals, length = boundary_of(batch_of(scan_of(rectangle(5, 4, 2, 2))))
    assert length == pytest.approx(18.0, rel=0.03)
    assert ((points * normals).sum(axis=1) < 0.0).all()
    assert np.hypot(*normals.T) == pytest.approx(np.ones(len(normals)))


def test_the_boundary_does_not_cross_leaps() -> None:
    ranges = np.where(np.arange(360) < 180, 2.0, 4.0)
    _, _, length = boundary_of(batch_of(scan_of(ranges)))
    assert length == pytest.approx(np.pi * 6.0, rel=0.02)


def test_pieces_of_two_walls() -> None:
    ranges = np.where(np.arange(360) < 180, 2.0, 4.0)
    pieces = of_one(shape.pieces, batch_of(scan_of(ranges)))
    assert pieces[0] == 2.0
    assert pieces[4] == pytest.approx(np.pi * 4.0, rel=0.02)


def test_harmonics_see_a_square_s_four_corners() -> None:
    values = of_one(shape.harmonics, batch_of(scan_of(rectangle(4, 4, 2, 2))))
    assert int(np.argmax(values)) + 1 == 4
