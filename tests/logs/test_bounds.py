"""Files that swell, wait or lead nowhere: one line, little memory, a small temporary file."""

from __future__ import annotations

import bz2
import os
import re
import socket
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import zstandard

from specmap_cli.core.settings import LogConfig
from specmap_cli.logs.opening import open_log
from specmap_cli.logs.readers import compression
from specmap_cli.logs.readers.recording import Message
from tests.logs.recordings import PACK, refusal, write_db3

MEMORY_MB = 600
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


def zeros_in_zstd(count: int) -> bytes:
    packer = zstandard.ZstdCompressor().compressobj()
    piece = bytes(1 << 20)
    return b"".join(packer.compress(piece) for _ in range(count >> 20)) + packer.flush()


def mcap_with_chunk(compression: bytes, data: bytes, size: int) -> bytes:
    body = struct.pack("<QQQII", 5, 9, size, 0, len(compression)) + compression
    body += struct.pack("<Q", len(data)) + data
    record = struct.pack("<BQ", 6, len(body)) + body
    end = struct.pack("<BQI", 0x0F, 4, 0)
    return b"\x89MCAP0\r\n" + record + end + b"\x89MCAP0\r\n"


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


GIGABYTE = 1 << 30


def zeros_in_bz2(count: int) -> bytes:
    packer = bz2.BZ2Compressor()
    return b"".join(packer.compress(bytes(1 << 20)) for _ in range(count >> 20)) + packer.flush()


BEYOND = "is beyond log.chunk_max_mb"
OF_MCAP = f"chunk at byte 8 {BEYOND}: messages between 0.000 s and 0.000 s are lost; no message can"


@pytest.mark.parametrize(
    ("content", "said", "most_mb"),
    [
        (lambda: mcap_with_chunk(b"zstd", zeros_in_zstd(GIGABYTE), GIGABYTE), OF_MCAP, MEMORY_MB),
        (lambda: mcap_with_chunk(b"zstd", zeros_in_zstd(GIGABYTE), 1000), OF_MCAP, MEMORY_MB),
        (
            lambda: bag_with_chunk(b"bz2", zeros_in_bz2(200 << 20), 1 << 20),
            f"chunk at byte 90 {BEYOND}: some of its messages are lost",
            MEMORY_MB,
        ),
        (
            lambda: zstandard.compress(CARMEN) + zeros_in_zstd(GIGABYTE),
            "unpacks to more than 500 times its size, as no log does; if it is a log, unpack it",
            300,
        ),
    ],
    ids=["MCAP", "MCAP of a wrong size", "bag", "whole file"],
)
def test_what_swells_costs_little_memory(
    path: Path, content: Callable[[], bytes], said: str, most_mb: int
) -> None:
    path.write_bytes(content())
    told, megabytes = read_in_a_process(path)
    assert told.startswith(f"{path}: {said}")
    assert megabytes < most_mb


@pytest.mark.parametrize("name", sorted(PACK))
def test_what_is_no_log_is_not_unpacked(
    path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compression, "LOOKED_AT_BYTES", 5000)
    path.write_bytes(PACK[name](bytes(80_000_000)) + b"garbage that would be told otherwise")
    written: list[int] = []
    monkeypatch.setattr(compression, "_refuse_swelling", lambda n, *_: written.append(n))
    assert re.search(f"of an unknown format.*inside {name} compression", refusal(path))
    assert max(written) < 80_000_000


@pytest.mark.parametrize("name", sorted(PACK))
def test_the_copy_of_a_compressed_file_is_bounded(path: Path, name: str) -> None:
    path.write_bytes(PACK[name](CARMEN + CARMEN[8:] * 50_000))
    with open_log(path) as log:
        assert log.contents.messages == 50_001
    assert refusal(path, LogConfig(unpacked_max_gb=0.001)) == (
        f"{path}: unpacks to more than 0.001 GB, which log.unpacked_max_gb allows; "
        "if it is a log, raise the setting"
    )


def test_a_chunk_and_a_message_have_their_bound(
    tmp_path: Path, drive: Path, drive_messages: list[Message]
) -> None:
    small = LogConfig(chunk_max_mb=0.0003)  # a scan has 240 bytes, an odometry message 700
    assert re.search(r"beyond log\.chunk_max_mb|no message can be read", refusal(drive, small))
    path = tmp_path / "log.db3"
    write_db3(path, [m._replace(data=zstandard.compress(m.data)) for m in drive_messages])
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
