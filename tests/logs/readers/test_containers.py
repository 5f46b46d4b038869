"""MCAP files, ROS 1 bags and rosbag2's databases in every variety: whole, cut off and damaged."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
from mcap.writer import CompressionType, IndexType
from rosbags.rosbag1 import Writer as Rosbag1Writer

from specmap_cli.logs.opening import open_log
from specmap_cli.logs.readers.recording import Message
from tests.logs.recordings import (
    COUNTS,
    cut_in_tenths,
    read_rest,
    spoil,
    write_bag,
    write_db3,
    write_mcap,
)

Write = Callable[[Path, list[Message]], None]

FORMATS = {"mcap": "MCAP", "bag": "ROS 1 bag", "db3": "rosbag2 (SQLite)"}
VARIETIES: dict[str, Write] = {
    "mcap zstd": partial(write_mcap, compression=CompressionType.ZSTD),
    "mcap lz4": partial(write_mcap, compression=CompressionType.LZ4),
    "mcap plain": partial(write_mcap, compression=CompressionType.NONE),
    "mcap without index": partial(write_mcap, index_types=IndexType.NONE),
    "mcap without summary": partial(
        write_mcap, index_types=IndexType.NONE, use_statistics=False, repeat_channels=False
    ),
    "mcap without chunks": partial(write_mcap, use_chunking=False),
    "mcap without checksums": partial(write_mcap, enable_crcs=False),
    "bag plain": write_bag,
    "bag without index": partial(write_bag, indexed=False),
    "bag of small chunks": partial(write_bag, chunk_bytes=1500),
    "bag bz2": partial(write_bag, compression=Rosbag1Writer.CompressionFormat.BZ2),
    "bag lz4": partial(write_bag, compression=Rosbag1Writer.CompressionFormat.LZ4),
    "db3 by time": write_db3,
    "db3 without index": partial(write_db3, time_index=False),
}
CHUNKED = [name for name in VARIETIES if not name.startswith("db3")]


@pytest.mark.parametrize("name", VARIETIES)
def test_every_variety_gives_the_same_messages(
    path: Path, drive_messages: list[Message], name: str
) -> None:
    """Also where the file's name says something else."""
    VARIETIES[name](path, drive_messages)
    odometry, scans = ([m for m in drive_messages if m.topic == t] for t in ("/odom", "/scan"))
    with open_log(path) as log:
        assert log.format == FORMATS[name.split()[0]]
        assert list(log.messages()) == drive_messages
        assert {t.name: t.count for t in log.topics()} == COUNTS
        assert log.contents.start_ns == drive_messages[0].time_ns
        assert log.contents.end_ns == max(m.time_ns for m in drive_messages)
        assert list(log.messages(["/odom"])) == odometry
        assert list(log.messages(["/scan"])) == scans
        assert all(a == b for a, b in zip(log.messages(), log.messages(), strict=True))
        at_once = zip(log.messages(["/scan"]), log.messages(["/odom"]), strict=False)
        assert list(at_once) == list(zip(scans, odometry, strict=False))
        assert log.damage == []


@pytest.mark.parametrize("name", CHUNKED)
def test_what_precedes_a_cut_is_read(path: Path, drive_messages: list[Message], name: str) -> None:
    VARIETIES[name](path, drive_messages)
    cut_in_tenths(path, drive_messages)


@pytest.mark.parametrize("name", CHUNKED)
def test_random_damage_is_survived(path: Path, drive_messages: list[Message], name: str) -> None:
    for seed in range(25):
        VARIETIES[name](path, drive_messages[:20])
        spoil(path, seed, 8 if name.startswith("mcap") else 13)
        found, said = read_rest(path)
        assert len(found) <= 20
        assert all(str(path) in line and "\n" not in line for line in said)
