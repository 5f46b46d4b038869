"""Choosing topics and frames, and saying what there is to choose from."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from specmap_cli.core.config import LogConfig
from specmap_cli.core.errors import LogError, UsageError
from specmap_cli.core.geometry import Pose2
from specmap_cli.logs.opening import open_log
from specmap_cli.logs.selection import Selection, select
from specmap_cli.logs.writer import LogWriter

START = 100_000_000_000


def write(path: Path, scans: list[str], odometry: list[str]) -> None:
    with LogWriter(path) as log:
        log.static_transform("base_link", "laser", (0.1, 0.0, 0.0), stamp_ns=START)
        for topic in scans:
            if "points" in topic:
                log.cloud(topic, "laser", START, [[1.0, 2.0, 0.5], [2.0, 1.0, 0.5]])
            else:
                log.scan(topic, "laser", START, -1.0, 1.0, [1.0, 1.0], range_max=8.0)
        for topic in odometry:
            log.odometry(topic, "odom", "base_link", START, Pose2(0.0, 0.0, 0.0))


def choose(path: Path, **options: object) -> Selection:
    with open_log(path) as log:
        return select(log, LogConfig.model_validate(options))


def test_a_log_without_scans_says_what_it_has(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    write(path, [], ["/odom"])
    with pytest.raises(LogError) as caught:
        choose(path)
    assert str(caught.value) == (
        f"{path}: no LaserScan, MultiEchoLaserScan or PointCloud2 in it; it has "
        "/odom (nav_msgs/msg/Odometry), /tf_static (tf2_msgs/msg/TFMessage)"
    )
    LogWriter(tmp_path / "empty.mcap").close()
    with pytest.raises(LogError, match="it has no messages at all"):
        choose(tmp_path / "empty.mcap")


def test_several_scan_topics_are_listed_ready_to_paste(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    write(path, ["/front", "/points"], [])
    with pytest.raises(UsageError) as caught:
        choose(path)
    assert str(caught.value) == (
        f"{path}: 2 topics carry scans: choose `--scan-topic /front` (LaserScan, 1 message) "
        "or `--scan-topic /points` (PointCloud2, 1 message)"
    )
    assert choose(path, scan_topic="/points").scan_topic == "/points"
    assert choose(path, scan_topic="front").scan_topic == "/front"


def test_several_odometry_topics_are_listed_ready_to_paste(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    write(path, ["/scan"], ["/odom", "/visual"])
    with pytest.raises(UsageError, match=r"`--odom-topic /odom` .* or `--odom-topic /visual`"):
        choose(path)
    assert choose(path, odom_topic="/visual").odom_topics == ("/visual",)
    assert choose(path, use_odometry=False).odometry is None


@pytest.mark.parametrize("option", ["scan", "odom"])
def test_an_unknown_topic_is_refused_with_those_there_are(tmp_path: Path, option: str) -> None:
    path = tmp_path / "log.mcap"
    write(path, ["/scan"], ["/odom"])
    with pytest.raises(UsageError, match=f"--{option}-topic /x: no .* topics with .*: /{option} "):
        choose(path, **{f"{option}_topic": "/x"})


def test_an_unknown_base_frame_is_refused_with_those_there_are(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    write(path, ["/scan"], [])
    with pytest.raises(UsageError, match="choose from base_link, laser"):
        choose(path, base_frame="body")
    chosen = choose(path, base_frame="/laser")
    assert chosen.base_frame == "laser"
    assert chosen.base_from_laser[0, 3] == 0.0


def test_a_scan_topic_of_rubbish_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    with LogWriter(path) as log:
        log.raw("/scan", "sensor_msgs/msg/LaserScan", b"\x00\x01\x00\x00", START)
    with pytest.raises(LogError, match="/scan: no usable scan: not a sensor_msgs/msg/LaserScan"):
        choose(path)


def test_an_unknown_mounting_is_said(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    with LogWriter(path) as log:
        log.odometry("/odom", "odom", "base_link", START, Pose2(0.0, 0.0, 0.0))
        log.scan("/scan", "laser", START, -1.0, 1.0, [1.0, 1.0], range_max=8.0)
    chosen = choose(path)
    assert chosen.base_frame == "base_link"
    assert len(chosen.warnings) == 1
    assert "the laser is taken to sit at the origin of 'base_link'" in chosen.warnings[0]


def test_odometry_of_a_frame_on_its_own_is_said(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    with LogWriter(path) as log:
        log.static_transform("base_link", "laser", (0.1, 0.0, 0.0), stamp_ns=START)
        log.odometry("/odom", "odom", "body", START, Pose2(0.0, 0.0, 0.0))
        log.scan("/scan", "laser", START, -1.0, 1.0, [1.0, 1.0], range_max=8.0)
    chosen = choose(path)
    assert chosen.base_frame == "base_link"
    assert (
        "the odometry moves 'body', which no transform joins to 'base_link'" in (chosen.warnings[0])
    )


def test_a_tilted_laser_is_said(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    with LogWriter(path) as log:
        pitch = (0.0, math.sin(0.3), 0.0, math.cos(0.3))
        log.static_transform("base_link", "laser", (0.0, 0.0, 1.0), pitch, START)
        log.scan("/scan", "laser", START, -1.0, 1.0, [1.0, 1.0], range_max=8.0)
    assert any("is tilted by 34 degrees" in line for line in choose(path).warnings)


def test_a_mounting_only_on_tf_is_found_late(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    with LogWriter(path) as log:
        for i in range(3000):
            stamp = START + i * 1_000_000
            log.transform("odom", "base_link", stamp, Pose2(0.001 * i, 0.0, 0.0))
        log.scan("/scan", "laser", START, -1.0, 1.0, [1.0, 1.0], range_max=8.0)
        log.transform("base_link", "laser", START + 4_000_000_000, Pose2(0.3, 0.0, 0.0))
    chosen = choose(path)
    assert chosen.warnings == []
    assert chosen.base_from_laser[0, 3] == 0.3
