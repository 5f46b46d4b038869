"""The writer against the readers of rosbags and mcap, which know nothing of ours."""

from __future__ import annotations

import errno
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from specmap_cli.core.errors import UsageError
from specmap_cli.core.geometry import Pose2
from specmap_cli.logs.writer import LogWriter


def write_small(path: Path) -> None:
    with LogWriter(path) as log:
        log.static_transform("base_link", "laser", (0.1, 0.0, 0.3), (0.0, 0.0, 0.0, 1.0), 5)
        log.odometry("/odom", "odom", "base_link", 10, Pose2(1.0, 2.0, 0.5))
        log.transform("odom", "base_link", 10, Pose2(1.0, 2.0, 0.5))
        log.scan("/scan", "laser", 2_000_000_011, -1.0, 0.5, [1.0, np.inf, 2.0], range_max=8.0)
        log.cloud("/points", "lidar", 2_000_000_012, np.eye(3), times_s=[0.0, 0.1, 0.2])


def test_messages_are_read_back_by_other_readers(path: Path) -> None:
    write_small(path)
    found = {}
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            assert schema is not None
            store = get_typestore(Stores.EMPTY)  # only what the file itself defines
            store.register(get_types_from_msg(schema.data.decode(), schema.name))
            found[channel.topic] = store.deserialize_cdr(message.data, schema.name)
    assert list(found) == ["/tf_static", "/odom", "/tf", "/scan", "/points"]
    scan, odom, cloud = found["/scan"], found["/odom"], found["/points"]
    assert scan.ranges.tolist() == [1.0, np.inf, 2.0]  # type: ignore[attr-defined]
    assert scan.angle_max == 0.0  # type: ignore[attr-defined]
    assert scan.header.stamp.sec == 2  # type: ignore[attr-defined]
    assert scan.header.stamp.nanosec == 11  # type: ignore[attr-defined]
    pose = odom.pose.pose  # type: ignore[attr-defined]
    assert (pose.position.x, pose.position.y) == (1.0, 2.0)
    assert 2 * np.arctan2(pose.orientation.z, pose.orientation.w) == pytest.approx(0.5)
    table = cloud.data.view("<f4").reshape(3, 4)  # type: ignore[attr-defined]
    np.testing.assert_array_equal(table[:, :3], np.eye(3))
    np.testing.assert_allclose(table[:, 3], [0.0, 0.1, 0.2], rtol=1e-6)


def test_same_calls_give_the_same_bytes(tmp_path: Path) -> None:
    write_small(tmp_path / "a.mcap")
    write_small(tmp_path / "b.mcap")
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


def test_a_failed_run_leaves_nothing(tmp_path: Path) -> None:
    def interrupted() -> None:
        with LogWriter(tmp_path / "log.mcap") as log:
            log.odometry("/odom", "odom", "base_link", 10, Pose2(0.0, 0.0, 0.0))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert list(tmp_path.iterdir()) == []


def test_an_unwritable_place_is_a_usage_error(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="is a directory"):
        LogWriter(tmp_path)
    with pytest.raises(UsageError, match="cannot write: No such file or directory"):
        LogWriter(tmp_path / "missing" / "log.mcap")


@pytest.mark.parametrize("path", [None, 7, b"log.mcap"])
def test_what_is_no_path_is_refused_at_once(path: Any) -> None:
    with pytest.raises(TypeError, match=r"^path: expected a path"):
        LogWriter(path)


def test_a_string_is_a_path_and_the_file_appears_when_it_is_complete(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    log = LogWriter(str(path))
    log.odometry("/odom", "odom", "base_link", 10, Pose2(0.0, 0.0, 0.0))
    assert not path.exists()
    log.close()
    log.close()
    assert [file.name for file in tmp_path.iterdir()] == ["log.mcap"]


@pytest.mark.parametrize("path", ["", "/"])
def test_a_directory_is_no_file_to_write(path: str) -> None:
    with pytest.raises(UsageError, match="is a directory; name the MCAP file to write"):
        LogWriter(path)


def test_a_file_may_be_written_again_at_once(tmp_path: Path) -> None:
    """The clean-up of the first writer must not take the part of the second."""
    for beams in (3, 5):
        with LogWriter(tmp_path / "log.mcap") as log:
            log.scan("/scan", "laser", 10, -1.0, 0.5, np.ones(beams), range_max=8.0)
    with (tmp_path / "log.mcap").open("rb") as file:
        ((_, _, message),) = make_reader(file).iter_messages()
    store = get_typestore(Stores.ROS2_HUMBLE)
    found = store.deserialize_cdr(message.data, "sensor_msgs/msg/LaserScan")
    assert len(found.ranges) == 5  # type: ignore[attr-defined]


@pytest.mark.parametrize("end", [LogWriter.close, LogWriter.discard])
def test_a_closed_writer_takes_no_more(path: Path, end: Callable[[LogWriter], None]) -> None:
    log = LogWriter(path)
    end(log)
    with pytest.raises(ValueError, match="is closed: it takes no more messages"):
        log.transform("odom", "base_link", 10, Pose2(0.0, 0.0, 0.0))


def test_an_unknown_type_is_refused(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "log.mcap") as log:
        with pytest.raises(ValueError, match="'sensor_msgs/LaserScan' is no known ROS 2 type"):
            log.raw("/scan", "sensor_msgs/LaserScan", b"", 10)
        log.raw("/scan", "sensor_msgs/msg/LaserScan", b"", 10)
    with (tmp_path / "log.mcap").open("rb") as file:
        assert len(list(make_reader(file).iter_messages())) == 1


@pytest.mark.parametrize("step", ["add_message", "finish"])
def test_a_full_disk_is_one_line_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Writer, step, full)
    path = tmp_path / "log.mcap"
    with pytest.raises(UsageError) as caught:
        write_small(path)
    assert str(caught.value) == (
        f"{path}: cannot write: No space left on device; free some space, or choose another place"
    )
    assert list(tmp_path.iterdir()) == []


def test_only_static_transforms_are_kept_for_late_subscribers(path: Path) -> None:
    write_small(path)
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    latched = {c.topic for c in summary.channels.values() if c.metadata}
    assert latched == {"/tf_static"}
    assert {s.encoding for s in summary.schemas.values()} == {"ros2msg"}


def test_times_before_1970_are_written_as_its_beginning(path: Path) -> None:
    with LogWriter(path) as log:
        log.odometry("/odom", "odom", "base_link", -5, Pose2(0.0, 0.0, 0.0))
    with path.open("rb") as file:
        ((_, _, message),) = make_reader(file).iter_messages()
    assert (message.log_time, message.publish_time) == (0, 0)
    store = get_typestore(Stores.ROS2_HUMBLE)
    header = store.deserialize_cdr(message.data, "nav_msgs/msg/Odometry").header  # type: ignore[attr-defined]
    assert header.stamp.sec * 10**9 + header.stamp.nanosec == -5


def test_an_old_file_is_replaced_only_by_a_complete_one(path: Path) -> None:
    path.write_text("old")
    log = LogWriter(path)
    log.discard()
    assert path.read_text() == "old"
    LogWriter(path).close()
    assert path.read_bytes().startswith(b"\x89MCAP")


def test_what_a_killed_run_had_begun_is_removed(tmp_path: Path) -> None:
    (tmp_path / ".log.mcap.partial-12").write_bytes(b"half")
    with LogWriter(tmp_path / "log.mcap"):
        assert not (tmp_path / ".log.mcap.partial-12").exists()
        with LogWriter(tmp_path / "other.mcap"):
            assert len(list(tmp_path.iterdir())) == 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["log.mcap", "other.mcap"]
