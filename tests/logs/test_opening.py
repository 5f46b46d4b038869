"""Opening files and directories; what is no recording gets one clear line."""

from __future__ import annotations

import gzip
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.errors import LogError
from specmap_cli.logs.opening import open_log
from specmap_cli.logs.readers.mcap import McapFile
from specmap_cli.logs.readers.recording import Message, is_text
from tests.logs.recordings import PACK, read_rest, refusal

ZIPPED = partial(gzip.compress, mtime=0)


def test_missing_paths_are_refused(tmp_path: Path) -> None:
    for name in ("no.mcap", "no\0.mcap"):
        assert "mcap: no such file or directory" in refusal(tmp_path / name)
    with pytest.raises(LogError, match="no log given"):
        open_log([])


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "the file is empty"),
        (b"hello\nworld\n" * 900, "a text file, not a recording; expected MCAP, rosbag2"),
        ("grüße".encode() * 2000, "a text file, not a recording"),
        (b"\xff\x00\x01\x02" * 50, "of an unknown format, not a recording"),
        (b"\x89MCA", "cut off after 4 bytes; no message can be read"),
        (b"\x89MCAP0\r\n", "no message can be read"),
        (b"#ROSBAG V2.0\n", "no message can be read"),
        (b"SQLite format 3\x00" + bytes(100), "no readable rosbag2 file"),
        (b"\x1f\x8b" + bytes(40), "the file is empty (inside gzip compression)"),
        (ZIPPED(ZIPPED(b"MCAP")), "compressed twice; unpack it first"),
        (
            ZIPPED(b"#ROSBAG V1.2\n"),
            "bag format 1.2 is not supported; bring it to 2.0 with `rosbag fix` ",
        ),
        (ZIPPED(b"hello"), "a text file, not a recording; expected MCAP, rosbag2 (SQLite)"),
    ],
)
def test_other_files_are_refused(path: Path, content: bytes, said: str) -> None:
    path.write_bytes(content)
    line = refusal(path)
    assert said in line
    assert line.startswith(f"{path}: ")
    assert "\n" not in line
    assert "specmap-" not in line, "under its own name also where it was compressed"


def test_a_directory_is_searched_for_recordings(tmp_path: Path, drive: Path) -> None:
    """Hidden files and folders in it are passed over."""
    folder = tmp_path / "recording"
    (folder / "inner.mcap").mkdir(parents=True)
    (folder / ".part.mcap").write_bytes(drive.read_bytes())
    (folder / "metadata.yaml").write_text("version: 9\n")
    known = "MCAP, rosbag2 (SQLite), ROS 1 bag or CARMEN log"
    assert refusal(folder) == f"{folder}: no recording in this directory; expected {known}"
    (folder / "notes").write_bytes(drive.read_bytes())
    with open_log(folder) as log:
        assert log.paths == [folder / "notes"]
        assert log.given == (folder,)


@pytest.mark.parametrize(
    ("paths", "config", "said"),
    [
        (None, None, "paths: expected a path.*, found .*None"),
        (7, None, "paths: expected a path.*, found .*7"),
        ([Path("a"), None], None, "paths: expected a path.*, found .*None"),
        (b"log", None, "paths: expected a path.*, found "),
        ("log", {"chunk_max_mb": 5}, "config: expected LogConfig, found"),
    ],
)
def test_what_is_no_path_and_no_settings_is_refused_at_once(
    paths: Any, config: Any, said: str
) -> None:
    with pytest.raises(TypeError, match=f"^{said}"):
        open_log(paths, config)


def test_paths_may_be_strings(drive: Path, drive_messages: list[Message]) -> None:
    for paths in (str(drive), [str(drive)], (drive,)):
        with open_log(paths) as log:
            assert list(log.messages()) == drive_messages
            assert log.given == (drive,)


def test_a_file_counts_once_however_it_is_named(tmp_path: Path, drive: Path) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    (folder / "link.mcap").symlink_to(drive)
    for paths in ([drive] * 2, [folder, drive], [drive, folder / ".." / drive.name]):
        with pytest.raises(LogError, match="given twice; name each file of a recording once"):
            open_log(paths)


@pytest.mark.parametrize("name", ["gzip", "lz4"])
def test_a_compressed_log_is_read_in_all_its_blocks_and_what_follows_them_is_told(
    drive: Path, drive_messages: list[Message], name: str
) -> None:
    whole = drive.read_bytes()
    drive.write_bytes(PACK[name](whole[:3000]) + PACK[name](whole[3000:]))
    assert read_rest(drive) == (drive_messages, [])
    drive.write_bytes(drive.read_bytes() + b"garbage")
    said = f"{drive}: what follows the {name} compression is no part of it and was left out"
    assert read_rest(drive) == (drive_messages, [said])


def test_no_room_to_unpack_is_told(drive: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drive.write_bytes(gzip.compress(drive.read_bytes()))
    missing = drive.parent / "missing"
    monkeypatch.setattr(tempfile, "tempdir", str(missing))
    assert refusal(drive) == (
        f"{drive}: cannot unpack into the temporary directory: No such file or directory; "
        "set TMPDIR to another one"
    )


def test_a_failure_releases_what_was_opened_before_it(
    tmp_path: Path, drive: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    closed = []
    monkeypatch.setattr(McapFile, "close", lambda self: closed.append(self.path))
    with pytest.raises(LogError, match="no such file"):
        open_log([drive, tmp_path / "missing"])
    assert closed == [drive]


def test_a_damaged_file_beside_a_sound_one_is_no_error(
    tmp_path: Path, drive: Path, drive_messages: list[Message]
) -> None:
    rubble = tmp_path / "rubble.mcap"
    rubble.write_bytes(drive.read_bytes()[:40])
    lost = f"{rubble}: cut off at byte 40: everything is lost"
    assert read_rest([rubble, drive]) == (drive_messages, [lost])
    assert f"{lost}; no message can be" in refusal(rubble)


@given(st.text("aß€😀", min_size=1), st.integers(1, 40))
def test_text_is_text_wherever_its_head_ends(text: str, length: int) -> None:
    assert is_text(text.encode()[:length])


def test_other_bytes_are_no_text() -> None:
    for head in (b"\xff\xfe plain", b"plain \x80 and plain", b"\xc3 (cut) again"):
        assert not is_text(head)


@pytest.mark.parametrize("step", ["open", "iterdir", "stat"])
def test_what_the_system_refuses_is_one_line(
    drive: Path, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    path = drive.parent if step == "iterdir" else drive
    monkeypatch.setattr(Path, step, refuse)
    assert refusal(path) == f"{path}: cannot read: Permission denied"
