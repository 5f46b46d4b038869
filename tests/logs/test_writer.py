"""The writer against the readers of rosbags and mcap, which know nothing of ours; converting."""

from __future__ import annotations

import errno
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import Mock, call

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from specmap_cli.core.errors import LogError, UsageError
from specmap_cli.core.geometry import Pose2
from specmap_cli.core.progress import Silent
from specmap_cli.logs.messages import decode_odometry
from specmap_cli.logs.readers.recording import Message, TopicInfo
from specmap_cli.logs.writer import LogWriter, convert
from tests.logs.recordings import COUNTS, read_rest, write_bag, write_db3


def write_small(path: Path) -> None:
    with LogWriter(path) as log:
        log.static_transform("base_link", "laser", (0.1, 0.0, 0.3), (0.0, 0.0, 0.0, 1.0), 5)
        log.odometry("/odom", "odom", "base_link", 10, Pose2(1.0, 2.0, 0.5))
        log.transform("odom", "base_link", 10, Pose2(1.0, 2.0, 0.5))
        log.scan("/scan", "laser", 2_000_000_011, -1.0, 0.5, [1.0, np.inf, 2.0], range_max=8.0)
        log.cloud("/points", "lidar", 2_000_000_012, np.eye(3), times_s=[0.0, 0.1, 0.2])


def test_messages_are_read_back_by_other_readers(path: Path) -> None:
    write_small(path)
    found: dict[str, Any] = {}
    with path.open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        for schema, channel, message in reader.iter_messages():
            assert schema is not None
            store = get_typestore(Stores.EMPTY)  # only what the file itself defines
            store.register(get_types_from_msg(schema.data.decode(), schema.name))
            found[channel.topic] = store.deserialize_cdr(message.data, schema.name)
    assert list(found) == ["/tf_static", "/odom", "/tf", "/scan", "/points"]
    scan, pose = found["/scan"], found["/odom"].pose.pose
    assert scan.ranges.tolist() == [1.0, np.inf, 2.0]
    assert (scan.angle_max, scan.header.stamp.sec, scan.header.stamp.nanosec) == (0.0, 2, 11)
    assert (pose.position.x, pose.position.y) == (1.0, 2.0)
    table = found["/points"].data.view("<f4").reshape(3, 4)
    np.testing.assert_allclose(table[:, 3], [0.0, 0.1, 0.2], rtol=1e-6)
    assert summary is not None
    latched = {c.topic for c in summary.channels.values() if c.metadata}
    assert latched == {"/tf_static"}, "for late subscribers"
    assert {s.encoding for s in summary.schemas.values()} == {"ros2msg"}


def test_same_calls_give_the_same_bytes(path: Path) -> None:
    """Nor does the clean-up of the first writer take the part of the second."""
    write_small(path)
    first = path.read_bytes()
    write_small(path)
    assert path.read_bytes() == first


@pytest.mark.parametrize("end", [LogWriter.close, LogWriter.discard])
def test_a_file_appears_when_it_is_complete(path: Path, end: Callable[[LogWriter], None]) -> None:
    """An old one stays until then. No unknown type is taken, and no message behind the end."""
    path.write_text("old")
    log = LogWriter(str(path))
    log.odometry("/odom", "odom", "base_link", 10, Pose2(0.0, 0.0, 0.0))
    assert path.read_bytes() == b"old"
    with pytest.raises(ValueError, match="'sensor_msgs/LaserScan' is no known ROS 2 type"):
        log.raw("/scan", "sensor_msgs/LaserScan", b"", 10)
    for _ in range(2):
        end(log)
    with pytest.raises(ValueError, match="is closed: it takes no more messages"):
        log.transform("odom", "base_link", 10, Pose2(0.0, 0.0, 0.0))
    assert path.read_bytes().startswith(b"\x89MCAP" if end is LogWriter.close else b"old")
    assert list(path.parent.iterdir()) == [path]


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


def test_times_before_1970_are_written_as_its_beginning(path: Path) -> None:
    with LogWriter(path) as log:
        log.odometry("/odom", "odom", "base_link", -5, Pose2(0.0, 0.0, 0.0))
    with path.open("rb") as file:
        ((_, _, message),) = make_reader(file).iter_messages()
    assert (message.log_time, message.publish_time) == (0, 0)
    ((sent,), _) = read_rest(path)
    assert decode_odometry(sent).stamp_ns == -5


def test_what_a_killed_run_had_begun_is_removed(tmp_path: Path) -> None:
    (tmp_path / ".log.mcap.partial-12").write_bytes(b"half")
    with LogWriter(tmp_path / "log.mcap"):
        assert not (tmp_path / ".log.mcap.partial-12").exists()
        with LogWriter(tmp_path / "other.mcap"):
            assert len(list(tmp_path.iterdir())) == 2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["log.mcap", "other.mcap"]


def test_a_bag_is_converted_and_reads_the_same(
    tmp_path: Path, drive_messages: list[Message]
) -> None:
    bag, out = tmp_path / "log.bag", tmp_path / "out.mcap"
    write_bag(bag, drive_messages)
    result = convert(bag, out)
    assert {t.name: t.count for t in result.written} == COUNTS
    assert result.skipped == ()
    with pytest.raises(UsageError, match="exists already; use --overwrite"):
        convert(bag, out)
    first = out.read_bytes()
    convert(bag, out, overwrite=True)
    assert out.read_bytes() == first
    for _ in range(2):  # and onto itself
        assert read_rest(out) == (drive_messages, [])
        convert(out, out, overwrite=True)
    assert {path.name for path in tmp_path.iterdir()} == {"drive.mcap", "log.bag", "out.mcap"}


def test_what_no_stage_reads_is_left_out_and_said(
    tmp_path: Path, drive_messages: list[Message]
) -> None:
    extra = Message("/cmd_vel", "geometry_msgs/msg/Twist", drive_messages[-1].time_ns, bytes(52))
    write_db3(tmp_path / "log.db3", [*drive_messages, extra])
    result = convert(tmp_path / "log.db3", tmp_path / "out.mcap")
    assert result.lines()[0] == f"wrote {tmp_path / 'out.mcap'}: 91 messages"
    assert result.lines()[-1] == "left out /cmd_vel: 1 message of geometry_msgs/msg/Twist"
    write_db3(tmp_path / "other.db3", [extra])
    with pytest.raises(LogError, match="no scans, odometry or transforms; it has /cmd_vel"):
        convert(tmp_path / "other.db3", tmp_path / "nothing.mcap")
    assert not (tmp_path / "nothing.mcap").exists()


def test_what_was_converted_is_told(
    tmp_path: Path, drive: Path, drive_messages: list[Message]
) -> None:
    drive.write_bytes(drive.read_bytes()[:-700])
    found, damage = read_rest(drive)
    kept, steps = len(found), Mock(spec=Silent)
    result = convert(str(drive), str(tmp_path / "out.mcap"), progress=steps)
    steps.start.assert_called_once_with("converting", kept)
    assert steps.advance.call_args_list == [call()] * kept
    assert result.path == tmp_path / "out.mcap"
    assert result.damage == tuple(damage) != ()
    written = {topic.name: topic for topic in result.written}
    lasers = sum(m.topic == "/scan" for m in drive_messages[:kept])
    assert written["/scan"] == TopicInfo("/scan", "sensor_msgs/msg/LaserScan", lasers)
    assert result.lines() == [
        f"wrote {tmp_path / 'out.mcap'}: {kept} messages",
        *(f"  {t.name}  {t.count}  {t.type}" for t in result.written),
        f"damage: {damage[0]}",
    ]


def test_an_unwritable_place_is_told_before_the_log_is_read(tmp_path: Path, drive: Path) -> None:
    begins: list[Callable[[Path | str], object]] = [
        LogWriter,
        lambda out: convert(drive, out, overwrite=True),
    ]
    for begin in begins:
        for out in (tmp_path, "", "/"):
            with pytest.raises(UsageError, match="is a directory; name the MCAP file to write"):
                begin(out)
        with pytest.raises(UsageError, match=r"out\.mcap: cannot write: No such file or directory"):
            begin(tmp_path / "missing" / "out.mcap")
    with pytest.raises(LogError, match="no such file or directory"):
        convert(tmp_path / "missing.bag", tmp_path / "out.mcap")
    assert [path.name for path in tmp_path.iterdir()] == [drive.name]
