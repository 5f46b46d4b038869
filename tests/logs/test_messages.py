"""Decoding: scans, echoes, odometry, transforms, and rubbish."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from specmap_cli.core.geometry import Pose2
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
    TF_MESSAGE,
    Transform,
    cloud_cdr,
    message_class,
    odometry_cdr,
    scan_cdr,
    transform_cdr,
    transforms_cdr,
    typestore,
)
from specmap_cli.logs.readers.recording import Message

STAMP = 1_700_000_000_250_000_000


def test_a_scan_is_decoded() -> None:
    data = scan_cdr("/laser", STAMP, -1.0, 0.25, [1.0, np.inf], range_max=9.0, time_increment=0.5)
    record = decode_scan(Message("/scan", LASER_SCAN, 1, data))
    assert isinstance(record, ScanRecord)
    assert (record.stamp_ns, record.frame) == (STAMP, "laser")
    assert record.layout == ScanLayout(
        angle_min=-1.0, angle_max=-0.75, angle_increment=0.25, time_increment=0.5, beams=2
    )
    assert record.range_max == 9.0
    assert record.ranges.tolist() == [1.0, math.inf]


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


def test_odometry_and_transforms_are_matrices() -> None:
    data = odometry_cdr("odom", "base", STAMP, Pose2(1.0, 2.0, 0.5))
    odometry = decode_odometry(Message("/odom", ODOMETRY, 1, data))
    assert (odometry.parent, odometry.child, odometry.stamp_ns) == ("odom", "base", STAMP)
    assert Pose2.from_matrix(odometry.parent_from_child) == pytest.approx((1.0, 2.0, 0.5))
    turn = Rotation.from_euler("xyz", [0.3, -0.2, 1.0])
    data = transform_cdr("base", "/laser", STAMP, (1.0, 2.0, 3.0), turn.as_quat())
    (transform,) = decode_transforms(Message("/tf", TF_MESSAGE, 1, data)).records
    assert (transform.parent, transform.child) == ("base", "laser")
    np.testing.assert_allclose(transform.parent_from_child[:3, :3], turn.as_matrix(), atol=1e-12)
    assert transform.parent_from_child[:3, 3].tolist() == [1.0, 2.0, 3.0]


@pytest.mark.parametrize("kind", [LASER_SCAN, MULTI_ECHO, POINT_CLOUD])
def test_rubbish_and_every_cut_of_a_message_are_refused(kind: str) -> None:
    whole = scan_cdr("laser", STAMP, -1.0, 0.25, np.ones(40), range_max=9.0)
    cuts = [whole[:end] for end in range(0, len(whole) - 4, 3)] if kind == LASER_SCAN else []
    for data in (b"", b"\x00\x01\x00\x00", b"\x00\x01\x00\x00" + b"\xff" * 60, *cuts):
        with pytest.raises(BadMessageError):
            decode_scan(Message("/scan", kind, 1, data))


@pytest.mark.parametrize("decode", [decode_odometry, decode_transforms, decode_scan])
@pytest.mark.parametrize("kind", ["geometry_msgs/msg/Twist", "foxglove.LaserScan (protobuf)"])
def test_messages_of_another_type_on_a_topic_are_refused(
    decode: Callable[[Message], object], kind: str
) -> None:
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
    found = decode_transforms(Message("/tf", TF_MESSAGE, 1, data))
    assert found.absurd == (("a", "c"),)
    kept = [(r.parent, r.child, r.parent_from_child[0, 3]) for r in found.records]
    assert kept == [("a", "b", 1.0), ("a", "d", 2.0)]
    np.testing.assert_array_equal(found.records[0].parent_from_child[:3, :3], np.eye(3))


def test_scans_and_clouds_of_absurd_size_are_refused() -> None:
    wide = scan_cdr("laser", STAMP, -1.0, 1e-5, np.zeros(100_001), range_max=8.0)
    with pytest.raises(BadMessageError, match=r"a scan of 100,001 beams"):
        decode_scan(Message("/scan", LASER_SCAN, 1, wide))
    with pytest.raises(BadMessageError, match=r"2,000,001 bytes are no .*LaserScan of a robot"):
        decode_scan(Message("/scan", LASER_SCAN, 1, bytes(2_000_001)))
    dense = cloud_cdr("laser", STAMP, np.zeros((4_000_001, 3), dtype=np.float32))
    with pytest.raises(BadMessageError, match=r"a cloud of 1 x 4,000,001 points"):
        decode_scan(Message("/points", POINT_CLOUD, 1, dense))
