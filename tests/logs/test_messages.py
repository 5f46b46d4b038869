"""Messages and the writer against other codecs and readers; converting, and rubbish."""

import errno
import math
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any
from unittest.mock import Mock, call

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from specmap_cli.core.errors import LogError, UsageError
from specmap_cli.core.geometry import Pose2
from specmap_cli.core.progress import Silent
from specmap_cli.logs.messages import (
    BadMessageError,
    ScanLayout,
    ScanRecord,
    decode_odometry,
    decode_scan,
    decode_transforms,
)
from specmap_cli.logs.readers.encoding import (
    LASER_SCAN,
    MULTI_ECHO,
    ODOMETRY,
    POINT_CLOUD,
    SUPPORTED_TYPES,
    TF_MESSAGE,
    Transform,
    cloud_cdr,
    in_space,
    message_class,
    message_definition,
    normalized_type,
    odometry_cdr,
    scan_cdr,
    transforms_cdr,
    typestore,
)
from specmap_cli.logs.readers.recording import Message, TopicInfo
from specmap_cli.logs.writer import LogWriter, convert
from tests.logs.recordings import COUNTS, read_rest, write_bag, write_db3
from tests.strategies import poses

STAMP = 1_700_000_000_250_000_000


def test_the_types_that_are_read_are_those_of_ros_2() -> None:
    ours, all_ = (store.fielddefs for store in (typestore(), get_typestore(Stores.ROS2_DASHING)))
    assert ours == {name: all_[name] for name in ours}
    assert ours.keys() >= SUPPORTED_TYPES


def test_the_first_echo_counts() -> None:
    echo = message_class("sensor_msgs/msg/LaserEcho")
    beams = [echo(np.array(e, dtype=np.float32)) for e in ([1.0, 2.0], [], [3.0])]
    time = message_class("builtin_interfaces/msg/Time")(0, 0)
    head = message_class("std_msgs/msg/Header")(time, "laser")
    message = message_class(MULTI_ECHO)(head, -1.0, 1.0, 1.0, 0.0, 0.1, 0.1, 9.0, beams, [])
    data = bytes(typestore().serialize_cdr(message, MULTI_ECHO))
    record = decode_scan(Message("/echoes", MULTI_ECHO, 1, data))
    assert isinstance(record, ScanRecord)
    assert record.ranges.tolist() == [1.0, math.inf, 3.0]


@pytest.mark.parametrize("kind", [LASER_SCAN, MULTI_ECHO, POINT_CLOUD])
def test_rubbish_and_every_cut_of_a_message_are_refused(kind: str) -> None:
    whole = scan_cdr("laser", STAMP, -1.0, 0.25, np.ones(40), range_max=9.0)
    cuts = [whole[:end] for end in range(0, len(whole) - 4, 3)] if kind == LASER_SCAN else []
    for data in (b"", b"\x00\x01\x00\x00", b"\x00\x01\x00\x00" + b"\xff" * 60, *cuts):
        with pytest.raises(BadMessageError):
            decode_scan(Message("/scan", kind, 1, data))


@pytest.mark.parametrize("decode", [decode_odometry, decode_transforms, decode_scan])
@pytest.mark.parametrize("kind", ["geometry_msgs/msg/Twist", "foxglove.LaserScan (protobuf)"])
def test_other_types_on_a_topic_are_refused(decode: Callable[[Message], object], kind: str) -> None:
    with pytest.raises(BadMessageError) as caught:
        decode(Message("/topic", kind, 1, bytes(100)))
    assert str(caught.value).startswith(kind)


@pytest.mark.parametrize("far", [1.1e8, 1e20, 1e308, -1e9, math.nan, math.inf])
def test_places_that_are_not_on_earth_are_refused_and_other_transforms_read(far: float) -> None:
    near = odometry_cdr("odom", "base", STAMP, Pose2(4e7, -4e7, 0.5))
    assert decode_odometry(Message("/odom", ODOMETRY, 1, near)).parent_from_child[0, 3] == 4e7
    data = odometry_cdr("odom", "base", STAMP, Pose2(0.0, far, 0.5))
    with pytest.raises(BadMessageError, match="beyond all bounds"):
        decode_odometry(Message("/odom", ODOMETRY, 1, data))
    places = {"/b": (1.0, 0.0, 0.0), "/c": (0.0, 0.0, far), "/d": (2.0, 0.0, 0.0)}
    sent = [Transform("/a", child, xyz, (0.0, 0.0, 0.0, 0.0)) for child, xyz in places.items()]
    data = transforms_cdr(STAMP, sent)
    records, absurd = decode_transforms(Message("/tf", TF_MESSAGE, 1, data))
    assert absurd == [("a", "c")]
    kept = [(r.parent, r.child, r.parent_from_child[0, 3]) for r in records]
    assert kept == [("a", "b", 1.0), ("a", "d", 2.0)]
    np.testing.assert_array_equal(records[0].parent_from_child[:3, :3], np.eye(3))


def test_scans_and_clouds_of_absurd_size_are_refused() -> None:
    wide = scan_cdr("laser", STAMP, -1.0, 1e-5, np.zeros(100_001), range_max=8.0)
    with pytest.raises(BadMessageError, match=r"a scan of 100,001 beams"):
        decode_scan(Message("/scan", LASER_SCAN, 1, wide))
    with pytest.raises(BadMessageError, match=r"2,000,001 bytes are no .*LaserScan of a robot"):
        decode_scan(Message("/scan", LASER_SCAN, 1, bytes(2_000_001)))
    dense = cloud_cdr("laser", STAMP, np.zeros((4_000_001, 3), dtype=np.float32))
    with pytest.raises(BadMessageError, match=r"a cloud of 1 x 4,000,001 points"):
        decode_scan(Message("/points", POINT_CLOUD, 1, dense))


NS = 10**9
OTHER = get_typestore(Stores.ROS2_DASHING)


def decoded(data: bytes, kind: str) -> Any:
    return OTHER.deserialize_cdr(data, kind)


@given(st.integers(-(2**31) * NS, 2**31 * NS - 1), st.lists(st.floats(width=32), max_size=9))
def test_a_scan_says_what_was_given(stamp: int, ranges: list[float]) -> None:
    more = {"range_min": 0.5, "range_max": 9.0, "scan_time": 0.125, "time_increment": 0.5}
    data = scan_cdr("/laser", stamp, -1.0, 0.25, ranges, **more)
    scan, record = decoded(data, LASER_SCAN), decode_scan(Message("/scan", LASER_SCAN, 1, data))
    assert isinstance(record, ScanRecord)
    assert scan.header.stamp.sec * NS + scan.header.stamp.nanosec == record.stamp_ns == stamp
    for found in (scan.ranges, record.ranges):
        np.testing.assert_array_equal(found, np.array(ranges, dtype=np.float32))
    end = -1.0 + 0.25 * max(len(ranges) - 1, 0)
    assert (scan.angle_max, scan.angle_increment, scan.time_increment) == (end, 0.25, 0.5)
    steps = {"angle_increment": 0.25, "time_increment": 0.5}
    assert record.layout == ScanLayout(angle_min=-1.0, angle_max=end, beams=len(ranges), **steps)
    assert (scan.range_min, scan.range_max, scan.scan_time) == (0.5, 9.0, 0.125)
    assert (record.range_min, record.range_max) == (0.5, 9.0)
    assert (scan.header.frame_id, record.frame) == ("/laser", "laser")
    assert len(scan.intensities) == 0


@pytest.mark.parametrize(
    ("seconds", "written"), [(2**31, 2**31 - 1), (2**40, 2**31 - 1), (-(2**31) - 1, -(2**31))]
)
def test_a_stamp_beyond_its_type_is_clipped(seconds: int, written: int) -> None:
    data = odometry_cdr("odom", "base", seconds * NS + 7, Pose2(0.0, 0.0, 0.0))
    stamp = decoded(data, ODOMETRY).header.stamp
    assert (stamp.sec, stamp.nanosec) == (written, 7)


@given(poses)
def test_a_pose_of_the_plane_in_space(pose: Pose2) -> None:
    xyz, quaternion = in_space(pose)
    assert xyz == (pose.x, pose.y, 0.0)
    turned = Rotation.from_quat(quaternion).as_matrix()
    np.testing.assert_allclose(turned, pose.matrix()[:3, :3], atol=1e-12)
    data = odometry_cdr("odom", "base", STAMP, pose)
    message, odometry = decoded(data, ODOMETRY), decode_odometry(Message("", ODOMETRY, 1, data))
    assert (odometry.parent, odometry.child, odometry.stamp_ns) == ("odom", "base", STAMP)
    assert Pose2.from_matrix(odometry.parent_from_child) == pytest.approx(pose)
    assert (message.pose.pose.position.x, message.pose.pose.position.y) == (pose.x, pose.y)
    assert message.pose.pose.orientation.z == pytest.approx(quaternion[2])
    assert message.child_frame_id == "base"


@pytest.mark.parametrize("kind", sorted(SUPPORTED_TYPES))
def test_a_definition_is_enough_to_read_its_type(kind: str) -> None:
    found = get_types_from_msg(message_definition(kind).decode(), kind)
    ours = typestore().fielddefs
    assert found[kind][1] == ours[kind][1]
    assert all(fields[1] == ours[name][1] for name, fields in found.items())


@pytest.mark.parametrize(
    ("name", "full"),
    [("sensor_msgs/LaserScan", LASER_SCAN), (LASER_SCAN, LASER_SCAN), ("", "")]
    + [("tf/tfMessage", TF_MESSAGE), ("tf2_msgs/TFMessage", TF_MESSAGE)]
    + [("foxglove.LaserScan", "foxglove.LaserScan")],
)
def test_types_of_any_ros_get_their_ros_2_name(name: str, full: str) -> None:
    assert normalized_type(name) == full


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


@pytest.mark.parametrize("error", [None, KeyboardInterrupt()])
def test_a_file_appears_when_it_is_complete(path: Path, error: BaseException | None) -> None:
    """An old one stays until then. No unknown type is taken, and no message behind the end."""
    path.write_text("old")
    log = LogWriter(str(path))
    log.odometry("/odom", "odom", "base_link", 10, Pose2(0.0, 0.0, 0.0))
    assert path.read_bytes() == b"old"
    with pytest.raises(ValueError, match="'sensor_msgs/LaserScan' is no known ROS 2 type"):
        log.raw("/scan", "sensor_msgs/LaserScan", b"", 10)
    for _ in range(2):
        with nullcontext() if error is None else pytest.raises(KeyboardInterrupt), log:
            if error is not None:
                raise error
    with pytest.raises(ValueError, match="is closed: it takes no more messages"):
        log.transform("odom", "base_link", 10, Pose2(0.0, 0.0, 0.0))
    assert path.read_bytes().startswith(b"old" if error else b"\x89MCAP")
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
        f"{path}: cannot be written: No space left on device; free some space, or choose another "
        "place"
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


def test_a_bag_is_converted_and_reads_the_same(tmp_path: Path, driven: list[Message]) -> None:
    bag, out = tmp_path / "log.bag", tmp_path / "out.mcap"
    write_bag(bag, driven)
    result = convert(bag, out)
    assert {t.name: t.count for t in result.written} == COUNTS
    assert result.skipped == ()
    with pytest.raises(UsageError, match="exists already: choose another name"):
        convert(bag, out)
    first = out.read_bytes()
    convert(bag, out, overwrite=True)
    assert out.read_bytes() == first
    for _ in range(2):  # and onto itself
        assert read_rest(out) == (driven, [])
        convert(out, out, overwrite=True)
    assert {path.name for path in tmp_path.iterdir()} == {"drive.mcap", "log.bag", "out.mcap"}


def test_what_no_stage_reads_is_left_out_and_said(tmp_path: Path, driven: list[Message]) -> None:
    extra = Message("/cmd_vel", "geometry_msgs/msg/Twist", driven[-1].time_ns, bytes(52))
    write_db3(tmp_path / "log.db3", [*driven, extra])
    result = convert(tmp_path / "log.db3", tmp_path / "out.mcap")
    assert result.lines()[0] == f"wrote {tmp_path / 'out.mcap'}: 91 messages"
    assert result.lines()[-1] == "left out /cmd_vel: 1 message of geometry_msgs/msg/Twist"
    write_db3(tmp_path / "other.db3", [extra])
    with pytest.raises(LogError, match="no scans, odometry or transforms; it has /cmd_vel"):
        convert(tmp_path / "other.db3", tmp_path / "nothing.mcap")
    assert not (tmp_path / "nothing.mcap").exists()


def test_what_was_converted_is_told(tmp_path: Path, drive: Path, driven: list[Message]) -> None:
    drive.write_bytes(drive.read_bytes()[:-700])
    found, damage = read_rest(drive)
    kept, steps = len(found), Mock(spec=Silent)
    result = convert(str(drive), str(tmp_path / "out.mcap"), progress=steps)
    steps.start.assert_called_once_with("converting", kept)
    assert steps.advance.call_args_list == [call()] * kept
    assert result.path == tmp_path / "out.mcap"
    assert result.damage == tuple(damage) != ()
    written = {topic.name: topic for topic in result.written}
    lasers = sum(m.topic == "/scan" for m in driven[:kept])
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
            with pytest.raises(UsageError, match="is no regular file: choose another place"):
                begin(out)
        with pytest.raises(UsageError, match=r"out\.mcap: cannot be written: No such file"):
            begin(tmp_path / "missing" / "out.mcap")
    with pytest.raises(LogError, match="no such file or directory"):
        convert(tmp_path / "missing.bag", tmp_path / "out.mcap")
    assert [path.name for path in tmp_path.iterdir()] == [drive.name]


def test_a_transform_says_what_was_given() -> None:
    turn = Rotation.from_euler("xyz", [0.3, -0.2, 1.0])
    data = transforms_cdr(STAMP, [Transform("base", "/laser", (1.0, 2.0, 3.0), turn.as_quat())])
    (stamped,) = decoded(data, TF_MESSAGE).transforms
    assert (stamped.header.frame_id, stamped.child_frame_id) == ("base", "/laser")
    moved, turned = stamped.transform.translation, stamped.transform.rotation
    assert (moved.x, moved.y, moved.z) == (1.0, 2.0, 3.0)
    assert [turned.x, turned.y, turned.z, turned.w] == turn.as_quat().tolist()
    ((transform,), _) = decode_transforms(Message("/tf", TF_MESSAGE, 1, data))
    assert (transform.parent, transform.child) == ("base", "laser")
    np.testing.assert_allclose(transform.parent_from_child[:3, :3], turn.as_matrix(), atol=1e-12)
    assert transform.parent_from_child[:3, 3].tolist() == [1.0, 2.0, 3.0]
