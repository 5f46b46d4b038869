"""What `info` says that `build` will meet, and of reading a recording to its end."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from specmap_cli.core.geometry import Pose2
from specmap_cli.core.settings import LogConfig
from specmap_cli.logs.inspection import summarize
from specmap_cli.logs.opening import open_log
from specmap_cli.logs.readers.encoding import LASER_SCAN, scan_cdr
from specmap_cli.logs.readers.recording import Message
from specmap_cli.logs.summary import TopicCheck
from specmap_cli.logs.writer import LogWriter
from tests.logs.recordings import SECOND, change_db3, write_db3
from tests.turning import configured, turn

START = 1_700_000_000 * SECOND
EVERY_200_MS = [0.2 * n for n in range(10)]


def write_scans(path: Path, stamps: list[int], times: list[int]) -> None:
    with LogWriter(path) as log:
        for stamp, time in zip(stamps, times, strict=True):
            data = scan_cdr("laser", stamp, -1.0, 0.5, [2.0] * 5, range_max=8.0)
            log.raw("/scan", LASER_SCAN, data, time)


def check_of(path: Path, **options: object) -> tuple[TopicCheck, ...]:
    with open_log(path) as log:
        turn("logs", **options)
        checked = summarize(log, complete=True).checked
    assert checked is not None
    return checked


GAPS_S = [0.0, 0.1, 0.2, 0.9, 1.0, 1.1, 1.59, 1.69, 3.5, 3.6]
LONGEST = "pauses, the longest 1.81 s from 1700000001.690 s on"


@pytest.mark.parametrize(
    ("stamps_s", "times_s", "intervals", "said"),
    [
        (GAPS_S, GAPS_S, 5.0, f"; 2 {LONGEST}"),
        (GAPS_S, GAPS_S, 4.5, f"; 3 {LONGEST}"),
        (
            *([0, 1, 2, 1, 2, 2, 3], [0, 1, 2, 3, 4, 5, 6], 5.0),
            "; stamps earlier than the stamp before: 1; stamps equal to the stamp before: 1",
        ),
        ([-START // SECOND] * 4, [0, 1, 2, 3], 5.0, ""),  # no stamp: the recorder's times
    ],
    ids=["pauses", "more pauses", "steps back", "no stamp"],
)
def test_pauses_and_stamps_out_of_order_are_counted(
    path: Path, stamps_s: list[float], times_s: list[float], intervals: float, said: str
) -> None:
    stamps, times = ([START + round(s * SECOND) for s in each] for each in (stamps_s, times_s))
    write_scans(path, stamps, times)
    (scans,) = check_of(path, pause_intervals=intervals)
    assert scans.text() == f"{len(times)} of {len(times)} messages read{said}"


def test_messages_that_cannot_be_decoded_are_unusable(path: Path) -> None:
    with LogWriter(path) as log:
        log.raw("/scan", LASER_SCAN, b"\x00\x01\x00\x00rubbish", START)
        log.scan("/scan", "laser", START + 1, -1.0, 0.5, [2.0] * 5, range_max=8.0)
        log.raw("/map", "nav_msgs/msg/OccupancyGrid", b"\x00\x01\x00\x00whatever", START + 2)
    grid, scans = check_of(path)
    assert (scans.read, scans.unusable) == (2, 1)
    assert scans.text() == "2 of 2 messages read; 1 unusable"
    assert (grid.read, grid.unusable) == (1, 0)


@pytest.mark.parametrize("time_ns", [(1 << 64) - 1, 1 << 63, 1])
def test_times_beyond_all_bounds_are_no_fault(path: Path, time_ns: int) -> None:
    with LogWriter(path) as log:
        for time in (0, time_ns):
            log.raw("/map", "nav_msgs/msg/OccupancyGrid", b"\x00\x01\x00\x00", time)
    (grid,) = check_of(path)
    assert (grid.read, grid.steps_back, grid.pauses.count) == (2, 0, 0)


def test_info_counts_what_is_lost_only_when_all_is_read(
    path: Path, drive_messages: list[Message]
) -> None:
    write_db3(path, drive_messages)
    last = "(SELECT MAX(id) FROM messages WHERE topic_id = 3)"
    change_db3(path, f"UPDATE messages SET data = 'no bytes' WHERE id = {last}")
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
    path: Path, drive_messages: list[Message]
) -> None:
    write_db3(path, drive_messages)
    change_db3(path, "UPDATE messages SET data = 'no bytes' WHERE topic_id = 1")
    found = {topic.name: (topic.read, topic.expected) for topic in check_of(path)}
    assert found == {"/odom": (60, 60), "/scan": (30, 30), "/tf_static": (0, 1)}


def write(path: Path, times_s: list[float], step_m: float = 0.1, hangs: range = range(0)) -> None:
    """Scans at these times, odometry with them; a robot that drives a step each time.

    Those numbered in `hangs` are the same.
    """
    with LogWriter(path) as log:
        for n, time_s in enumerate(times_s):
            stamp = START + round(time_s * SECOND)
            log.odometry("/odom", "odom", "laser", stamp, Pose2(n * step_m, 0.0, 0.0))
            seen = hangs[0] if n in hangs else n
            ranges = np.array([2.0 + 0.01 * seen, np.nan, np.inf, 3.0])
            if n % 5 == 4:
                ranges[:] = np.inf
            log.scan("/scan", "laser", stamp, -1.0, 0.5, ranges, range_max=8.0)


def lines_of(path: Path, complete: bool = False, **options: object) -> list[str]:
    with open_log(path) as log:
        lines = summarize(log, configured(LogConfig, "logs", options), complete=complete).lines()
    place = next(n for n, line in enumerate(lines) if line.startswith("build would meet"))
    end = next(n for n, line in enumerate(lines) if line.startswith("checked"))
    return lines[place:end]


MOVES = "from one to the next while the robot moves"
STALE = "  scans that repeat the one before while the robot moves: 3\n"


@pytest.mark.parametrize(
    ("step_m", "hangs", "options", "spacing", "stale"),
    [
        (0.1, range(0), {}, f", 0.10 m {MOVES}", ""),
        (0.1, range(5, 9), {}, f", 0.10 m {MOVES}", STALE),
        (0.0, range(5, 9), {}, "", ""),
        (0.0, range(5, 9), {"use_odometry": False}, "", ""),
        (0.4, range(0), {"sparse_step_m": 0.5}, f", 0.40 m {MOVES}", ""),
        (
            *(0.4, range(0), {"sparse_step_m": 0.25}),
            *(f", 0.40 m {MOVES}: sparse, so that much depends on the odometry", ""),
        ),
    ],
)
def test_spacing_and_what_is_blank_or_repeated_is_told(
    path: Path, step_m: float, hangs: range, options: dict[str, Any], spacing: str, stale: str
) -> None:
    write(path, EVERY_200_MS, step_m, hangs)
    assert "\n".join(lines_of(path, **options)) == (
        f"build would meet, in 10 scans:\n  5.0 scans a second{spacing}\n"
        f"  blank scans, without any return: 2\n{stale}  readings that are invalid: 20.0 %"
    )


def test_the_preview_in_json(path: Path) -> None:
    write(path, EVERY_200_MS)
    with open_log(path) as log:
        plain = summarize(log).to_dict()["preview"]
    assert plain["spacing"] == {"rate_hz": 5.0, "step_m": 0.1, "is_sparse": False}
    assert plain["sensors"] == (("laser", 10),)
    assert [faults["topic"] for faults in plain["stamps"]] == ["/scan", "/odom"]


def test_gaps_are_told_with_their_places(path: Path) -> None:
    write(path, [0.0, 0.1, 0.2, 1.7, 1.8, 2.5, 2.6, 6.6, 6.7, 8.7, 8.8, 9.9])
    places = (
        "the longest 4.00 s from 1700000002.600 s on, 2.00 s from 1700000006.700 s on, "
        "1.50 s from 1700000000.200 s on"
    )
    assert f"  4 gaps between scans: {places}" in lines_of(path)
    assert f"  5 gaps between scans: {places}" in lines_of(path, gap_s=0.6)
    assert "  2 gaps between scans" in "\n".join(lines_of(path, pause_intervals=18.0))
    write(path, [1.5 * n for n in range(9)])
    assert not any("gap" in line for line in lines_of(path)), "all are as far apart"


def test_only_the_first_scans_are_read_unless_all_are_asked_for(path: Path) -> None:
    write(path, [0.1 * n for n in range(30)])
    assert lines_of(path, look_scans=20)[0] == "build would meet, in the first 20 of 30 scans:"
    assert lines_of(path, complete=True, look_scans=20)[0] == "build would meet, in 30 scans:"


TODAY = START / SECOND


@pytest.mark.parametrize(
    ("stamps_s", "said"),
    [
        ([TODAY, TODAY + 1, TODAY + 2], ""),
        ([0.0, TODAY, 0.0], "zero: 2"),
        ([TODAY, TODAY, TODAY + 1], "equal to the stamp before: 1"),
        ([TODAY + 2, TODAY, TODAY + 1], "earlier than the stamp before: 1"),
        ([5.0, 6.0, 7.0], "before 1990 or in the future: 3, such as 5.000 s"),
        (
            [TODAY, 2_147_483_000.0, 2_147_483_001.0],
            "before 1990 or in the future: 2, such as 2147483000.000 s (2038-01-19)",
        ),
        (
            [9.0, 9.0, 0.0, 3.0],
            "zero: 1; equal to the stamp before: 1; before 1990 or in the future: 3, "
            "such as 9.000 s",
        ),
    ],
)
def test_faulty_stamps_are_counted(path: Path, stamps_s: list[float], said: str) -> None:
    times = [START + n * SECOND // 10 for n in range(len(stamps_s))]
    write_scans(path, [round(stamp_s * SECOND) for stamp_s in stamps_s], times)
    found = [line for line in lines_of(path) if "stamps on" in line]
    expected = f"  stamps on /scan, of {len(stamps_s)} messages: {said}"
    assert found == ([expected] if said else [])
