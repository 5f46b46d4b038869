"""labels.csv: the keyframes of a map as text and back."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.errors import MapError
from specmap_cli.core.records import NO_SUBMAP, Labels
from specmap_cli.maps.text_files import labels_text, read_labels
from tests.strategies import few


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


@pytest.mark.parametrize(
    "line",
    [
        "1.5,0,0,0",
        "1.5,0,0,0,1,2",
        "1.5,nan,0,0,1",
        "1.5,0,-9999999999999999999,0,1",
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


def test_no_poses_are_an_empty_file() -> None:
    nowhere = np.zeros((0, 3))
    stamps = np.zeros(0, dtype=np.int64)
    assert (
        labels_text(Labels(stamps_ns=stamps, poses=nowhere, submaps=stamps))
        == "stamp,x,y,theta,submap\n"
    )
