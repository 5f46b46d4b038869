"""What `info` says and what `convert` writes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from specmap_cli.core.geometry import Pose2
from specmap_cli.core.settings import LogConfig
from specmap_cli.logs.inspection import summarize
from specmap_cli.logs.opening import open_log
from specmap_cli.logs.stream import SweepStream
from specmap_cli.logs.summary import LogSummary
from specmap_cli.logs.writer import LogWriter


def summary_of(path: Path) -> LogSummary:
    with open_log(path) as log:
        return summarize(log)


def test_a_drive_is_summed_up(drive: Path) -> None:
    summary = summary_of(drive)
    assert summary.extent.messages == 91
    assert summary.extent.duration_s == pytest.approx(2.95)
    rates = {t.name: t.rate_hz for t in summary.topics}
    assert rates["/odom"] == pytest.approx(59 / 2.95)
    assert rates["/tf_static"] == 0.0
    (frame,) = summary.frames
    assert (frame.parent, frame.child, frame.xyz_m) == ("base_link", "laser", (0.2, 0.0, 0.3))
    assert summary.scan is not None
    assert summary.scan.beams == 40
    assert summary.scan.field_of_view_deg == pytest.approx(171.89, abs=0.01)
    assert summary.scan.range_max_m == 8.0
    assert summary.outlook.next_command == f"specmap build {drive}"
    assert summary.outlook.problem is None
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
    assert summary.outlook.problem is not None
    assert "3 topics carry scans" in summary.outlook.problem
    assert summary.outlook.next_command == (
        f"specmap build '{path}' --scan-topic /rear --odom-topic /visual"
    )
    with open_log(path) as log_:
        options = LogConfig(scan_topic="/rear", odom_topic="/visual")
        assert len(list(SweepStream(log_, options))) == 3


def test_a_log_without_scans_has_no_next_command(path: Path) -> None:
    with LogWriter(path) as log:
        log.odometry("/odom", "odom", "base", 1, Pose2(0.0, 0.0, 0.0))
    summary = summary_of(path)
    assert summary.outlook.next_command is None
    assert summary.outlook.problem is not None
    assert "problem: " in "\n".join(summary.lines())
