"""Messages made here against the codecs of another distribution of ROS 2, and type names."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from specmap_cli.core.geometry import Pose2
from specmap_cli.logs.readers.encoding import (
    LASER_SCAN,
    ODOMETRY,
    POINT_CLOUD,
    SUPPORTED_TYPES,
    TF_MESSAGE,
    AlikeTransforms,
    Transform,
    cloud_cdr,
    in_space,
    message_definition,
    normalized_type,
    odometry_cdr,
    scan_cdr,
    transform_cdr,
    transforms_cdr,
    typestore,
)
from tests.strategies import poses

NS = 10**9
OTHER = get_typestore(Stores.ROS2_DASHING)


def decoded(data: bytes, kind: str) -> Any:
    return OTHER.deserialize_cdr(data, kind)


@given(
    stamp=st.integers(-(2**31) * NS, 2**31 * NS - 1),
    ranges=st.lists(st.floats(width=32), max_size=9),
)
def test_a_scan_says_what_was_given(stamp: int, ranges: list[float]) -> None:
    scan = decoded(
        scan_cdr("laser", stamp, -1.0, 0.25, ranges, range_min=0.5, range_max=9.0, scan_time=0.125),
        LASER_SCAN,
    )
    assert scan.header.stamp.sec * NS + scan.header.stamp.nanosec == stamp
    np.testing.assert_array_equal(scan.ranges, np.array(ranges, dtype=np.float32))
    assert scan.angle_max == -1.0 + 0.25 * max(len(ranges) - 1, 0)
    assert (scan.range_min, scan.range_max, scan.scan_time) == (0.5, 9.0, 0.125)
    assert (scan.header.frame_id, len(scan.intensities)) == ("laser", 0)


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
    message = decoded(odometry_cdr("odom", "base", 5, pose), ODOMETRY)
    assert (message.pose.pose.position.x, message.pose.pose.position.y) == (pose.x, pose.y)
    assert message.pose.pose.orientation.z == pytest.approx(quaternion[2])
    assert message.child_frame_id == "base"


@pytest.mark.parametrize("times", [None, [0.0, 0.5]])
def test_a_cloud_says_where_its_fields_are(times: list[float] | None) -> None:
    points = [[1.0, 2.0, 3.0], [4.0, np.nan, 6.0]]
    cloud = decoded(cloud_cdr("lidar", 5, points, times), POINT_CLOUD)
    names = [field.name for field in cloud.fields]
    assert names == ["x", "y", "z", *([] if times is None else ["time"])]
    assert (cloud.height, cloud.width, cloud.is_dense) == (1, 2, False)
    assert (cloud.point_step, cloud.row_step) == (4 * len(names), 8 * len(names))
    table = cloud.data.view("<f4").reshape(2, -1)
    np.testing.assert_array_equal(table[:, :3], points)
    if times is not None:
        np.testing.assert_array_equal(table[:, 3], times)


def test_a_transform_says_what_was_given() -> None:
    data = transform_cdr("base", "laser", 5, (1, 2, 3), (0.0, 0.0, 0.6, 0.8))
    (stamped,) = decoded(data, TF_MESSAGE).transforms
    assert (stamped.header.frame_id, stamped.child_frame_id) == ("base", "laser")
    moved, turn = stamped.transform.translation, stamped.transform.rotation
    assert (moved.x, moved.y, moved.z) == (1.0, 2.0, 3.0)
    assert (turn.x, turn.y, turn.z, turn.w) == (0.0, 0.0, 0.6, 0.8)


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


names = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=9)
links = st.lists(st.tuples(names, names), min_size=1, max_size=3)
numbers = st.lists(st.floats(allow_nan=False), min_size=7, max_size=7)
stamps = st.integers(0, 2**60) | st.integers(-(2**62), 2**62)


@given(links, stamps, st.data())
def test_the_bytes_are_those_of_the_general_serialiser_and_are_read_at_their_place(
    frames: list[tuple[str, str]], stamp_ns: int, data: st.DataObject
) -> None:
    form, rows = AlikeTransforms(frames), [data.draw(numbers) for _ in frames]
    pairs = zip(frames, rows, strict=True)
    general = transforms_cdr(stamp_ns, [Transform(*link, row[:3], row[3:]) for link, row in pairs])
    assert form.encoded(stamp_ns, rows) == general
    if 0 <= stamp_ns <= 2**60:
        for place, row in enumerate(rows):
            assert form.decoded(general, place) == (stamp_ns, tuple(row))


def test_a_message_of_other_frames_is_not_read() -> None:
    form = AlikeTransforms([("odom", "base")])
    level = [1.0, 2.0, 0.0, 0.0, 0.0, math.sin(0.5), math.cos(0.5)]
    mine = form.encoded(5, [level])
    for frames in ([("odom", "bass")], [("odom", "base_link")], [("odom", "base")] * 2):
        other = AlikeTransforms(frames).encoded(5, [level] * len(frames))
        assert form.decoded(other, 0) is None
    assert form.decoded(mine[:-1], 0) is None
    assert form.decoded(b"\0\2" + mine[2:], 0) is None  # another encoding
