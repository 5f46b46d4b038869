"""What `info` says and what `convert` writes."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from specmap_cli.core.config import LogConfig
from specmap_cli.core.errors import LogError, UsageError
from specmap_cli.core.geometry import Pose2
from specmap_cli.logs.convert import convert
from specmap_cli.logs.opening import open_log
from specmap_cli.logs.readers.recording import Message
from specmap_cli.logs.stream import SweepStream
from specmap_cli.logs.summary import LogSummary, summarize
from specmap_cli.logs.writer import LogWriter


def summary_of(path: Path) -> LogSummary:
    with open_log(path) as log:
        return summarize(log)


def test_a_drive_is_summed_up(drive: Path) -> None:
    summary = summary_of(drive)
    assert summary.messages == 91
    assert summary.duration_s == pytest.approx(2.95)
    rates = {t.name: t.rate_hz for t in summary.topics}
    assert rates["/odom"] == pytest.approx(59 / 2.95)
    assert rates["/tf_static"] == 0.0
    (frame,) = summary.frames
    assert (frame.parent, frame.child, frame.xyz_m) == ("base_link", "laser", (0.2, 0.0, 0.3))
    assert summary.scan is not None
    assert summary.scan.beams == 40
    assert summary.scan.field_of_view_deg == pytest.approx(171.89, abs=0.01)
    assert summary.scan.range_max_m == 8.0
    assert summary.next_command == f"specmap build {drive}"
    assert summary.problem is None
    assert json.loads(json.dumps(summary.to_dict()))["topics"][0]["name"] == "/odom"
    text = "\n".join(summary.lines())
    assert "91 messages in 3.0 s, 100.000 s to 102.950 s" in text
    assert "/scan             30  sensor_msgs/msg/LaserScan  9.8 Hz" in text
    assert "base_link -> laser  at (0.2, 0, 0.3) m, roll 0, pitch 0, yaw 0 degrees" in text
    assert text.endswith(f"next: specmap build {drive}")


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
    summary = summary_of(path)
    assert summary.problem is not None
    assert "3 topics carry scans" in summary.problem
    assert summary.next_command == (
        f"specmap build '{path}' --scan-topic /rear --odom-topic /visual"
    )
    with open_log(path) as log_:
        options = LogConfig(scan_topic="/rear", odom_topic="/visual")
        assert len(list(SweepStream(log_, options))) == 3


def test_a_log_without_scans_has_no_next_command(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    with LogWriter(path) as log:
        log.odometry("/odom", "odom", "base", 1, Pose2(0.0, 0.0, 0.0))
    summary = summary_of(path)
    assert summary.next_command is None
    assert summary.problem is not None
    assert "problem: " in "\n".join(summary.lines())


def test_damage_is_told(drive: Path) -> None:
    drive.write_bytes(drive.read_bytes()[:-700])
    summary = summary_of(drive)
    assert len(summary.damage) == 1
    assert any(line.startswith("damage: ") for line in summary.lines())


def test_a_bag_is_converted_and_reads_the_same(
    tmp_path: Path, drive_messages: list[Message], write_bag: Callable[..., None]
) -> None:
    write_bag(tmp_path / "log.bag", drive_messages)
    result = convert(tmp_path / "log.bag", tmp_path / "out.mcap")
    assert {t.name: t.count for t in result.written} == {"/odom": 60, "/scan": 30, "/tf_static": 1}
    assert result.skipped == []
    with open_log(tmp_path / "out.mcap") as log:
        assert list(log.messages()) == drive_messages
    with pytest.raises(UsageError, match="exists already; use --overwrite"):
        convert(tmp_path / "log.bag", tmp_path / "out.mcap")
    first = (tmp_path / "out.mcap").read_bytes()
    convert(tmp_path / "log.bag", tmp_path / "out.mcap", overwrite=True)
    assert (tmp_path / "out.mcap").read_bytes() == first


def test_a_carmen_log_is_converted_and_gives_the_same_sweeps(tmp_path: Path) -> None:
    lines = [
        f"FLASER 3 1.0 2.0 80.0 {x + 0.1} 0.0 0.0 {x} 0.0 0.0 {x}.5 nohost {x}.5\n"
        for x in range(1, 9)
    ]
    path = tmp_path / "log.clf"
    path.write_text("".join(lines))
    convert(path, tmp_path / "out.mcap")
    with open_log(path) as before, open_log(tmp_path / "out.mcap") as after:
        pairs = zip(SweepStream(before, LogConfig()), SweepStream(after, LogConfig()), strict=True)
        for a, b in pairs:
            assert a.stamp_ns == b.stamp_ns
            assert a.odom_from_base == b.odom_from_base
            assert a.base_from_laser == b.base_from_laser == pytest.approx((0.1, 0.0, 0.0))
            np.testing.assert_array_equal(a.planar.ranges, b.planar.ranges)


def test_what_no_stage_reads_is_left_out_and_said(
    tmp_path: Path, drive_messages: list[Message], write_db3: Callable[..., None]
) -> None:
    extra = Message("/cmd_vel", "geometry_msgs/msg/Twist", drive_messages[-1].time_ns, bytes(52))
    write_db3(tmp_path / "log.db3", [*drive_messages, extra])
    result = convert(tmp_path / "log.db3", tmp_path / "out.mcap")
    assert result.lines()[0] == f"wrote {tmp_path / 'out.mcap'}: 91 messages"
    assert result.lines()[-1] == "left out /cmd_vel: 1 messages of geometry_msgs/msg/Twist"
    write_db3(tmp_path / "other.db3", [extra])
    with pytest.raises(LogError, match="no scans, odometry or transforms; it has /cmd_vel"):
        convert(tmp_path / "other.db3", tmp_path / "nothing.mcap")
    assert not (tmp_path / "nothing.mcap").exists()
