"""The ROS 2 message types read and written, and their CDR codec, without ROS.

Every message travels through the package as ROS 2 CDR bytes, whatever file it came from, so that
one codec serves all formats. The layouts of these types have not changed since ROS 2 Dashing,
which is why recordings without message definitions can be read with the same codec.
"""

from __future__ import annotations

import struct
from functools import cache
from typing import Any

from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

LASER_SCAN = "sensor_msgs/msg/LaserScan"
MULTI_ECHO = "sensor_msgs/msg/MultiEchoLaserScan"
POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
ODOMETRY = "nav_msgs/msg/Odometry"
TF_MESSAGE = "tf2_msgs/msg/TFMessage"

SCAN_TYPES = frozenset({LASER_SCAN, MULTI_ECHO, POINT_CLOUD})
SUPPORTED_TYPES = SCAN_TYPES | {ODOMETRY, TF_MESSAGE}

# What the codec raises for bytes that are no message of a type.
UNFIT = (SerdeError, KeyError, IndexError, ValueError, TypeError, MemoryError, struct.error)

NS_PER_S = 1_000_000_000


@cache
def typestore() -> Typestore:
    """The store of ROS 2 types, with the generated codecs."""
    return get_typestore(Stores.ROS2_HUMBLE)


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
