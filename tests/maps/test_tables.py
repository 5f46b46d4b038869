from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from specmap_cli.core.geometry import quaternions_from_rpy
from specmap_cli.core.records import NO_SUBMAP, Labels, Trajectory
from specmap_cli.core.text import (
    counted,
    decimal,
    nanoseconds,
    plain,
    seconds,
    stamp_ns,
    stamp_text,
    to_json,
)
from specmap_cli.maps.tables import labels_text, trajectory_text

STAMPS = st.integers(-(2**62), 2**62)


@settings(max_examples=60, derandomize=True)
@given(STAMPS)
def test_stamps_there_and_back(stamp: int) -> None:
    assert stamp_ns(stamp_text(stamp)) == stamp


def test_stamps_near_zero() -> None:
    assert stamp_text(-1) == "-0.000000001"
    assert stamp_ns("5") == 5_000_000_000
    assert stamp_ns("-0.5") == -500_000_000
    assert stamp_ns("0.1234567891") == 123_456_789


@settings(max_examples=60, derandomize=True)
@given(st.integers(0, 4_000_000_000_000_000_000))
def test_seconds_are_exact_to_the_microsecond(stamp: int) -> None:
    assert nanoseconds(seconds(stamp)) == stamp // 1000 * 1000
    assert float(repr(seconds(stamp))) == seconds(stamp)


@pytest.mark.parametrize("text", ["", "x", "1.x", "1e9"])
def test_what_is_no_stamp(text: str) -> None:
    if not text:
        assert stamp_ns(text) == 0
        return
    with pytest.raises(ValueError, match="invalid literal"):
        stamp_ns(text)


def test_no_negative_zero() -> None:
    assert decimal(-1e-9) == "0.000000"
    assert decimal(-0.25, 2) == "-0.25"
    assert to_json({"b": -1e-9, "a": np.float32(0.5)}) == '{\n "a": 0.5,\n "b": 0.0\n}\n'


def test_points_stay_on_one_line_and_words_are_left_alone() -> None:
    value = {"p": [[1.5, -2e-3], [3, 4]], "s": ["[\n1,\n2]", "[ 1, 2 ]"], "e": [], "m": [1, None]}
    text = to_json(value)
    assert json.loads(text) == {**value, "p": [[1.5, -0.002], [3, 4]]}
    assert "[1.5, -0.002]" in text
    assert "[3, 4]" in text


def test_counts() -> None:
    assert [counted(n, "scan") for n in (0, 1, 2000)] == ["0 scans", "1 scan", "2,000 scans"]


def test_plain_types() -> None:
    value = {"n": np.int64(3), "f": float("inf"), "t": (np.bool_(True), None), "a": np.ones(2)}
    assert plain(value) == {"n": 3, "f": None, "t": [True, None], "a": [1.0, 1.0]}


@settings(max_examples=40, derandomize=True)
@given(*(st.floats(-3.1, 3.1) for _ in range(3)))
def test_quaternions_against_scipy(roll: float, pitch: float, yaw: float) -> None:
    ours = quaternions_from_rpy(*(np.array([angle]) for angle in (roll, pitch, yaw)))[0]
    theirs = Rotation.from_euler("ZYX", [yaw, pitch, roll])
    assert ours[3] >= 0.0
    assert (Rotation.from_quat(ours).inv() * theirs).magnitude() == pytest.approx(0.0, abs=1e-7)


def test_tilt_of_a_3d_lidar_is_kept() -> None:
    trajectory = Trajectory(
        np.array([5, 6]), np.array([(1, 2, 0.5), (1, 2, 3.0)]), np.array([(0.3, 0.1, -0.2)] * 2)
    )
    rows = [[float(n) for n in line.split()] for line in trajectory_text(trajectory).splitlines()]
    assert rows[0][3] == 0.3
    turn = Rotation.from_quat(rows[1][4:])
    assert turn.as_euler("ZYX") == pytest.approx([3.0, -0.2, 0.1])


def test_a_keyframe_in_no_submap_has_an_empty_cell() -> None:
    labels = Labels(np.array([0, 1]), np.zeros((2, 3)), np.array([NO_SUBMAP, 4]))
    lines = labels_text(labels).splitlines()
    assert lines[1].endswith(",")
    assert lines[2].endswith(",4")
