"""labels.csv and trajectory.tum: written as others read them, and read back whole."""

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.errors import MapError
from specmap_cli.core.records import NO_SUBMAP, Labels, Trajectory
from specmap_cli.maps.text_files import (
    labels_text,
    read_labels,
    read_trajectory,
    read_tum,
    trajectory_text,
)
from tests.strategies import few


def test_no_poses_are_a_header_or_nothing_and_no_submap_is_an_empty_cell() -> None:
    nowhere, stamps = np.zeros((0, 3)), np.zeros(0, dtype=np.int64)
    empty = labels_text(Labels(stamps_ns=stamps, poses=nowhere, submaps=stamps))
    assert empty == "stamp,x,y,theta,submap\n"
    assert trajectory_text(Trajectory(stamps, nowhere)) == ""
    submaps = np.array([NO_SUBMAP, 4])
    labels = Labels(stamps_ns=np.arange(2), poses=np.zeros((2, 3)), submaps=submaps)
    _, first, second = labels_text(labels).splitlines()
    assert first.endswith(",")
    assert second.endswith(",4")


FINITE = st.floats(-1e6, 1e6, allow_nan=False)
ROWS = st.tuples(
    st.integers(-(2**62), 2**62), FINITE, FINITE, st.floats(-3.2, 3.2), st.integers(-1, 2**40)
)


@few(30)
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


LINES = [
    *("1.5,0,0,0", "1.5,0,0,0,1,2", "1.5,nan,0,0,1", "1.5,0,-9999999999999999999,0,1"),
    *("1.5,0,inf,0,1", "1.5,0,0,-1e999,1", "1.5,0,0,0,-1", "1.5,0,0,0,1.0"),
    *("1.5,0,0,0,99999999999999999999", "99999999999999999999,0,0,0,1", "soon,0,0,0,1", ""),
]


@pytest.mark.parametrize("line", LINES)
def test_a_line_that_is_no_keyframe_is_quoted(tmp_path: Path, line: str) -> None:
    path = tmp_path / "labels.csv"
    path.write_text(f"stamp,x,y,theta,submap\n0.5,1,2,3,0\n{line}\n0.7,1,2,3,0\n")
    with pytest.raises(MapError) as caught:
        read_labels(path)
    assert str(caught.value) == f"{path}: line 3 is {line!r}: expected stamp,x,y,theta,submap"


HEADERS = ("", "stamp,x,y,theta\n", "stamp;x;y;theta;submap\n", "\ufeff")
HEADER_TOLD = "line 1 is not 'stamp,x,y,theta,submap': build the map"


@pytest.mark.parametrize(
    ("name", "data", "told"),
    [
        *(("labels.csv", text.encode(), HEADER_TOLD) for text in HEADERS),
        ("labels.csv", None, "cannot be read: No such file"),
        ("labels.csv", b"\xff\xfe", "not UTF-8 text"),
        ("trajectory.tum", b"1.0 0 0 0 0 0 1\n", "line 1 is"),
        ("trajectory.tum", b"1.0 0 0 0 0 0 0 1\n2.0 0 0 0 0 0 nan 1\n", "line 2 is"),
        ("trajectory.tum", b"x 0 0 0 0 0 0 1\n", "line 1 is"),
        ("trajectory.tum", b"\xff\xfe", "not UTF-8 text"),
        ("trajectory.tum", None, "cannot be read"),
    ],
)
def test_files_that_are_not_read(tmp_path: Path, name: str, data: bytes | None, told: str) -> None:
    if data is not None:
        (tmp_path / name).write_bytes(data)
    with pytest.raises(MapError, match=rf"{name}: {told}"):
        (read_labels if name == "labels.csv" else read_trajectory)(tmp_path / name)


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


@pytest.mark.parametrize("planar", [False, True])
def test_a_trajectory_comes_back_with_tilt_and_lost_scans(tmp_path: Path, planar: bool) -> None:
    rng = np.random.default_rng(0)
    way = Trajectory(
        np.arange(20) * 10**8 + 1_700_000_000_123_456_789,
        rng.uniform(-3, 3, (20, 3)),
        None if planar else rng.uniform(-0.4, 0.4, (20, 3)),
        lost=None if planar else np.arange(20) % 7 < 2,
    )
    file = tmp_path / "trajectory.tum"
    file.write_text(trajectory_text(way), encoding="utf-8")
    back = read_trajectory(file)
    assert back.stamps_ns.tolist() == way.stamps_ns.tolist()
    np.testing.assert_allclose(back.poses, way.poses, atol=1e-6)
    assert np.loadtxt(file).shape == (20, 8)
    first = file.read_text(encoding="utf-8").splitlines()[0 if planar else 1].split()
    assert first[0] == "1700000000.123456789"
    assert [len(number.split(".")[1]) for number in first] == [9, 6, 6, 6, 9, 9, 9, 9]
    columns = 3 if planar else 2  # of a tilted pose the heading is another
    np.testing.assert_allclose(read_tum(file).poses[:, :columns], way.poses[:, :columns], atol=1e-6)
    assert back.tilt == pytest.approx(way.tilt, abs=1e-6)
    assert back.lost == pytest.approx(way.lost)
