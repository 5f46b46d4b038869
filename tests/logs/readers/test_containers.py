"""MCAP files, ROS 1 bags and rosbag2's databases in every variety: whole, cut off and damaged."""

from __future__ import annotations

from pathlib import Path

import pytest

from specmap_cli.logs.opening import open_log
from specmap_cli.logs.readers.recording import Message
from tests.logs.recordings import COUNTS, VARIETIES, cut_in_tenths, read_rest, spoil

FORMATS = {"mcap": "MCAP", "bag": "ROS 1 bag", "db3": "rosbag2 (SQLite)"}
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
