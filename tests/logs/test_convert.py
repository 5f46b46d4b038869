"""Converting logs of any format to MCAP."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from specmap_cli.core.errors import LogError, UsageError
from specmap_cli.core.progress import Silent
from specmap_cli.core.settings import LogConfig
from specmap_cli.logs import open_log
from specmap_cli.logs.readers.recording import Message, TopicInfo
from specmap_cli.logs.stream import SweepStream
from specmap_cli.logs.writer import convert


class Steps(Silent):
    """A progress that writes down what it is told."""

    def __init__(self) -> None:
        super().__init__()
        self.stages: list[tuple[str, int | None]] = []
        self.done = 0

    def start(self, stage: str, total: int | None) -> None:
        self.stages.append((stage, total))

    def advance(self, steps: int = 1) -> None:
        self.done += steps


def test_a_bag_is_converted_and_reads_the_same(
    tmp_path: Path, drive_messages: list[Message], write_bag: Callable[..., None]
) -> None:
    write_bag(tmp_path / "log.bag", drive_messages)
    result = convert(tmp_path / "log.bag", tmp_path / "out.mcap")
    assert {t.name: t.count for t in result.written} == {"/odom": 60, "/scan": 30, "/tf_static": 1}
    assert result.skipped == ()
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
    assert result.lines()[-1] == "left out /cmd_vel: 1 message of geometry_msgs/msg/Twist"
    write_db3(tmp_path / "other.db3", [extra])
    with pytest.raises(LogError, match="no scans, odometry or transforms; it has /cmd_vel"):
        convert(tmp_path / "other.db3", tmp_path / "nothing.mcap")
    assert not (tmp_path / "nothing.mcap").exists()


def test_what_was_converted_is_told(
    tmp_path: Path, drive: Path, drive_messages: list[Message]
) -> None:
    drive.write_bytes(drive.read_bytes()[:-700])
    with open_log(drive) as log:
        kept = len(list(log.messages()))
        damage = log.damage
    steps = Steps()
    result = convert(str(drive), str(tmp_path / "out.mcap"), progress=steps)
    assert steps.stages == [("converting", kept)]
    assert steps.done == kept
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


def test_one_message_is_one_message(
    tmp_path: Path, drive_messages: list[Message], write_db3: Callable[..., None]
) -> None:
    write_db3(tmp_path / "log.db3", drive_messages[:1])
    result = convert(tmp_path / "log.db3", tmp_path / "out.mcap")
    assert result.lines() == [
        f"wrote {tmp_path / 'out.mcap'}: 1 message",
        "  /tf_static  1  tf2_msgs/msg/TFMessage",
    ]


def test_a_log_may_be_converted_onto_itself(drive: Path, drive_messages: list[Message]) -> None:
    convert(drive, drive, overwrite=True)
    with open_log(drive) as log:
        assert list(log.messages()) == drive_messages
    assert [path.name for path in drive.parent.iterdir()] == [drive.name]


@pytest.mark.parametrize(
    ("paths", "out", "said"),
    [
        (None, "out.mcap", r"^paths: expected a path.*, found None"),
        ("log.bag", 3, r"^out: expected a path.*, found 3"),
        ("log.bag", ["out.mcap"], r"^out: expected a path.*, found \['out.mcap'\]"),
    ],
)
def test_wrong_types_are_refused_before_the_log_is_opened(paths: Any, out: Any, said: str) -> None:
    with pytest.raises(TypeError, match=said):
        convert(paths, out)


def test_an_unwritable_place_is_told_before_the_log_is_read(tmp_path: Path, drive: Path) -> None:
    with pytest.raises(UsageError, match=r"out\.mcap: cannot write: No such file or directory"):
        convert(drive, tmp_path / "missing" / "out.mcap")
    with pytest.raises(UsageError, match="is a directory; name the MCAP file to write"):
        convert(drive, tmp_path, overwrite=True)
    with pytest.raises(LogError, match="no such file or directory"):
        convert(tmp_path / "missing.bag", tmp_path / "out.mcap")
    assert [path.name for path in tmp_path.iterdir()] == [drive.name]
