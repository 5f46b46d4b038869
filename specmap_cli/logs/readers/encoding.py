"""Building the messages specmap writes, as ROS 2 CDR bytes.

Stamps are header stamps in nanoseconds, lengths metres, angles radians.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from rosbags.typesys import TypesysError

from specmap_cli.core.geometry import Pose2
from specmap_cli.logs.readers.typestore import (
    LASER_SCAN,
    NS_PER_S,
    ODOMETRY,
    POINT_CLOUD,
    TF_MESSAGE,
    message_class,
    typestore,
)

_FLOAT32 = 7  # sensor_msgs/msg/PointField.FLOAT32
_MAX_SECONDS = 2**31 - 1  # of builtin_interfaces/msg/Time, whose seconds are an int32


def scan_cdr(
    frame_id: str,
    stamp_ns: int,
    angle_min: float,
    angle_increment: float,
    ranges: ArrayLike,
    *,
    range_min: float = 0.0,
    range_max: float,
    time_increment: float = 0.0,
    scan_time: float = 0.0,
) -> bytes:
    """A LaserScan of ranges (B,): +inf = no return, NaN = invalid."""
    values = np.ascontiguousarray(ranges, dtype=np.float32)
    return _cdr(
        LASER_SCAN,
        header=_header(stamp_ns, frame_id),
        angle_min=angle_min,
        angle_max=angle_min + angle_increment * max(len(values) - 1, 0),
        angle_increment=angle_increment,
        time_increment=time_increment,
        scan_time=scan_time,
        range_min=range_min,
        range_max=range_max,
        ranges=values,
        intensities=np.zeros(0, dtype=np.float32),
    )


def cloud_cdr(
    frame_id: str, stamp_ns: int, points: ArrayLike, times_s: ArrayLike | None = None
) -> bytes:
    """A PointCloud2 of points (N, 3) and, as field `time`, seconds (N,) after the stamp."""
    columns = [np.asarray(points, dtype=np.float32).reshape(-1, 3)]
    names = ["x", "y", "z"]
    if times_s is not None:
        columns.append(np.asarray(times_s, dtype=np.float32)[:, None])
        names.append("time")
    table = np.hstack(columns).astype("<f4")
    field = message_class("sensor_msgs/msg/PointField")
    return _cdr(
        POINT_CLOUD,
        header=_header(stamp_ns, frame_id),
        height=1,
        width=len(table),
        fields=[field(name, 4 * i, _FLOAT32, 1) for i, name in enumerate(names)],
        is_bigendian=False,
        point_step=4 * len(names),
        row_step=table.nbytes,
        data=np.frombuffer(table.tobytes(), dtype=np.uint8),
        is_dense=bool(np.isfinite(table).all()),
    )


def odometry_cdr(frame_id: str, child_frame_id: str, stamp_ns: int, pose: Pose2) -> bytes:
    """An Odometry whose pose is frame_from_child; covariances and twist are zero."""
    xyz, quaternion = in_space(pose)
    zero = message_class("geometry_msgs/msg/Vector3")(0.0, 0.0, 0.0)
    return _cdr(
        ODOMETRY,
        header=_header(stamp_ns, frame_id),
        child_frame_id=child_frame_id,
        pose=message_class("geometry_msgs/msg/PoseWithCovariance")(
            pose=message_class("geometry_msgs/msg/Pose")(
                position=message_class("geometry_msgs/msg/Point")(*xyz),
                orientation=message_class("geometry_msgs/msg/Quaternion")(*quaternion),
            ),
            covariance=np.zeros(36),
        ),
        twist=message_class("geometry_msgs/msg/TwistWithCovariance")(
            twist=message_class("geometry_msgs/msg/Twist")(linear=zero, angular=zero),
            covariance=np.zeros(36),
        ),
    )


def transform_cdr(
    parent: str,
    child: str,
    stamp_ns: int,
    xyz: Sequence[float],
    quaternion_xyzw: Sequence[float],
) -> bytes:
    """A TFMessage with the one transform parent_from_child."""
    return transforms_cdr(stamp_ns, [Transform(parent, child, xyz, quaternion_xyzw)])


class Transform(NamedTuple):
    """parent_from_child in space: metres and a quaternion."""

    parent: str
    child: str
    xyz: Sequence[float]
    quaternion_xyzw: Sequence[float]


def transforms_cdr(stamp_ns: int, transforms: Iterable[Transform]) -> bytes:
    """A TFMessage with several transforms of one time."""
    return _cdr(TF_MESSAGE, transforms=[_stamped(stamp_ns, given) for given in transforms])


def _stamped(stamp_ns: int, given: Transform) -> Any:
    """A TransformStamped."""
    translation = message_class("geometry_msgs/msg/Vector3")(*(float(v) for v in given.xyz))
    quaternion = (float(v) for v in given.quaternion_xyzw)
    rotation = message_class("geometry_msgs/msg/Quaternion")(*quaternion)
    return message_class("geometry_msgs/msg/TransformStamped")(
        header=_header(stamp_ns, given.parent),
        child_frame_id=given.child,
        transform=message_class("geometry_msgs/msg/Transform")(translation, rotation),
    )


def in_space(pose: Pose2) -> tuple[tuple[float, float, float], tuple[float, float, float, float]]:
    """Translation and quaternion (x, y, z, w) in space of a pose in the plane."""
    half = 0.5 * pose.theta
    return (float(pose.x), float(pose.y), 0.0), (0.0, 0.0, math.sin(half), math.cos(half))


def message_definition(type_name: str) -> bytes:
    """The text that defines a ROS 2 type and the types it contains; ValueError if unknown."""
    try:
        text, _ = typestore().generate_msgdef(type_name, ros_version=2)
    except TypesysError:
        raise ValueError(
            f"{type_name!r} is no known ROS 2 type; expected such as {LASER_SCAN!r}"
        ) from None
    return text.encode()


def _header(stamp_ns: int, frame_id: str) -> Any:
    stamp = message_class("builtin_interfaces/msg/Time")(*clipped_stamp(stamp_ns))
    return message_class("std_msgs/msg/Header")(stamp, frame_id)


def clipped_stamp(stamp_ns: int) -> tuple[int, int]:
    """Seconds and nanoseconds of a Time; a stamp out of the range of its type is clipped."""
    seconds, nanoseconds = divmod(int(stamp_ns), NS_PER_S)
    return min(max(seconds, -_MAX_SECONDS - 1), _MAX_SECONDS), nanoseconds


def _cdr(type_name: str, **fields: Any) -> bytes:
    message = message_class(type_name)(**fields)
    return bytes(typestore().serialize_cdr(message, type_name))
