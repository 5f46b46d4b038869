"""What is no recording gets one clear line."""

from __future__ import annotations

from pathlib import Path

import pytest

from specmap_cli.core.errors import LogError
from specmap_cli.logs.opening import open_log


def test_missing_paths_are_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"no\.mcap: no such file or directory"):
        open_log(tmp_path / "no.mcap")
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
    ],
)
def test_other_files_are_refused(tmp_path: Path, content: bytes, said: str) -> None:
    path = tmp_path / "log.mcap"
    path.write_bytes(content)
    with pytest.raises(LogError) as caught:
        open_log(path)
    assert said in str(caught.value)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_a_directory_is_searched_for_recordings(tmp_path: Path, drive: Path) -> None:
    folder = tmp_path / "recording"
    folder.mkdir()
    (folder / "metadata.yaml").write_text("version: 9\n")
    with pytest.raises(LogError, match="no recording in this directory"):
        open_log(folder)
    (folder / "notes").write_bytes(drive.read_bytes())
    with open_log(folder) as log:
        assert log.paths == [folder / "notes"]
        assert log.given == [folder]


def test_an_unreadable_file_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "log.mcap"
    path.write_bytes(b"x")

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", refuse)
    with pytest.raises(LogError, match=r"log\.mcap: cannot read: Permission denied"):
        open_log(path)
