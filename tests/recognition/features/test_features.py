"""The returns of scans, and their features: plain loops, NumPy, SciPy and OpenCV."""

import math
from collections.abc import Callable
from itertools import combinations, pairwise

import cv2
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import PlanarScan
from specmap_cli.recognition.features import shape, table1
from specmap_cli.recognition.features.returns import Returns, ReturnsBatch
from specmap_cli.recognition.features.sets import BUILT_IN, feature_names, scans_features
from tests.strategies import planar_scans, seeds

Function = Callable[[ReturnsBatch], FloatArray]
RANGE_MAX_M = 30.0

limits = st.sampled_from([math.inf, math.nan, RANGE_MAX_M, 0.0])
readings = st.lists(st.one_of(st.floats(0.0, 40.0), limits), max_size=40)


def scan_of(ranges: FloatArray, full: bool = True, turn: float = 0.0) -> PlanarScan:
    """A scan all round, or of half a circle, by a laser that is turned."""
    span = np.linspace(-np.pi, np.pi, len(ranges), endpoint=False)
    bearings = (span if full else span / 2.0) + turn
    return PlanarScan(0, bearings, np.asarray(ranges, dtype=np.float64), RANGE_MAX_M, full)


def batch_of(scan: PlanarScan) -> ReturnsBatch:
    """The returns of one scan, as functions of features take them."""
    return ReturnsBatch.of([scan])


def returns_of(scan: PlanarScan) -> Returns:
    """The returns of one scan, as groups of other packages are given them."""
    return batch_of(scan)[0]


def of_one(function: Function, batch: ReturnsBatch) -> list[float]:
    """The values of the first scan of a batch."""
    return [float(value) for value in function(batch)[0]]


def boundary_of(batch: ReturnsBatch) -> tuple[FloatArray, FloatArray, float]:
    """Points (K, 2), normals (K, 2) and length of the boundary of a batch of one."""
    _, points, lengths = shape.boundary(batch)
    return points[:2].T, points[2:].T, float(lengths[0])


@given(readings, st.booleans())
def test_readings_are_returns_or_no_returns_or_invalid(ranges: list[float], full: bool) -> None:
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
def test_returns_of_a_circle_begin_behind_its_widest_step(scan: PlanarScan, shift: int) -> None:
    turned = returns_of(scan_of(np.roll(scan.ranges, shift)))
    still = returns_of(scan_of(scan.ranges))
    assert turned.ranges.tolist() == still.ranges.tolist()
    assert turned.steps == pytest.approx(still.steps)
    assert still.steps.max() <= math.dist(still.points[-1], still.points[0]) + 1e-9


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


named_groups = [pytest.param(group.compute, id=group.columns[0]) for group in BUILT_IN["full"]]
every_group = pytest.mark.parametrize("group", named_groups)


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


@every_group
@given(seed=st.integers(0, 10_000), shift=st.integers(1, 179))
def test_no_group_changes_when_the_robot_turns(group: Function, seed: int, shift: int) -> None:
    ranges = room(seed)
    still = of_one(group, batch_of(scan_of(ranges)))
    turned = of_one(group, batch_of(scan_of(np.roll(ranges, shift))))
    assert turned == pytest.approx(still, rel=2e-4, abs=2e-4)


@every_group
@pytest.mark.parametrize("turn", [0.4, -1.3])
def test_every_group_ignores_where_a_narrow_laser_points(group: Function, turn: float) -> None:
    ranges = room(7)
    ahead = of_one(group, batch_of(scan_of(ranges, full=False)))
    aside = of_one(group, batch_of(scan_of(ranges, full=False, turn=turn)))
    assert aside == pytest.approx(ahead, rel=1e-3, abs=1e-3)


@given(readings, st.booleans())
@example([math.inf] * 9, True)
@example([math.inf, 2.0, math.inf], False)
@example([2.0, 2.0, math.inf], True)
@example([2.0, 3.0, math.inf], True)
@example([2.0, 2.0, 2.0], False)
def test_features_are_finite_for_any_readings(ranges: list[float], full: bool) -> None:
    features = scans_features([scan_of(np.array(ranges), full)], "full")
    assert features.shape == (1, len(feature_names("full")))
    assert np.isfinite(features).all()


def test_table_1_has_its_twelve_groups() -> None:
    assert len(table1.GROUPS) == 12


def test_readings_without_a_return_are_only_counted() -> None:
    ranges = room(5, holes=0.0)
    kept = scans_features([scan_of(ranges)], "table1")[0]
    ranges = np.insert(ranges, 50, [np.nan] * 20)  # invalid: not even counted as no return
    assert of_one(table1.readings_at_max_range, batch_of(scan_of(ranges))) == [0.0]
    assert kept[feature_names("table1").index("no_return_share")] == 0.0
    ranges[60:80] = np.inf
    share = of_one(table1.readings_at_max_range, batch_of(scan_of(ranges)))[0]
    assert share == pytest.approx(np.count_nonzero(np.isinf(ranges)) / len(ranges))


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


def test_gaps_extents_and_flips_of_scans_made_by_hand() -> None:
    step = np.where(np.arange(100) < 50, 2.0, 3.0)
    assert of_one(table1.gaps, batch_of(scan_of(step))) == [2.0, 2.0, 0.0]  # all round
    two = np.full(360, 2.0)
    two[0], two[90] = 1.0, 5.0
    assert of_one(table1.range_extent, batch_of(scan_of(two))) == pytest.approx([4.0, math.pi / 2])
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
    expected = np.zeros((len(shape.DISTANCE_EDGES_M) + 1, 4))
    for i, j in combinations(range(len(points)), 2):
        distance = math.dist(points[i], points[j])
        cosine = float(normals[i] @ normals[j])
        inward = float((points[j] - points[i]) @ (normals[i] - normals[j])) > 0.0
        across = 1 if inward else 2
        kind = 0 if cosine > math.sqrt(0.5) else 3 if cosine < -math.sqrt(0.5) else across
        expected[np.searchsorted(shape.DISTANCE_EDGES_M, distance, side="right"), kind] += 1
    values = np.array(of_one(shape.point_pair_histogram, returns))
    assert values[:-2] == pytest.approx((expected / expected.sum()).ravel(), abs=2e-3)
    assert values[-2:] == pytest.approx([length, len(points)])


def test_normals_of_the_boundary_point_to_the_robot_and_it_does_not_cross_leaps() -> None:
    points, normals, length = boundary_of(batch_of(scan_of(rectangle(5, 4, 2, 2))))
    assert length == pytest.approx(18.0, rel=0.03)
    assert ((points * normals).sum(axis=1) < 0.0).all()
    assert np.hypot(*normals.T) == pytest.approx(np.ones(len(normals)))
    _, _, length = boundary_of(batch_of(scan_of(np.where(np.arange(360) < 180, 2.0, 4.0))))
    assert length == pytest.approx(np.pi * 6.0, rel=0.02)


@given(planar_scans())
def test_area_axes_and_centroid_are_those_of_scipy_numpy_and_a_loop(scan: PlanarScan) -> None:
    returns = batch_of(scan)
    area, perimeter, convexity, smoothness = of_one(table1.area_and_convexity, returns)
    assert [value[0] for value in returns.areas_and_perimeters] == pytest.approx([area, perimeter])
    hull = ConvexHull(returns.polygons[1].T)  # its volume is the area, its area the length
    assert convexity == pytest.approx(min(1.0, area / hull.volume), abs=1e-5)
    assert smoothness == pytest.approx(min(1.0, hull.area / perimeter), abs=1e-5)
    smaller, larger = np.linalg.eigvalsh(np.cov(returns.points))
    assert of_one(table1.aspect_ratio, returns) == pytest.approx([larger / smaller])
    x, y = np.mean(returns.points, axis=1)
    distances = [math.hypot(px - x, py - y) for px, py in returns.points.T.tolist()]
    assert of_one(table1.mean_distance_to_centroid, returns) == pytest.approx([np.mean(distances)])
    roundness, compactness = of_one(table1.circularity, returns)
    assert compactness == pytest.approx(area / (math.pi * max(distances) ** 2))
    assert roundness == pytest.approx(4.0 * math.pi * area / perimeter**2)
    assert roundness <= 1.0  # the isoperimetric inequality


@pytest.mark.parametrize("ranges", [[1e-59, 1e-160], [5e-60] * 7, [1e-30, 1e-59, math.inf, 1e-59]])
@pytest.mark.parametrize("full", [True, False])
def test_a_scan_within_single_precision_s_least_is_a_point(ranges: list[float], full: bool) -> None:
    values = of_one(table1.area_and_convexity, batch_of(scan_of(np.array(ranges), full)))
    assert values == pytest.approx([0.0, 0.0, 0.0, 0.0], abs=1e-29)


@given(st.lists(st.floats(0.5, 20.0), min_size=2, max_size=60))
def test_changes_gaps_and_flips_by_loops(ranges: list[float]) -> None:
    returns = batch_of(scan_of(np.array(ranges), full=False))
    changes = [abs(b - a) for a, b in pairwise(ranges)]
    expected = [np.mean(changes), np.std(changes)]
    assert of_one(table1.consecutive_differences, returns) == pytest.approx(expected)
    for gap, counted in zip(table1.GAP_THRESHOLDS_M, of_one(table1.gaps, returns), strict=True):
        assert counted == sum(change > gap for change in changes)
    bends = [c - 2.0 * b + a for a, b, c in zip(ranges, ranges[1:], ranges[2:], strict=False)]
    if all(abs(bend) > 1e-9 for bend in bends):
        flips = sum((a > 0.0) != (b > 0.0) for a, b in pairwise(bends))
        assert of_one(table1.second_derivative_flips, returns) == [float(flips)]


@given(planar_scans())
def test_quantiles_rings_and_clips_are_numpy_s(scan: PlanarScan) -> None:
    returns = batch_of(scan)
    ranges = returns.ranges
    expected = np.quantile(ranges, shape.QUANTILES)
    assert of_one(shape.range_quantiles, returns) == pytest.approx(expected.tolist())
    rings = np.histogram(ranges, [0.0, *shape.RING_EDGES_M, np.inf])[0] / len(ranges)
    assert of_one(shape.ring_histogram, returns) == pytest.approx(rings.tolist())
    clipped = iter(of_one(shape.clipped_ranges, returns))
    for clip in shape.CLIPS_M:
        cut = np.minimum(ranges, clip)
        values = [(ranges < clip).mean(), cut.mean(), cut.std()]
        assert [next(clipped) for _ in values] == pytest.approx(values, abs=1e-6)


def test_harmonics_are_the_terms_of_the_fourier_series() -> None:
    bearings = np.linspace(-np.pi, np.pi, 720, endpoint=False)
    ranges = 5.0 + 1.0 * np.cos(3.0 * bearings - 0.7) + 0.25 * np.sin(7.0 * bearings)
    values = of_one(shape.harmonics, batch_of(scan_of(ranges)))
    expected = [{3: 0.5, 7: 0.125}.get(k, 0.0) for k in range(1, shape.HARMONICS + 1)]
    assert values == pytest.approx(expected, abs=2e-3)


@given(seeds)
def test_pieces_by_a_loop(seed: int) -> None:
    ranges = np.random.default_rng(seed).choice([2.0, 2.1, 5.0], 60, p=[0.5, 0.3, 0.2])
    returns = batch_of(scan_of(ranges, full=False))
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
    rng = np.random.default_rng(seed)
    phase, height = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.1, 0.5)
    wall = 4.0 + height * np.sin(np.linspace(0.0, 3.0, 180) + phase)
    returns = batch_of(scan_of(wall, full=False))
    points, normals, length = boundary_of(returns)
    assert length == pytest.approx(returns.onward[:-1].sum())
    assert len(points) == 110  # the most: the wall is longer than 110 steps of 8 cm
    gaps = np.hypot(*np.diff(points, axis=0).T)
    assert gaps == pytest.approx(np.full(len(gaps), length / 110), rel=0.02)
    tangents = np.diff(points, axis=0) / gaps[:, None]
    assert np.abs((tangents * normals[:-1]).sum(axis=1)).max() < 0.2  # normals stand upright


@given(seeds, st.floats(0.3, 3.0), st.floats(-3.0, 3.0))
def test_moment_invariants_ignore_size_and_direction_and_the_seventh_tells_a_mirrored_room(
    seed: int, scale: float, turn: float
) -> None:
    def invariants(ranges: FloatArray, turn: float = 0.0) -> list[float]:
        return of_one(table1.moment_invariants, batch_of(scan_of(ranges, turn=turn)))

    bearings = np.linspace(-np.pi, np.pi, 60, endpoint=False)
    ranges = 3.0 + np.sin(2.0 * bearings + 1.0) + 0.8 * np.cos(3.0 * bearings)
    assert abs(invariants(ranges)[6]) > 1e-9
    ranges += np.random.default_rng(seed).uniform(-0.3, 0.3, 60)
    *same, seventh = invariants(ranges)
    changed, mirrored = invariants(scale * ranges, turn), invariants(ranges[::-1])
    assert changed == pytest.approx([*same, seventh], rel=1e-6, abs=1e-12)
    assert mirrored == pytest.approx([*same, -seventh], rel=1e-6, abs=1e-12)
