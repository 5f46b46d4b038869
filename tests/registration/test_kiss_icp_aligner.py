"""KISS-ICP as a registration method: it aligns, forgets what is old, and repeats itself exactly."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.settings import RegistrationConfig
from specmap_cli.registration import Aligner, SensorKind
from specmap_cli.registration.aligner import KissIcpAligner
from tests.registration.drives import turned
from tests.strategies import few
from tests.turning import configured

KERNELS_M = (0.4, 0.2, 0.1, 0.05)


def aligner(in_space: bool = True, **settings: int) -> KissIcpAligner:
    sensor = SensorKind(in_space=in_space, voxel_m=0.2, range_m=20.0)
    return KissIcpAligner(configured(RegistrationConfig, "registration", settings), sensor)


def room(seed: int) -> FloatArray:
    """Points (N, 3) on floor and four walls of a room, the two long ones with a step in them."""
    rng = np.random.default_rng(seed)
    u, v = rng.uniform(0.0, 1.0, (2, 250))
    faces = [
        np.column_stack([6 * u, 4 * v, 0 * u]),
        np.column_stack([6 * u, 0.5 * (u > 0.4), 2 * v]),
        np.column_stack([6 * u, 4 - 0.7 * (u > 0.7), 2 * v]),
        np.column_stack([0 * u, 4 * v, 2 * u]),
        np.column_stack([6 + 0 * u, 4 * v, 2 * u]),
    ]
    return np.concatenate(faces) - (3.0, 2.0, 0.0)


def aligned(method: Aligner, points: FloatArray, guess: FloatArray) -> FloatArray:
    for kernel_m in KERNELS_M:
        guess = method.align(points, guess, kernel_m, coarse=False)
    return guess


@few(15)
@given(
    st.floats(-0.15, 0.15), st.floats(-0.15, 0.15), st.floats(-0.08, 0.08), st.floats(-0.03, 0.03)
)
def test_a_moved_cloud_comes_back_to_its_pose(x: float, y: float, yaw: float, roll: float) -> None:
    """Other points of the same room, so that no point finds itself."""
    method = aligner()
    keyframe = Pose2(5.0, -3.0, 0.7).matrix()
    method.insert(room(0), keyframe)
    guess = keyframe @ turned(x, yaw, roll) @ Pose2(0.0, y, 0.0).matrix()
    found = aligned(method, room(1), guess)
    assert np.linalg.norm((found - keyframe)[:3, 3]) < 0.02
    assert np.abs(found[:3, :3] - keyframe[:3, :3]).max() < 0.01


def test_a_coarse_alignment_may_stop_early_and_points_far_from_everything_do_not_move() -> None:
    method = aligner()
    method.insert(room(0), np.eye(4))
    guess = turned(0.2, 0.1, 0.0)
    coarse, fine = (method.align(room(1), guess, 0.2, coarse=flag) for flag in (True, False))
    assert not np.array_equal(coarse, fine)
    assert np.linalg.norm(coarse[:3, 3]) < 0.05
    far = Pose2(50.0, 0.0, 0.0).matrix()
    assert np.array_equal(method.align(room(1), far, 0.2, coarse=False), far)


def pulled_m(method: KissIcpAligner, place_m: float) -> float:
    """How far a room is pulled to what the map holds at a place."""
    at = Pose2(place_m, 0.0, 0.0).matrix()
    guess = at @ turned(0.1, 0.0, 0.0)
    found = method.align(room(1), guess, 0.2, coarse=False)
    return float(np.linalg.norm((found - guess)[:3, 3]))


def test_a_keyframe_that_left_the_window_leaves_the_map_at_the_next_rebuild() -> None:
    method = aligner()
    for number in range(81):  # rooms 20 m apart, of which the window holds eighty
        assert not number or pulled_m(method, 0.0) > 0.05
        method.insert(room(0), Pose2(20.0 * number, 0.0, 0.0).matrix())
    assert pulled_m(method, 0.0) == 0.0
    assert pulled_m(method, 20.0) > 0.05


def test_a_cleared_map_is_as_good_as_new() -> None:
    cleared, new = aligner(), aligner()
    for _ in range(3):
        cleared.insert(room(0), np.eye(4))
    cleared.clear()
    assert pulled_m(cleared, 0.0) == 0.0
    for number in range(3):
        for method in (cleared, new):
            method.insert(room(number), Pose2(20.0 + 0.03 * number, 0.0, 0.0).matrix())
        assert pulled_m(cleared, 0.0) == 0.0
        assert pulled_m(cleared, 20.0) == pulled_m(new, 20.0) > 0.05


@pytest.mark.parametrize(
    ("in_space", "name"), [(False, "points_per_voxel"), (True, "cloud_points_per_voxel")]
)
def test_a_full_voxel_keeps_the_newest_keyframe_s_points(in_space: bool, name: str) -> None:
    """Two keyframes of one room 8 cm apart, with one point a voxel: the newer decides."""
    ahead = []
    for rebuild_keyframes in (1, 4):  # not rebuilt: the older stays
        settings = {name: 1, "rebuild_keyframes": rebuild_keyframes}
        method = aligner(in_space=in_space, **settings)
        for place_m in (0.0, 0.08):
            method.insert(room(0), Pose2(place_m, 0.0, 0.0).matrix())
        ahead.append(aligned(method, room(1), np.eye(4))[0, 3])
    assert ahead[0] > 0.05 > ahead[1]


@pytest.mark.parametrize("coarse", [True, False])
def test_two_runs_are_identical_and_arguments_stay(coarse: bool) -> None:
    points, guess = room(1), turned(0.1, 0.05, 0.01)
    found = []
    for _ in range(2):
        method = aligner()
        method.insert(room(0), np.eye(4))
        found.append(method.align(points, guess, 0.2, coarse=coarse))
    assert np.array_equal(found[0], found[1])
    assert np.array_equal(points, room(1))
    assert np.array_equal(guess, turned(0.1, 0.05, 0.01))
