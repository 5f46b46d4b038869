"""Opening files and directories, packed ones too: a clear line for what is none, little memory."""

import bz2
import gzip
import os
import re
import socket
import struct
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.errors import LogError
from specmap_cli.core.settings import Config, LogConfig
from specmap_cli.logs.inspection import summarize
from specmap_cli.logs.opening import Log, open_log
from specmap_cli.logs.readers import compression
from specmap_cli.logs.readers.compression import compression_of, decompress, stream
from specmap_cli.logs.readers.mcap import McapFile
from specmap_cli.logs.readers.recording import Message, is_text
from specmap_cli.logs.stream import SweepStream
from specmap_cli.logs.writer import LogWriter, convert
from tests.logs.recordings import PACK, read_rest, refusal, write_db3

NO_LOG = Log([], [Path("spy")])
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
        (b"\xff\xfe plain", "of an unknown format"),
        (b"plain \x80 and plain", "of an unknown format"),
        (b"\xc3 (cut) again", "of an unknown format"),
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
    ("called", "given_", "said"),
    [
        (open_log, (None,), "paths: expected a path.*, found .*None"),
        (open_log, (7,), "paths: expected a path.*, found .*7"),
        (open_log, ([Path("a"), None],), "paths: expected a path.*, found .*None"),
        (open_log, (b"log",), "paths: expected a path.*, found "),
        (open_log, ("log", {"chunk_max_mb": 5}), "config: expected LogConfig, found"),
        (SweepStream, ("log.mcap", LogConfig()), "log: expected .*Log, found 'log.mcap'$"),
        (SweepStream, (NO_LOG, Config()), "config: expected .*LogConfig, found Config"),
        (summarize, ("log.mcap",), "log: expected .*Log, found"),
        (summarize, (NO_LOG, {"use_odometry": False}), "config: .*LogConfig, found"),
        (convert, (None, "out.mcap"), "paths: expected a path.*, found None"),
        (convert, ("log.bag", 3), "out: expected a path.*, found 3"),
        (convert, ("log.bag", ["out.mcap"]), r"out: expected a path.*, found \['out.mcap'\]"),
        *((LogWriter, (wrong,), "path: expected a path") for wrong in (None, 7, b"log.mcap")),
    ],
)
def test_wrong_types_are_refused_at_once(
    called: Callable[..., object], given_: tuple[object, ...], said: str
) -> None:
    with pytest.raises(TypeError, match=f"^{said}"):
        called(*given_)


def test_a_file_counts_once_however_it_is_named(tmp_path: Path, drive: Path) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    (folder / "link.mcap").symlink_to(drive)
    for paths in ([drive] * 2, [folder, drive], [drive, folder / ".." / drive.name]):
        with pytest.raises(LogError, match="given twice; name each file of a recording once"):
            open_log(paths)


@pytest.mark.parametrize("name", ["gzip", "lz4"])
def test_a_compressed_log_is_read_in_all_its_blocks_and_what_follows_them_is_told(
    drive: Path, driven: list[Message], name: str
) -> None:
    whole = drive.read_bytes()
    drive.write_bytes(PACK[name](whole[:3000]) + PACK[name](whole[3000:]))
    assert read_rest(drive) == (driven, [])
    drive.write_bytes(drive.read_bytes() + b"garbage")
    said = f"{drive}: what follows the {name} compression is no part of it and was left out"
    assert read_rest(drive) == (driven, [said])
    drive.write_bytes(PACK[name](CARMEN)[:-5])
    said = f"{drive}: the {name} compression is damaged or ends early: the rest is lost"
    assert said in read_rest(drive)[1]


def test_no_room_to_unpack_is_told(drive: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drive.write_bytes(gzip.compress(drive.read_bytes()))
    monkeypatch.setattr(tempfile, "tempdir", str(drive.parent / "missing"))
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


def test_one_damaged_file_is_no_error(tmp_path: Path, drive: Path, driven: list[Message]) -> None:
    rubble = tmp_path / "rubble.mcap"
    rubble.write_bytes(drive.read_bytes()[:40])
    lost = f"{rubble}: cut off at byte 40: everything is lost"
    assert read_rest([rubble, drive]) == (driven, [lost])
    assert f"{lost}; no message can be" in refusal(rubble)


@given(st.text("aß€😀", min_size=1), st.integers(1, 40))
def test_text_is_text_wherever_its_head_ends(text: str, length: int) -> None:
    assert is_text(text.encode()[:length])


@pytest.mark.parametrize("step", ["open", "iterdir", "stat"])
def test_refusals_are_one_line(drive: Path, monkeypatch: pytest.MonkeyPatch, step: str) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    path = drive.parent if step == "iterdir" else drive
    monkeypatch.setattr(Path, step, refuse)
    assert refusal(path) == f"{path}: cannot read: Permission denied"


MEMORY_MB = 600
GIGABYTE = 1 << 30
CARMEN = b"# a log\nODOM 1.0 2.0 0.1 0 0 0 5.0 host 5.0\n"

READ = """
import resource, sys
from pathlib import Path
resource.setrlimit(resource.RLIMIT_AS, (2_000_000_000,) * 2)
from specmap_cli.core.errors import SpecmapError
from specmap_cli.logs import open_log
try:
    with open_log(sys.argv[1]) as log:
        print(sum(1 for _ in log.messages()), *log.damage)
except SpecmapError as error:
    print(error)
# Not ru_maxrss: there the peak of the process that started this one counts as well.
peak = Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0]
print(int(peak) // 1024)
"""


def read_in_a_process(path: Path) -> tuple[str, int]:
    """What reading a file says, and its peak memory in MB."""
    command = [sys.executable, "-c", READ, str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    said, megabytes = done.stdout.splitlines()
    return said, int(megabytes)


def zeros(packer: Any, count: int = GIGABYTE) -> bytes:
    """Many zeros packed, a megabyte after another."""
    piece = bytes(1 << 20)
    return b"".join([*(packer.compress(piece) for _ in range(count >> 20)), packer.flush()])


def mcap_with_chunk(compression: bytes, data: bytes, size: int) -> bytes:
    body = struct.pack("<QQQII", 5, 9, size, 0, len(compression)) + compression
    body += struct.pack("<Q", len(data)) + data
    record = struct.pack("<BQ", 6, len(body)) + body
    return b"\x89MCAP0\r\n" + record + struct.pack("<BQI", 0x0F, 4, 0) + b"\x89MCAP0\r\n"


def bag_with_chunk(compression: bytes, data: bytes, size: int) -> bytes:
    def record(data: bytes, **fields: bytes) -> bytes:
        header = b"".join(
            struct.pack("<I", len(name) + 1 + len(value)) + name.encode() + b"=" + value
            for name, value in fields.items()
        )
        return struct.pack("<I", len(header)) + header + struct.pack("<I", len(data)) + data

    counts = {"index_pos": bytes(8), "conn_count": bytes(4), "chunk_count": bytes(4)}
    head = record(b"", op=b"\x03", **counts)
    chunk = record(data, op=b"\x05", compression=compression, size=struct.pack("<I", size))
    return b"#ROSBAG V2.0\n" + head + chunk


ZSTD, BZ2 = zstandard.ZstdCompressor().compressobj, bz2.BZ2Compressor
BEYOND = "is beyond log.chunk_max_mb"
OF_MCAP = f"chunk at byte 8 {BEYOND}: messages between 0.000 s and 0.000 s are lost; no message can"
OF_BAG = f"chunk at byte 90 {BEYOND}: some of its messages are lost"
OF_FILE = "unpacks to more than 500 times its size, as no log does; if it is a log, unpack it"


@pytest.mark.parametrize(
    ("content", "said", "most_mb"),
    [
        (lambda: mcap_with_chunk(b"zstd", zeros(ZSTD()), GIGABYTE), OF_MCAP, MEMORY_MB),
        (lambda: mcap_with_chunk(b"zstd", zeros(ZSTD()), 1000), OF_MCAP, MEMORY_MB),
        (lambda: bag_with_chunk(b"bz2", zeros(BZ2(), 150 << 20), 1 << 20), OF_BAG, MEMORY_MB),
        (lambda: zstandard.compress(CARMEN) + zeros(ZSTD()), OF_FILE, 300),
    ],
    ids=["MCAP", "MCAP of a wrong size", "bag", "whole file"],
)
def test_swelling_is_cheap(
    path: Path, content: Callable[[], bytes], said: str, most_mb: int
) -> None:
    path.write_bytes(content())
    told, megabytes = read_in_a_process(path)
    assert told.startswith(f"{path}: {said}")
    assert megabytes < most_mb


@pytest.mark.parametrize("name", sorted(PACK))
def test_no_other_file_is_unpacked(path: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compression, "LOOKED_AT_BYTES", 5000)
    path.write_bytes(PACK[name](bytes(80_000_000)) + b"garbage that would be told otherwise")
    written: list[int] = []
    monkeypatch.setattr(compression, "_refuse_swelling", lambda n, *_: written.append(n))
    assert re.search(f"of an unknown format.*inside {name} compression", refusal(path))
    assert max(written) < 80_000_000


@pytest.mark.parametrize("name", sorted(PACK))
def test_the_copy_of_a_compressed_file_is_bounded(path: Path, name: str) -> None:
    path.write_bytes(PACK[name](CARMEN + CARMEN[8:] * 5_000))
    with open_log(path) as log:
        assert log.contents.messages == 5_001
    assert refusal(path, LogConfig(unpacked_max_gb=0.0001)) == (
        f"{path}: unpacks to more than 0.0001 GB, which log.unpacked_max_gb allows; "
        "if it is a log, raise the setting"
    )


def test_chunk_and_message_have_bounds(tmp_path: Path, drive: Path, driven: list[Message]) -> None:
    small = LogConfig(chunk_max_mb=0.0003)  # a scan has 240 bytes, an odometry message 700
    assert re.search(r"beyond log\.chunk_max_mb|no message can be read", refusal(drive, small))
    path = tmp_path / "log.db3"
    write_db3(path, [m._replace(data=zstandard.compress(m.data)) for m in driven])
    with open_log(path, small) as log:
        assert {m.topic for m in log.messages()} == {"/scan", "/tf_static"}
        assert "is beyond log.chunk_max_mb: one on /odom is lost" in log.damage[0]
        assert log.missing == {"/odom": 60}
        assert len(log.damage) == 21
        assert log.damage[-1] == (
            f"{path}: damaged at 40 more places; in all, 60 messages on /odom are lost"
        )


def test_what_would_wait_for_ever_or_leads_nowhere_is_refused_and_passed_over_in_a_directory(
    tmp_path: Path, drive: Path
) -> None:
    pipe, loop = tmp_path / "pipe", tmp_path / "loop"
    os.mkfifo(pipe)
    loop.symlink_to(loop)
    said = f"{pipe}: is a pipe; a log must be a file or a directory: copy it to one"
    assert refusal(pipe) == said
    assert "is a device; a log must be" in refusal("/dev/zero")
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(tmp_path / "s"))
        assert "is a socket; a log must be" in refusal(tmp_path / "s")
    for path in (loop, loop / "log.mcap"):
        assert refusal(path) == f"{path}: cannot read: Too many levels of symbolic links"
    with open_log(tmp_path) as log:
        assert log.paths == [drive]


TEXT = b"".join(b"scan %d of a log\n" % number for number in range(9000))

LIMIT = 1 << 24

every = pytest.mark.parametrize("name", sorted(PACK))


@every
@pytest.mark.parametrize("size", [None, 0, 5, len(TEXT), len(TEXT) + 1, 1 << 40])
def test_all_blocks_are_read_whatever_is_said_of_the_size(name: str, size: int | None) -> None:
    """Zeros may pad them; anything else behind them is damage."""
    pack = PACK[name]
    text, more = pack(TEXT), pack(b"more")
    assert compression_of(text) == name
    for packed, found in (
        (text, TEXT),
        (pack(b""), b""),
        (text + more + pack(b"and more"), TEXT + b"moreand more"),
        (text + bytes(512), TEXT),
        (text + bytes(9) + more + bytes(3), TEXT + b"more"),
    ):
        assert decompress(packed, name, LIMIT, size) == (found, True, False)
    for rest in (b"x", b"\n", b"notes of someone", bytes(70_000) + b"x"):
        assert decompress(text + rest, name, LIMIT, size) == (TEXT, False, False)
    assert not decompress(text[:-3], name, LIMIT, size).complete


@every
@pytest.mark.parametrize("slice_bytes", [1, 3, 1000])
def test_blocks_may_come_in_slices(name: str, slice_bytes: int) -> None:
    packed = PACK[name](TEXT) + PACK[name](b"more")
    slices = [packed[i : i + slice_bytes] for i in range(0, len(packed), slice_bytes)]
    parts = list(stream(slices, name))
    assert b"".join(part for part, _ in parts) == TEXT + b"more"
    assert parts[-1][1]


@every
def test_a_cut_yields_what_precedes_it(name: str) -> None:
    packed = PACK[name](TEXT)
    for tenth in range(10):
        found, complete, _ = decompress(packed[: len(packed) * tenth // 10], name, LIMIT)
        assert not complete
        assert TEXT.startswith(found)
    found, complete, _ = decompress(PACK[name](TEXT) + PACK[name](TEXT)[:-8], name, LIMIT)
    assert not complete
    assert (TEXT + TEXT).startswith(found)
    assert len(found) >= len(TEXT)


@every
@given(place=st.floats(0, 1, exclude_max=True), byte=st.integers(0, 255))
def test_damage_never_raises(name: str, place: float, byte: int) -> None:
    packed = bytearray(PACK[name](TEXT))
    packed[int(place * len(packed))] = byte
    found, complete, _ = decompress(bytes(packed), name, LIMIT)
    assert isinstance(found, bytes)
    assert isinstance(complete, bool)


def test_plain_data_is_as_it_is_and_an_unknown_compression_yields_nothing() -> None:
    for name in ("", "none"):
        assert decompress(b"plain", name, LIMIT) == (b"plain", True, False)
        assert decompress(b"plain", name, 4) == (b"", False, True)
    assert decompress(b"plain", "snappy", LIMIT) == (b"", False, False)
    assert compression_of(b"plain") is None
    assert compression_of(b"") is None


@every
def test_a_block_beyond_the_limit_yields_nothing(name: str) -> None:
    packed = PACK[name](TEXT)
    for size in (None, len(TEXT), 5):
        assert decompress(packed, name, len(TEXT) - 1, size) == (b"", False, True)
        assert decompress(packed, name, len(TEXT), size) == (TEXT, True, False)


@every
def test_no_piece_of_a_bomb_is_large(name: str) -> None:
    packed = PACK[name](bytes(40_000_000))
    assert len(packed) < 200_000
    sizes = [len(part) for part, _ in stream([packed], name)]
    assert sum(sizes) == 40_000_000
    assert max(sizes) <= 32 << 20
