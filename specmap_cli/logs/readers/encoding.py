"""ROS 2 messages: the types that are read and written, and their bytes in CDR, without ROS.

Every message travels through the package as ROS 2 CDR bytes, whatever file it came from, so that
one codec serves all formats. The layouts of these types have not changed since ROS 2 Dashing,
which is why recordings without message definitions can be read with the same codec. Stamps are
header stamps in nanoseconds, lengths metres, angles radians.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

Planar = tuple[float, float, float]  # x and y in metres, and a heading: a Pose2 is one

LASER_SCAN = "sensor_msgs/msg/LaserScan"
MULTI_ECHO = "sensor_msgs/msg/MultiEchoLaserScan"
POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
ODOMETRY = "nav_msgs/msg/Odometry"
TF_MESSAGE = "tf2_msgs/msg/TFMessage"
TF_STATIC = "/tf_static"

SCAN_TYPES = frozenset({LASER_SCAN, MULTI_ECHO, POINT_CLOUD})
SUPPORTED_TYPES = SCAN_TYPES | {ODOMETRY, TF_MESSAGE}

# What the codec raises for bytes that are no message of a type.
UNFIT = (SerdeError, KeyError, IndexError, ValueError, TypeError, MemoryError, struct.error)

NS_PER_S = 1_000_000_000


@cache
def typestore() -> Typestore:
    """The store of the ROS 2 types that are read and written, with the generated codecs.

    It is made of `ros2.msg`: to load all the types of ROS 2 takes three times as long.
    """
    text = Path(__file__).with_name("ros2.msg").read_text(encoding="utf-8")
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(text.removeprefix(f"MSG: {LASER_SCAN}\n"), LASER_SCAN))
    return store


def message_class(name: str) -> Any:
    """The dataclass of a ROS 2 type such as `std_msgs/msg/Header`."""
    return typestore().types[name]


def normalized_type(name: str) -> str:
    """The ROS 2 name of a type of any ROS: `sensor_msgs/LaserScan` -> `sensor_msgs/msg/LaserScan`.

    The two ancestors of `tf2_msgs/msg/TFMessage` have the same fields and get its name.
    """
    package, separator, rest = name.partition("/")
    if not separator:
        return name  # not a ROS type
    full = f"{package}/msg/{rest.rpartition('/')[2]}"
    return TF_MESSAGE if full == "tf/msg/tfMessage" else full


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


def odometry_cdr(frame_id: str, child_frame_id: str, stamp_ns: int, pose: Planar) -> bytes:
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


class Transform(NamedTuple):
    """parent_from_child in space: metres and a quaternion."""

    parent: str
    child: str
    xyz: Sequence[float]
    quaternion_xyzw: Sequence[float]


def transforms_cdr(stamp_ns: int, transforms: Iterable[Transform]) -> bytes:
    """A TFMessage with several transforms of one time."""
    vector, quaternion, transform, stamped = (
        message_class(f"geometry_msgs/msg/{name}")
        for name in ("Vector3", "Quaternion", "Transform", "TransformStamped")
    )
    return _cdr(
        TF_MESSAGE,
        transforms=[
            stamped(
                header=_header(stamp_ns, given.parent),
                child_frame_id=given.child,
                transform=transform(
                    vector(*map(float, given.xyz)), quaternion(*map(float, given.quaternion_xyzw))
                ),
            )
            for given in transforms
        ],
    )


def in_space(pose: Planar) -> tuple[tuple[float, float, float], tuple[float, float, float, float]]:
    """Translation and quaternion (x, y, z, w) in space of a pose in the plane."""
    x, y, theta = pose
    return (float(x), float(y), 0.0), (0.0, 0.0, math.sin(0.5 * theta), math.cos(0.5 * theta))


def message_definition(type_name: str) -> bytes:
    """The text that defines a ROS 2 type and the types it contains; ValueError if unknown."""
    known = type_name in typestore().types
    store = typestore() if known else get_typestore(Stores.ROS2_DASHING)
    try:
        text, _ = store.generate_msgdef(type_name, ros_version=2)
    except TypesysError:
        raise ValueError(
            f"{type_name!r} is no known ROS 2 type; expected such as {LASER_SCAN!r}"
        ) from None
    return text.encode()


def _header(stamp_ns: int, frame_id: str) -> Any:
    """A header; a stamp out of the range of its type is clipped."""
    seconds, nanoseconds = divmod(int(stamp_ns), NS_PER_S)
    clipped = min(max(seconds, -_MAX_SECONDS - 1), _MAX_SECONDS)
    stamp = message_class("builtin_interfaces/msg/Time")(clipped, nanoseconds)
    return message_class("std_msgs/msg/Header")(stamp, frame_id)


def _cdr(type_name: str, **fields: Any) -> bytes:
    message = message_class(type_name)(**fields)
    return bytes(typestore().serialize_cdr(message, type_name))
