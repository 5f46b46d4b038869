from __future__ import annotations

import json
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from specmap_cli.core.errors import MapError
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
from specmap_cli.evaluation.trajectories import read_tum
from specmap_cli.maps.tables import (
    labels_text,
    planar_trajectory_text,
    read_labels,
    trajectory_text,
)

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
    labels = Labels(
        stamps_ns=np.array([0, 1]), poses=np.zeros((2, 3)), submaps=np.array([NO_SUBMAP, 4])
    )
    lines = labels_text(labels).splitlines()
    assert lines[1].endswith(",")
    assert lines[2].endswith(",4")


FINITE = st.floats(-1e6, 1e6, allow_nan=False)
ROWS = st.tuples(
    st.integers(-(2**62), 2**62), FINITE, FINITE, st.floats(-3.2, 3.2), st.integers(-1, 2**40)
)


@settings(max_examples=60)
@given(st.lists(ROWS, max_size=20))
def test_keyframes_there_and_back(rows: list[tuple[int, float, float, float, int]]) -> None:
    columns = list(zip(*rows, strict=True)) or [()] * 5
    labels = Labels(
        stamps_ns=np.array(columns[0], dtype=np.int64),
        poses=np.array(columns[1:4], dtype=np.float64).T.reshape(-1, 3),
        submaps=np.array(columns[4], dtype=np.int64),
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "labels.csv"
        path.write_text(labels_text(labels))
        read = read_labels(str(path))
    np.testing.assert_array_equal(read.stamps_ns, labels.stamps_ns)
    np.testing.assert_array_equal(read.submaps, labels.submaps)
    np.testing.assert_allclose(read.poses, labels.poses, atol=5.1e-7)
    assert read.poses.shape == (len(rows), 3)


@pytest.mark.parametrize(
    "line",
    [
        "1.5,0,0,0",
        "1.5,0,0,0,1,2",
        "1.5,nan,0,0,1",
        "1.5,0,inf,0,1",
        "1.5,0,0,-1e999,1",
        "1.5,0,0,0,-1",
        "1.5,0,0,0,1.0",
        "1.5,0,0,0,99999999999999999999",
        "99999999999999999999,0,0,0,1",
        "soon,0,0,0,1",
        "",
    ],
)
def test_a_line_that_is_no_keyframe_is_quoted(tmp_path: Path, line: str) -> None:
    path = tmp_path / "labels.csv"
    path.write_text(f"stamp,x,y,theta,submap\n0.5,1,2,3,0\n{line}\n0.7,1,2,3,0\n")
    with pytest.raises(MapError) as caught:
        read_labels(path)
    expected = f"{path}: line 3 is {line!r}: expected stamp,x,y,theta,submap"
    assert str(caught.value) == expected


@pytest.mark.parametrize("text", ["", "stamp,x,y,theta\n", "stamp;x;y;theta;submap\n", "\ufeff"])
def test_another_header_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "labels.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(MapError, match="line 1 is not 'stamp,x,y,theta,submap': build the map"):
        read_labels(path)


@pytest.mark.parametrize(
    ("content", "complaint"),
    [(None, "cannot read the keyframes: No such file"), (b"\xff\xfe", "not a text file")],
)
def test_tables_that_cannot_be_read(tmp_path: Path, content: bytes | None, complaint: str) -> None:
    if content is not None:
        (tmp_path / "labels.csv").write_bytes(content)
    with pytest.raises(MapError, match=rf"labels\.csv: {complaint}"):
        read_labels(tmp_path / "labels.csv")


@settings(max_examples=60)
@given(st.lists(st.tuples(st.integers(0, 2**40), FINITE, FINITE, st.floats(-3.2, 3.2)), max_size=9))
def test_true_poses_are_written_to_the_nanometre(
    rows: list[tuple[int, float, float, float]],
) -> None:
    stamps = np.array([1000 * row[0] for row in rows], dtype=np.int64)
    poses = np.array([row[1:] for row in rows], dtype=np.float64).reshape(-1, 3)
    lines = planar_trajectory_text(Trajectory(stamps, poses)).splitlines()
    assert len(lines) == len(rows)
    for line, stamp, (x, y, theta) in zip(lines, stamps.tolist(), poses.tolist(), strict=True):
        words = line.split(" ")
        assert words[3:6] == ["0", "0", "0"]
        assert [len(word.partition(".")[2]) for word in words] == [6, 9, 9, 0, 0, 0, 9, 9]
        assert stamp_ns(words[0]) == stamp
        assert [float(words[1]), float(words[2])] == pytest.approx([x, y], abs=1e-9)
        turn = Rotation.from_quat([float(word) for word in words[4:]])
        assert (turn.inv() * Rotation.from_euler("z", theta)).magnitude() < 1e-8
        assert "-0.000000000" not in words


def test_no_poses_are_an_empty_file() -> None:
    nowhere = np.zeros((0, 3))
    stamps = np.zeros(0, dtype=np.int64)
    assert trajectory_text(Trajectory(stamps, nowhere)) == ""
    assert planar_trajectory_text(Trajectory(stamps, nowhere)) == ""
    assert (
        labels_text(Labels(stamps_ns=stamps, poses=nowhere, submaps=stamps))
        == "stamp,x,y,theta,submap\n"
    )


def test_lost_scans_are_marked_between_the_lines_of_a_trajectory() -> None:
    lost = np.array([True, True, False, True, False])
    way = Trajectory(np.arange(5) * 10**9, np.zeros((5, 3)), lost=lost)
    lines = trajectory_text(way).splitlines()
    assert [line for line in lines if line.startswith("#")] == [
        "# lost: the poses of the next 2 scans are guesses",
        "# found",
        "# lost: the poses of the next 1 scan are guesses",
        "# found",
    ]
    assert [k for k, line in enumerate(lines) if line.startswith("#")] == [0, 3, 5, 7]
    plain_lines = [line for line in lines if not line.startswith("#")]
    assert plain_lines == trajectory_text(Trajectory(way.stamps_ns, way.poses)).splitlines()


def test_a_marked_trajectory_reads_back(tmp_path: Path) -> None:
    way = Trajectory(
        np.arange(4) * 10**9, np.arange(12.0).reshape(4, 3) / 10, lost=np.arange(4) == 2
    )
    file = tmp_path / "trajectory.tum"
    file.write_text(trajectory_text(way), encoding="utf-8")
    np.testing.assert_allclose(read_tum(file).poses, way.poses, atol=1e-6)
    assert len(np.loadtxt(file)) == 4
