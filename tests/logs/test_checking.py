"""Reading a recording to its end, and what is told of it."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from pathlib import Path

import pytest

from specmap_cli.core.geometry import Pose2
from specmap_cli.core.settings import LogConfig
from specmap_cli.logs import open_log
from specmap_cli.logs.inspection import summarize
from specmap_cli.logs.readers.encoding import ODOMETRY, odometry_cdr, scan_cdr
from specmap_cli.logs.readers.recording import Message
from specmap_cli.logs.summary import Pauses, TopicCheck
from specmap_cli.logs.writer import LogWriter
from tests.turning import configured, turn

SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND
SCAN = "sensor_msgs/msg/LaserScan"


def write_scans(path: Path, stamps_s: list[float], beams: int = 5) -> None:
    with LogWriter(path) as log:
        for stamp in stamps_s:
            log.scan(
                "/scan",
                "laser",
                START + round(stamp * SECOND),
                -1.0,
                0.5,
                [2.0] * beams,
                range_max=8.0,
            )


def check_of(path: Path, **options: object) -> tuple[TopicCheck, ...]:
    with open_log(path) as log:
        turn("logs", **options)
        checked = summarize(log, complete=True).checked
    assert checked is not None
    return checked


def test_an_intact_log(drive: Path) -> None:
    odometry, scans, mounting = check_of(drive)
    assert (scans.name, scans.type, scans.read, scans.expected) == ("/scan", SCAN, 30, 30)
    assert (odometry.read, mounting.read) == (60, 1)
    assert scans.text() == "30 of 30 messages read"
    assert {t.steps_back + t.repeats + t.unusable for t in (odometry, scans, mounting)} == {0}


def test_pauses_are_counted_and_the_longest_is_placed(tmp_path: Path) -> None:
    stamps = [0.0, 0.1, 0.2, 0.9, 1.0, 1.1, 1.59, 1.69, 3.5, 3.6]
    write_scans(tmp_path / "log.mcap", stamps)
    (scans,) = check_of(tmp_path / "log.mcap")
    assert scans.pauses == Pauses(count=2, longest_s=1.81, longest_at_s=1_700_000_001.69)
    assert scans.text() == (
        "10 of 10 messages read; 2 pauses, the longest 1.81 s from 1700000001.690 s on"
    )
    (scans,) = check_of(tmp_path / "log.mcap", pause_intervals=4.5)
    assert scans.pauses.count == 3


def test_stamps_that_step_back_or_repeat(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    with LogWriter(path) as log:
        for number, stamp in enumerate([0, 1, 2, 1, 2, 2, 3]):
            time = START + number * SECOND
            data = odometry_cdr("odom", "base", START + stamp * SECOND, Pose2(0.0, 0.0, 0.0))
            log.raw("/odom", ODOMETRY, data, time)
    (odometry,) = check_of(path)
    assert (odometry.steps_back, odometry.repeats) == (1, 1)
    assert odometry.text() == (
        "7 of 7 messages read; stamps earlier than the stamp before: 1; "
        "stamps equal to the stamp before: 1"
    )


def test_messages_without_a_stamp_have_the_recorders_times(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    with LogWriter(path) as log:
        for number in range(4):
            data = scan_cdr("laser", 0, -1.0, 0.5, [2.0] * 5, range_max=8.0)
            log.raw("/scan", SCAN, data, START + number * SECOND)
    (scans,) = check_of(path)
    assert (scans.steps_back, scans.repeats, scans.pauses.count) == (0, 0, 0)


def test_messages_that_cannot_be_decoded_are_unusable(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    with LogWriter(path) as log:
        log.raw("/scan", SCAN, b"\x00\x01\x00\x00rubbish", START)
        log.scan("/scan", "laser", START + 1, -1.0, 0.5, [2.0] * 5, range_max=8.0)
        log.raw("/map", "nav_msgs/msg/OccupancyGrid", b"\x00\x01\x00\x00whatever", START + 2)
    grid, scans = check_of(path)
    assert (scans.read, scans.unusable) == (2, 1)
    assert scans.text() == "2 of 2 messages read; 1 unusable"
    assert (grid.read, grid.unusable) == (1, 0)


@pytest.mark.parametrize("time_ns", [(1 << 64) - 1, 1 << 63, 1])
def test_times_beyond_all_bounds_are_no_fault(tmp_path: Path, time_ns: int) -> None:
    path = tmp_path / "log.mcap"
    with LogWriter(path) as log:
        for time in (0, time_ns):
            log.raw("/map", "nav_msgs/msg/OccupancyGrid", b"\x00\x01\x00\x00", time)
    (grid,) = check_of(path)
    assert (grid.read, grid.steps_back, grid.pauses.count) == (2, 0, 0)


def test_info_counts_what_is_lost_only_when_all_is_read(
    tmp_path: Path, drive_messages: list[Message], write_db3: Callable[..., None]
) -> None:
    path = tmp_path / "log.db3"
    write_db3(path, drive_messages)
    with sqlite3.connect(path) as db:
        last = "(SELECT MAX(id) FROM messages WHERE topic_id = 3)"
        db.execute(f"UPDATE messages SET data = 'no bytes' WHERE id = {last}")
    db.close()
    with open_log(path) as log:
        quick = summarize(log, configured(LogConfig, "logs", {"look_scans": 3}))
        assert quick.checked is None
        assert quick.damage == ()
        said = "checked: only the beginning; --check reads all messages and compares the counts"
        assert said in quick.lines()
        whole = summarize(log, complete=True)
    assert whole.checked is not None
    assert [(t.read, t.expected) for t in whole.checked] == [(60, 60), (29, 30), (1, 1)]
    assert len(whole.damage) == 1
    lines = whole.lines()
    place = lines.index("checked: all messages")
    assert lines[place + 1 : place + 4] == [
        "  /odom       60 of 60 messages read",
        "  /scan       29 of 30 messages read",
        "  /tf_static  1 of 1 message read",
    ]
    assert whole.to_dict()["checked"][1]["read"] == 29


def test_a_topic_of_which_nothing_is_left_is_listed(
    tmp_path: Path, drive_messages: list[Message], write_db3: Callable[..., None]
) -> None:
    path = tmp_path / "log.db3"
    write_db3(path, drive_messages)
    with sqlite3.connect(path) as db:
        db.execute("UPDATE messages SET data = 'no bytes' WHERE topic_id = 1")
    db.close()
    found = {topic.name: (topic.read, topic.expected) for topic in check_of(path)}
    assert found == {"/odom": (60, 60), "/scan": (30, 30), "/tf_static": (0, 1)}
