from __future__ import annotations

import os
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from specmap_cli.core.errors import UsageError
from specmap_cli.core.files import is_nobody_s, lock, read_bytes, write_text, write_together
from specmap_cli.grids.map_server import write_png


def test_a_file_is_replaced_whole(tmp_path: Path) -> None:
    path = tmp_path / "labels.csv"
    path.write_text("a longer text than the new one")
    write_text(path, "für\n")
    assert path.read_bytes() == "für\n".encode()
    assert os.listdir(tmp_path) == ["labels.csv"]


@pytest.mark.parametrize("place", ["gone/plot.png", "file/plot.png", "."])
def test_a_place_that_cannot_be_written_is_one_line(tmp_path: Path, place: str) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(UsageError) as caught:
        write_png(tmp_path / place, np.zeros((2, 2), dtype=np.uint8))
    assert "\n" not in str(caught.value)
    assert sorted(os.listdir(tmp_path)) == ["file"]


def test_a_failing_replacement_leaves_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "run.json"
    path.write_text("old")

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(UsageError, match="No space left"):
        write_text(path, "new")
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["run.json"]


def test_two_files_appear_together_or_not_at_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The disk is full when the second one is written."""
    calls: list[int] = []

    def full(descriptor: int) -> None:
        calls.append(descriptor)
        if len(calls) == 2:
            raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(UsageError, match=r"b\.md: cannot be written: No space left"):
        write_together({tmp_path / "a.xml": b"a", tmp_path / "b.md": b"b"})
    assert os.listdir(tmp_path) == []


def test_a_file_is_read_up_to_its_bound_and_not_beyond(tmp_path: Path) -> None:
    """And no more memory is taken than it needs."""
    path = tmp_path / "labels.csv"
    path.write_bytes(b"12345")
    assert read_bytes(path, 5e-6) == b"12345"
    with pytest.raises(OSError, match=r"larger than 4e-06 MB"):
        read_bytes(path, 4e-6)
    with pytest.raises(OSError, match=r"larger than 4e-06 MB; if it is meant, raise limits\.x"):
        read_bytes(path, 4e-6, "limits.x")
    tracemalloc.start()
    assert read_bytes(path, 1000.0) == b"12345"
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 1_000_000


def test_what_may_never_end_or_has_no_name_is_not_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/zero"), tmp_path):
        with pytest.raises(OSError, match=r"not a regular file|Is a directory"):
            read_bytes(path, 100)
    with pytest.raises(OSError, match="no name that a file can have"):
        read_bytes(tmp_path / "map\0.png", 1.0)


def test_what_a_killed_run_had_begun_is_removed_and_nothing_else(tmp_path: Path) -> None:
    kept = ["labels.csv.partial-12", ".labels.csv.partial-x1", ".other.csv.partial-12"]
    for name in [*kept, ".labels.csv.partial-12", ".labels.csv.partial-13"]:
        (tmp_path / name).write_text("half")
    with (tmp_path / ".labels.csv.partial-13").open() as living:
        assert lock(living.fileno())
        write_text(tmp_path / "labels.csv", "whole")
        kept.append(".labels.csv.partial-13")
        assert sorted(os.listdir(tmp_path)) == sorted(["labels.csv", *kept])
    assert is_nobody_s(tmp_path / ".labels.csv.partial-13")
    assert not is_nobody_s(tmp_path / "missing")
