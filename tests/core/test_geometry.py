"""Rigid motions obey the laws of a group, and agree with SciPy's rotations."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from specmap_cli.core import geometry
from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2, moved, product, wrap_angle
from tests.strategies import pose_arrays, poses

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
    np.testing.assert_array_equal(IDENTITY.matrix(), np.eye(4))
    assert_same(Pose2.from_matrix(a.matrix()), a)
    assert_same(a @ a.inverse(), IDENTITY)
    assert_same(a.inverse() @ a, IDENTITY)
    points = np.array([[0.0, 0.0], [1.0, -2.0], [30.0, 4.0]])
    moved_points = points @ expected[:2, :2].T + (a.x, a.y)
    np.testing.assert_allclose(a.apply(points), moved_points, atol=1e-9)


@given(pose_arrays(4), pose_arrays(4))
def test_arrays_of_poses_compose_and_invert_as_single_ones(a: FloatArray, b: FloatArray) -> None:
    composed, inverted = geometry.compose(a, b), geometry.invert(a)
    for row in range(4):
        one, other = Pose2(*a[row].tolist()), Pose2(*b[row].tolist())
        assert_same(Pose2(*composed[row].tolist()), one @ other)
        assert_same(Pose2(*inverted[row].tolist()), one.inverse())
    np.testing.assert_array_equal(geometry.compose(a[0], b)[2], geometry.compose(a[0], b[2]))


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
