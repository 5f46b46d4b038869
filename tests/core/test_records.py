"""Records between stages, arrays of them, and rigid motions, against other libraries."""

import itertools
import math

import networkx as nx
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy import ndimage
from scipy.spatial.transform import Rotation

from specmap_cli.core import geometry, records
from specmap_cli.core.arrays import evenly, first_in_cells, neighbours, runs, windows_of
from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2, moved, product, wrap_angle
from specmap_cli.core.records import PlanarScan
from tests.strategies import planar_scans, pose_arrays, poses, seeds


@given(st.lists(st.integers(-1, 4), max_size=30))
def test_runs_are_those_of_groupby(labels: list[int]) -> None:
    groups = [(label, len(list(group))) for label, group in itertools.groupby(labels)]
    assert [(labels[a], b - a) for a, b in runs(np.array(labels, dtype=np.int64))] == groups


@given(seeds, st.integers(1, 9), st.integers(1, 9))
def test_windows_are_those_of_scipy(seed: int, high: int, wide: int) -> None:
    labels = np.random.default_rng(seed).integers(-1, 4, (high, wide)).astype(np.int16)
    found = enumerate(ndimage.find_objects(labels + 1))
    assert windows_of(labels) == {label: at for label, at in found if at is not None}


@given(st.lists(st.tuples(st.integers(0, 5), st.integers(0, 5)), max_size=12))
def test_neighbours_are_those_of_networkx(pairs: list[tuple[int, int]]) -> None:
    graph = nx.empty_graph(6)
    graph.add_edges_from(pair for pair in pairs if pair[0] != pair[1])
    assert neighbours(range(6), pairs) == {node: frozenset(graph[node]) for node in graph}
    with pytest.raises(KeyError):  # a pair of strangers
        neighbours(range(6), [*pairs, (0, 7)])


@given(st.integers(0, 200), st.integers(1, 60))
def test_what_is_kept_is_spread_evenly(count: int, most: int) -> None:
    kept = evenly(np.arange(count), most)
    assert len(kept) == min(count, most)
    gaps = np.diff(kept)
    assert (gaps > 0).all()
    if count > most > 1:
        assert (kept[0], kept[-1], np.ptp(gaps) <= 1) == (0, count - 1, True)
    rows = np.arange(2 * count).reshape(count, 2)  # which are kept whole
    assert evenly(rows, most).tolist() == rows[kept].tolist()
    assert evenly(rows, count) is rows


@given(seeds, st.just(200))
@example(0, 1)
@example(0, 0)
def test_the_first_point_of_each_cell_is_kept(seed: int, count: int) -> None:
    points = np.random.default_rng(seed).uniform(-3.0, 3.0, (count, 3))
    first: dict[tuple[float, ...], int] = {}
    for number, point in enumerate(points):
        first.setdefault(tuple(np.floor(point / 0.7).tolist()), number)
    assert first_in_cells(points, 0.7).tolist() == sorted(first.values())


@pytest.mark.parametrize("away", [1e3, 1e6, 1e12])
def test_cells_too_many_to_number_are_told_apart(away: float) -> None:
    points = np.array([[0, 0, 0], [away, -away, away], [0.05, 0, 0], [away, -away, away]])
    assert first_in_cells(points, 0.1).tolist() == [0, 1]
    assert first_in_cells(points[:, :2], 0.1).tolist() == [0, 1]


def test_records_are_frozen_slotted_and_documented() -> None:
    of_here = (kind for kind in vars(records).values() if isinstance(kind, type))
    for kind in (kind for kind in of_here if kind.__module__ == records.__name__):
        assert kind.__dataclass_params__.frozen, kind  # type: ignore[attr-defined]
        assert "__slots__" in vars(kind), kind
        assert kind.__doc__, kind


@given(planar_scans())
def test_hits_are_the_returns_in_order(scan: PlanarScan) -> None:
    hits = scan.hits(4.0)
    kept = [(r, b) for r, b in zip(scan.ranges, scan.bearings, strict=True) if r <= 4.0]
    expected = [(r * np.cos(b), r * np.sin(b)) for r, b in kept]
    np.testing.assert_allclose(hits, np.array(expected).reshape(-1, 2))
    assert len(scan.hits()) == np.isfinite(scan.ranges).sum()


any_angle = st.floats(-1e4, 1e4, allow_nan=False)


def assert_same(a: Pose2, b: Pose2, tolerance: float = 1e-9) -> None:
    assert math.hypot(a.x - b.x, a.y - b.y) < tolerance
    assert abs(wrap_angle(a.theta - b.theta)) < tolerance


@given(poses, poses)
def test_poses_are_their_matrices(a: Pose2, b: Pose2) -> None:
    """Hence they are a group: composition is associative, and IDENTITY its neutral element."""
    expected = np.eye(4)
    expected[:3, :3] = Rotation.from_euler("z", a.theta).as_matrix()
    expected[:2, 3] = a.x, a.y
    np.testing.assert_allclose(a.matrix(), expected, atol=1e-9)
    np.testing.assert_allclose((a @ b).matrix(), a.matrix() @ b.matrix(), atol=1e-9)
    assert_same(Pose2.from_matrix(a.matrix()), a)
    assert_same(a @ a.inverse(), IDENTITY)
    points = np.array([[0.0, 0.0], [1.0, -2.0], [30.0, 4.0]])
    np.testing.assert_allclose(a.apply(points), points @ expected[:2, :2].T + (a.x, a.y), atol=1e-9)


@given(pose_arrays(4), pose_arrays(4))
def test_arrays_of_poses_compose_and_invert_as_single_ones(a: FloatArray, b: FloatArray) -> None:
    composed, inverted = geometry.compose(a, b), geometry.invert(a)
    for row in range(4):
        one, other = Pose2(*a[row].tolist()), Pose2(*b[row].tolist())
        assert_same(Pose2(*composed[row].tolist()), one @ other)
        assert_same(Pose2(*inverted[row].tolist()), one.inverse())
    np.testing.assert_array_equal(geometry.compose(a[0], b)[2], geometry.compose(a[0], b[2]))


@given(pose_arrays(4), st.lists(st.integers(0, 5), min_size=4, max_size=4), seeds)
def test_clouds_are_placed_together_as_one_by_one(
    placed_at: FloatArray, sizes: list[int], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    clouds = [rng.uniform(-30.0, 30.0, (size, 2)) for size in sizes]
    placed = geometry.apply_each(placed_at, clouds)
    own = [Pose2(*at).apply(cloud) for at, cloud in zip(placed_at.tolist(), clouds, strict=True)]
    np.testing.assert_array_equal(placed, np.concatenate(own))
    assert geometry.apply_each(placed_at[:0], []).shape == (0, 2)


@given(any_angle)
def test_wrapped_angles_are_the_same_angles_in_range(angle: float) -> None:
    wrapped = wrap_angle(angle)
    assert -math.pi <= wrapped < math.pi
    assert math.cos(wrapped - angle) == pytest.approx(1.0)
    assert geometry.wrap_angles(np.array([angle]))[0] == wrapped
    assert wrap_angle(math.pi) == wrap_angle(-math.pi) == -math.pi


@given(st.lists(st.tuples(any_angle, any_angle, any_angle), min_size=1, max_size=5))
def test_quaternions_are_those_of_scipy(angles: list[tuple[float, ...]]) -> None:
    expected = Rotation.from_euler("xyz", np.array(angles))
    found = geometry.quaternions_from_rpy(*np.array(angles).T)
    assert (found[:, 3] >= 0.0).all()
    difference = (Rotation.from_quat(found) * expected.inv()).magnitude()
    np.testing.assert_allclose(difference, 0.0, atol=1e-6)
    for quaternion, rotation in zip(found, expected.as_matrix(), strict=True):
        for length in (1.0, -3.0):  # of any length and either sign
            back = geometry.rotation_from_quaternion(*(length * quaternion).tolist())
            np.testing.assert_allclose(back, rotation, atol=1e-9)
    for x, w in ((0.0, 0.0), (math.nan, 1.0), (math.inf, 1.0)):  # none, which is no rotation
        np.testing.assert_array_equal(geometry.rotation_from_quaternion(x, 0.0, 0.0, w), np.eye(3))


@pytest.mark.parametrize("shape", [(), (1,), (40,), (2, 5)])
def test_inverses_of_three_by_three_and_products(shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(3)
    a, b = rng.normal(size=(*shape, 3, 2)), rng.normal(size=(*shape, 2, 4))
    np.testing.assert_allclose(product(a, b), a @ b)
    factors = rng.normal(size=(*shape, 3, 3)) * (0.02, 0.02, 0.005)
    matrices = product(factors, np.swapaxes(factors, -1, -2)) + np.diag([1e-4, 1e-4, 1e-5])
    found = geometry.inverse3(matrices)
    assert found.shape == matrices.shape
    np.testing.assert_allclose(found, np.linalg.inv(matrices), rtol=1e-9, atol=1e-7)


@given(st.lists(poses, max_size=8))
def test_a_path_is_as_long_as_its_steps(track: list[Pose2]) -> None:
    array = np.array(track, dtype=np.float64).reshape(-1, 3)
    steps = [math.dist(a[:2], b[:2]) for a, b in itertools.pairwise(track)]
    assert geometry.step_lengths(array) == pytest.approx(steps)
    assert geometry.path_length(array) == pytest.approx(sum(steps))
    way = geometry.travelled(array)
    assert len(way) == len(track)
    assert way == pytest.approx([sum(steps[:k]) for k in range(len(track))])
    array[1::2] = math.nan  # an unknown place makes its steps unknown
    assert np.isnan(geometry.step_lengths(array)).all()


def test_a_robot_has_moved_by_distance_or_by_angle() -> None:
    here = Pose2(1.0, 2.0, 3.1)
    assert moved(None, here, 1.0, 1.0)
    assert not moved(here, here, 0.05, 0.05)
    assert moved(here, here @ Pose2(0.06, 0.0, 0.0), 0.05, 9.0)
    assert moved(here, here @ Pose2(0.0, 0.0, -0.06), 9.0, 0.05)  # over the border of the circle
    assert not moved(here, here @ Pose2(0.04, 0.0, 0.04), 0.05, 0.05)
