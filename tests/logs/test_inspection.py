"""The look at a log as `build` would, what it will meet, and how `info` tells it."""

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from specmap_cli.core.geometry import Pose2
from specmap_cli.core.settings import LogConfig
from specmap_cli.logs.inspection import summarize
from specmap_cli.logs.opening import open_log
from specmap_cli.logs.readers.encoding import LASER_SCAN, TF_MESSAGE, scan_cdr
from specmap_cli.logs.readers.recording import Message
from specmap_cli.logs.stream import SweepStream
from specmap_cli.logs.summary import LogSummary, TopicCheck
from specmap_cli.logs.writer import LogWriter
from tests.logs.recordings import SECOND, change_db3, sweeps_of, write_db3
from tests.turning import configured

START = 1_700_000_000 * SECOND
EVERY_200_MS = [0.2 * n for n in range(10)]


def summary_of(path: Path | list[Path], complete: bool = False, **options: object) -> LogSummary:
    with open_log(path) as log:
        return summarize(log, configured(LogConfig, "logs", options), complete=complete)


def write_scans(
    path: Path,
    stamps: Sequence[int] = (START, START + SECOND // 2, START + SECOND),
    times: Sequence[int] | None = None,
    beams: int = 5,
    **more: Any,
) -> None:
    """Scans with these header stamps, recorded at these times or at their stamps."""
    with LogWriter(path) as log:
        for stamp, time in zip(stamps, times or stamps, strict=True):
            options = {"range_max": 8.0, **more}
            data = scan_cdr("laser", stamp, -1.0, 0.5, np.full(beams, 2.0), **options)
            log.raw("/scan", LASER_SCAN, data, time)


def test_a_drive_is_summed_up_and_its_json_is_on_one_level(drive: Path) -> None:
    plain = summary_of(drive).to_dict()
    said = {"checked", "chosen", "damage", "next_command", "preview", "problem", "warnings"}
    held = {"files", "format", "frames", "messages", "scan", "size_bytes", "topics"}
    assert set(plain) == {*said, *held, "start_s", "end_s", "duration_s"}
    scan = json.loads(json.dumps(plain))["scan"]
    assert (scan["range_max_m"], scan["beams"]) == (8.0, 40)
    assert scan["field_of_view_deg"] == pytest.approx(171.89, abs=0.01)
    assert plain["files"] == (str(drive),)
    assert (plain["size_bytes"], plain["messages"]) == (drive.stat().st_size, 91)
    assert (plain["start_s"], plain["end_s"]) == (100.0, 102.95)
    assert plain["duration_s"] == pytest.approx(2.95)
    rates = {topic["name"]: topic["rate_hz"] for topic in plain["topics"]}
    assert rates["/odom"] == pytest.approx(59 / 2.95)
    assert rates["/tf_static"] == 0.0
    assert (plain["next_command"], plain["problem"]) == (f"specmap build {drive}", None)


@pytest.mark.parametrize("topic", ["/tf", "/tf_static"])  # fixed transforms need no time
def test_a_message_without_a_time_does_not_hide_when_a_log_began(path: Path, topic: str) -> None:
    with LogWriter(path) as log:
        log.raw(topic, TF_MESSAGE, b"", 0)
        for number in range(11):
            stamp = START + number * SECOND // 10
            log.scan("/scan", "laser", stamp, -1.0, 0.5, [2.0] * 5, range_max=8.0)
    found = summary_of(path)
    assert (found.start_s, found.duration_s) == (START / SECOND, 1.0)
    assert [topic.rate_hz for topic in found.topics if topic.name == "/scan"] == [10.0]
    said = "recorded at 0.000 s: /tf; the times of the log are those of the other topics"
    assert (said in found.warnings) is (topic == "/tf")


def test_real_times_are_dates_and_those_that_have_not_come_yet_are_said(path: Path) -> None:
    write_scans(path)
    line = summary_of(path).lines()[1]
    assert line == "3 messages in 1.0 s, 2023-11-14 22:13:20 UTC to 2023-11-14 22:13:21 UTC"
    write_scans(path, [START, 4_294_967_295 * SECOND])
    line = summary_of(path).lines()[1]
    assert line.endswith(" s, 2023-11-14 22:13:20 UTC to 2106-02-07 06:28:15 UTC (in the future)")


def test_odometry_of_another_time_is_said(path: Path) -> None:
    """The recorder's times are as far apart as the stamps: nothing tells where it belongs."""
    with LogWriter(path) as log:
        for number in range(5):
            log.odometry("/odom", "odom", "laser", number * SECOND, Pose2(0.0, 0.0, 0.0))
            ranges, stamp = np.full(5, 2.0), START + number * SECOND
            log.scan("/scan", "laser", stamp, -1.0, 0.5, ranges, range_max=8.0)
    said = "warning: scans without odometry near their stamp: 5 of 5"
    assert said in summary_of(path).lines()
    assert said not in summary_of(path, use_odometry=False).lines()


def test_a_scan_with_times_and_without_a_maximum_and_a_single_beam(path: Path) -> None:
    write_scans(path, range_max=0.0, time_increment=0.01)
    summary = summary_of(path)
    assert summary.scan is not None
    assert summary.scan.range_max_m == math.inf
    assert summary.to_dict()["scan"]["range_max_m"] is None
    said = "scan: 5 beams over 114.59 degrees in frame laser, of any range, with times"
    assert said in summary.lines()
    write_scans(path, [START], beams=1)
    summary = summary_of(path)
    assert summary.scan is not None
    assert (summary.scan.beams, summary.scan.field_of_view_deg) == (1, 0.0)
    assert summary.topics[0].rate_hz == 0.0
    assert summary.lines()[3] == "  /scan         1  sensor_msgs/msg/LaserScan"


@pytest.mark.parametrize(("degrees", "full"), [(360.0, True), (200.0, False)])
@pytest.mark.parametrize(("spread_m", "told"), [(0.3, "4,000 points"), (0.0, "3600 beams")])
def test_a_cloud_is_told_with_its_points_or_as_a_planar_scan_and_its_view(
    tmp_path: Path, degrees: float, full: bool, spread_m: float, told: str
) -> None:
    angles = np.radians(np.linspace(-degrees / 2, degrees / 2, 4000, endpoint=False))
    points = np.column_stack([3 * np.cos(angles), 3 * np.sin(angles), np.full(4000, 0.5)])
    points[::2, 2] += spread_m
    with LogWriter(tmp_path / "log.mcap") as log:
        log.static_transform("base_link", "lidar", (0.0, 0.0, 0.4), stamp_ns=START)
        log.cloud("/points", "lidar", START, points)
    summary = summary_of(tmp_path / "log.mcap")
    assert summary.scan is not None
    assert summary.scan.full_circle is full
    assert summary.scan.points == (4000 if spread_m else None)
    assert summary.scan.field_of_view_deg == pytest.approx(degrees, abs=0.6)
    assert any(line.startswith(f"scan: {told} over") for line in summary.lines())


def test_frames_are_those_above_the_scan(path: Path) -> None:
    turn = Rotation.from_euler("ZYX", [90.0, -20.0, 180.0], degrees=True).as_quat()
    with LogWriter(path) as log:
        log.static_transform("base_link", "laser", (0.1, -0.2, 0.3), tuple(turn), START)
        log.static_transform("base_link", "camera", (0.0, 0.0, 1.0), stamp_ns=START)
        log.transform("odom", "base_link", START, Pose2(1.0, 2.0, 0.5))
        log.scan("/scan", "laser", START, -1.0, 0.5, np.full(5, 2.0), range_max=8.0)
    summary = summary_of(path)
    lines = summary.lines()
    place = lines.index("frames:")
    assert lines[place + 1 : place + 4] == [
        "  odom -> base_link  on /tf, first at (1, 2, 0) m, roll 0, pitch 0, yaw 28.6479 degrees",
        "  base_link -> laser  at (0.1, -0.2, 0.3) m, roll 180, pitch -20, yaw 90 degrees",
        "  and 1 other frame",
    ]
    assert [frame.child for frame in summary.frames] == ["base_link", "camera", "laser"]


def test_a_log_of_unreadable_scans_or_none_has_no_next_command(path: Path) -> None:
    write_scans(path, beams=0)
    summary = summary_of(path)
    assert summary.problem == "no usable scan on /scan"
    assert summary.next_command is None
    assert summary.chosen is not None
    assert summary.scan is None
    with LogWriter(path) as log:
        log.odometry("/odom", "odom", "base", 1, Pose2(0.0, 0.0, 0.0))
    summary = summary_of(path)
    assert summary.next_command is None
    assert summary.problem is not None
    assert "problem: " in "\n".join(summary.lines())


def test_a_named_frame_that_is_not_there_is_a_problem_with_a_command(drive: Path) -> None:
    summary = summary_of(drive, base_frame="body", scan_topic="/scan")
    assert summary.problem is not None
    assert "--base-frame body: no transform joins it" in summary.problem
    assert summary.next_command == f"specmap build {drive} --scan-topic /scan"
    assert [frame.child for frame in summary.frames] == ["laser"]


def test_names_that_a_terminal_would_obey_are_shown_escaped(path: Path) -> None:
    with LogWriter(path) as log:
        log.static_transform("base_link", "las\x1b[31mER", stamp_ns=1)
        log.odometry("/odom\n/evil\u202e", "odom", "base_link", 1, Pose2(0.0, 0.0, 0.0))
        log.scan("/scan\x07", "las\x1b[31mER", 1, -1.0, 0.5, [2.0] * 5, range_max=8.0)
        log.scan("/scan\x9b", "las\x1b[31mER", 2, -1.0, 0.5, [2.0] * 5, range_max=8.0)
    with open_log(path) as log:
        both = summarize(log)
        chosen = summarize(log, LogConfig(scan_topic="/scan\x07"))
        stream = SweepStream(log, LogConfig(scan_topic="/scan\x07", base_frame="base_link"))
    lines = both.lines() + chosen.lines() + stream.warnings + [stream.selection.note]
    assert all(line.isprintable() for line in lines)
    assert any("/odom\\n/evil\\u202e" in line for line in chosen.lines())
    assert any("frame las\\x1b[31mER" in line for line in chosen.lines())
    assert both.problem is not None
    assert "`--scan-topic /scan\\x07`" in both.problem
    assert {t.name for t in both.topics} >= {"/scan\x07", "/odom\n/evil\u202e"}


def test_an_ambiguous_log_gets_a_command_that_runs(tmp_path: Path) -> None:
    path = tmp_path / "two scans.mcap"
    with LogWriter(path) as log:
        for i in range(3):
            log.scan("/rear", "rear", i, -1.0, 1.0, [1.0, 1.0], range_max=8.0)
            log.cloud("/points", "lidar", i, np.ones((4, 3)))
        log.scan("/front", "front", 1, -1.0, 1.0, [1.0, 1.0], range_max=8.0)
        log.odometry("/odom", "odom", "base", 1, Pose2(0.0, 0.0, 0.0))
        for i in range(2):
            log.odometry("/visual", "odom", "base", i, Pose2(0.0, 0.0, 0.0))
    found = summary_of(path)
    assert found.problem is not None
    assert "3 topics carry scans" in found.problem
    assert found.next_command == f"specmap build '{path}' --scan-topic /rear --odom-topic /visual"
    assert len(sweeps_of(path, scan_topic="/rear", odom_topic="/visual")[0]) == 3


def test_every_line_has_its_place(drive: Path) -> None:
    found = summary_of(drive)
    rates = zip(found.topics, (0.04, 0.05, 9.8), strict=True)
    topics = tuple(replace(topic, rate_hz=hz) for topic, hz in rates)
    said: dict[str, Any] = {"chosen": "all", "problem": "none", "next_command": "go"}
    said |= {"warnings": ("w1", "w2"), "damage": ("d",), "preview": None}
    summary = replace(found, topics=topics, **said)
    size = f"{drive.stat().st_size / 1e6:.1f} MB"
    assert summary.lines() == [
        f"{drive}: MCAP, {size}",
        "91 messages in 3.0 s, 100.000 s to 102.950 s",
        "topics:",
        "  /odom             60  nav_msgs/msg/Odometry",
        "  /scan             30  sensor_msgs/msg/LaserScan  0.1 Hz",
        "  /tf_static         1  tf2_msgs/msg/TFMessage  9.8 Hz",
        "frames:",
        "  base_link -> laser  at (0.2, 0, 0.3) m, roll 0, pitch 0, yaw 0 degrees",
        "scan: 40 beams over 171.89 degrees in frame laser, up to 8 m, all at one time",
        "build would read: all",
        "checked: only the beginning; --check reads all messages and compares the counts",
        "warning: w1",
        "warning: w2",
        "damage: d",
        "problem: none",
        "next: go",
    ]


def check_of(path: Path, **options: object) -> tuple[TopicCheck, ...]:
    checked = summary_of(path, complete=True, **options).checked
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
        log.cloud("/points", "lidar", START, np.zeros((40, 3)))
    grid, clouds, scans = check_of(path, scan_topic="/scan")
    assert (clouds.read, clouds.unusable) == (1, 1)
    assert (scans.read, scans.unusable) == (2, 1)
    assert scans.text() == "2 of 2 messages read; 1 unusable"
    assert (grid.read, grid.unusable) == (1, 0)


def test_only_a_check_counts_losses_even_of_whole_topics(path: Path, driven: list[Message]) -> None:
    write_db3(path, driven)
    last = "(SELECT MAX(id) FROM messages WHERE topic_id = 3)"
    change_db3(path, f"UPDATE messages SET data = 'no bytes' WHERE id = {last}")
    quick = summary_of(path, look_scans=3)
    assert quick.checked is None
    assert quick.damage == ()
    said = "checked: only the beginning; --check reads all messages and compares the counts"
    assert said in quick.lines()
    change_db3(path, "UPDATE messages SET data = 'no bytes' WHERE topic_id = 1")
    whole = summary_of(path, complete=True)
    assert whole.checked is not None
    assert [(t.read, t.expected) for t in whole.checked] == [(60, 60), (29, 30), (0, 1)]
    assert len(whole.damage) == 2
    lines = whole.lines()
    place = lines.index("checked: all messages")
    assert lines[place + 1 : place + 4] == [
        "  /odom       60 of 60 messages read",
        "  /scan       29 of 30 messages read",
        "  /tf_static  0 of 1 message read",
    ]
    assert whole.to_dict()["checked"][1]["read"] == 29


def write(path: Path, times_s: list[float], step_m: float = 0.1, hangs: range = range(0)) -> None:
    """Scans, and odometry with them, at these times; those numbered in `hangs` repeat."""
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
    lines = summary_of(path, complete, **options).lines()
    place = next(n for n, line in enumerate(lines) if line.startswith("build would meet"))
    return lines[place : next(n for n, line in enumerate(lines) if line.startswith("checked"))]


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
    assert found == ([f"  stamps on /scan, of {len(stamps_s)} messages: {said}"] if said else [])
