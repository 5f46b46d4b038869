"""Writing recordings: ROS 2 messages in CDR, in an MCAP file that any ROS 2 tool opens.

The same calls give the same bytes. The file is written under a temporary name beside the target
and renamed when complete, so that an interrupted run leaves nothing that looks like a log.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import IO, Any

import numpy as np
from mcap.writer import CompressionType, Writer
from numpy.typing import ArrayLike

from specmap_cli import __version__
from specmap_cli.errors import UsageError
from specmap_cli.geometry import Pose2
from specmap_cli.logs.typestore import (
    LASER_SCAN,
    ODOMETRY,
    POINT_CLOUD,
    TF_MESSAGE,
    header,
    message_class,
    typestore,
)

CHUNK_BYTES = 512 * 1024
_FLOAT32 = 7  # sensor_msgs/msg/PointField.FLOAT32

# The publisher of /tf_static keeps its messages for late subscribers; players read this.
_LATCHED = (
    "- history: 1\n  depth: 1\n  reliability: 1\n  durability: 1\n"
    "  deadline:\n    sec: 2147483647\n    nsec: 4294967295\n"
    "  lifespan:\n    sec: 2147483647\n    nsec: 4294967295\n"
    "  liveliness: 1\n"
    "  liveliness_lease_duration:\n    sec: 2147483647\n    nsec: 4294967295\n"
    "  avoid_ros_namespace_conventions: false\n"
)


class LogWriter:
    """Writes one MCAP recording; use it in a `with` block, or call `close`.

    Every method stamps its message with `stamp_ns` (header stamp and log time, nanoseconds).
    Messages should come in the order of their stamps, as a recorder would receive them.
    Leaving the `with` block by an exception discards the file. Raises UsageError when the file
    cannot be written.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self._part = self.path.with_name(f".{self.path.name}.{os.getpid()}.part")
        self._channels: dict[tuple[str, str], int] = {}
        self._schemas: dict[str, int] = {}
        self._file: IO[bytes] | None = self._open()
        self._writer = Writer(self._file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(profile="ros2", library=f"specmap {__version__}")

    def static_transform(
        self,
        parent: str,
        child: str,
        xyz: Sequence[float] = (0.0, 0.0, 0.0),
        quaternion_xyzw: Sequence[float] = (0.0, 0.0, 0.0, 1.0),
        stamp_ns: int = 0,
    ) -> None:
        """`parent_from_child`, constant over the recording, on `/tf_static`."""
        self._transform("/tf_static", parent, child, stamp_ns, xyz, quaternion_xyzw)

    def transform(self, parent: str, child: str, stamp_ns: int, parent_from_child: Pose2) -> None:
        """A motion of the plane at one time, on `/tf`."""
        xyz, quaternion = _xyz(parent_from_child), _quaternion(parent_from_child)
        self._transform("/tf", parent, child, stamp_ns, xyz, quaternion)

    def odometry(
        self, topic: str, frame_id: str, child_frame_id: str, stamp_ns: int, pose: Pose2
    ) -> None:
        """`pose` is frame_from_child by dead reckoning, as `nav_msgs/msg/Odometry`."""
        twist = message_class("geometry_msgs/msg/Twist")(linear=_vector(), angular=_vector())
        placed = _placed(_xyz(pose), _quaternion(pose))
        message = message_class(ODOMETRY)(
            header=header(stamp_ns, frame_id),
            child_frame_id=child_frame_id,
            pose=message_class("geometry_msgs/msg/PoseWithCovariance")(
                pose=placed, covariance=np.zeros(36)
            ),
            twist=message_class("geometry_msgs/msg/TwistWithCovariance")(
                twist=twist, covariance=np.zeros(36)
            ),
        )
        self._message(topic, ODOMETRY, message, stamp_ns)

    def scan(
        self,
        topic: str,
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
    ) -> None:
        """One `sensor_msgs/msg/LaserScan` of ranges (B,) in metres: +inf = no return."""
        values = np.ascontiguousarray(ranges, dtype=np.float32)
        message = message_class(LASER_SCAN)(
            header=header(stamp_ns, frame_id),
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
        self._message(topic, LASER_SCAN, message, stamp_ns)

    def cloud(
        self,
        topic: str,
        frame_id: str,
        stamp_ns: int,
        points: ArrayLike,
        times_s: ArrayLike | None = None,
    ) -> None:
        """One `sensor_msgs/msg/PointCloud2` of points (N, 3) in metres, float32.

        `times_s` (N,), seconds after the stamp, become the field `time`.
        """
        columns = [np.asarray(points, dtype=np.float32).reshape(-1, 3)]
        names = ["x", "y", "z"]
        if times_s is not None:
            columns.append(np.asarray(times_s, dtype=np.float32)[:, None])
            names.append("time")
        table = np.hstack(columns).astype("<f4")
        field = message_class("sensor_msgs/msg/PointField")
        message = message_class(POINT_CLOUD)(
            header=header(stamp_ns, frame_id),
            height=1,
            width=len(table),
            fields=[field(n, 4 * i, _FLOAT32, 1) for i, n in enumerate(names)],
            is_bigendian=False,
            point_step=4 * len(names),
            row_step=table.nbytes,
            data=np.frombuffer(table.tobytes(), dtype=np.uint8),
            is_dense=bool(np.isfinite(table).all()),
        )
        self._message(topic, POINT_CLOUD, message, stamp_ns)

    def raw(self, topic: str, msgtype: str, cdr: bytes, log_time_ns: int) -> None:
        """A message already serialised as CDR; `msgtype` is a ROS 2 name."""
        self._writer.add_message(
            self._channel(topic, msgtype),
            log_time=max(int(log_time_ns), 0),
            data=cdr,
            publish_time=max(int(log_time_ns), 0),
        )

    def close(self) -> None:
        """Complete the file and give it its name."""
        if self._file is None:
            return
        try:
            self._writer.finish()  # type: ignore[no-untyped-call]
            self._file.close()
            os.replace(self._part, self.path)
        except OSError as error:
            self.discard()
            raise self._unwritable(error) from None
        self._file = None

    def discard(self) -> None:
        """Give up: nothing is left of the file."""
        if self._file is not None:
            self._file.close()
            self._file = None
        self._part.unlink(missing_ok=True)

    def __enter__(self) -> LogWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is None:
            self.close()
        else:
            self.discard()

    def _open(self) -> IO[bytes]:
        if self.path.is_dir():
            raise UsageError(f"{self.path}: is a directory; name the MCAP file to write")
        try:
            return self._part.open("wb")
        except OSError as error:
            raise self._unwritable(error) from None

    def _unwritable(self, error: OSError) -> UsageError:
        return UsageError(f"{self.path}: cannot write: {error.strerror}; choose another place")

    def _channel(self, topic: str, msgtype: str) -> int:
        key = (topic, msgtype)
        if key not in self._channels:
            if msgtype not in self._schemas:
                text, _ = typestore().generate_msgdef(msgtype, ros_version=2)
                name = self._writer.register_schema(msgtype, "ros2msg", text.encode())
                self._schemas[msgtype] = name
            metadata = {"offered_qos_profiles": _LATCHED} if topic == "/tf_static" else {}
            self._channels[key] = self._writer.register_channel(
                topic, "cdr", self._schemas[msgtype], metadata
            )
        return self._channels[key]

    def _message(self, topic: str, msgtype: str, message: Any, stamp_ns: int) -> None:
        self.raw(topic, msgtype, bytes(typestore().serialize_cdr(message, msgtype)), stamp_ns)

    def _transform(
        self,
        topic: str,
        parent: str,
        child: str,
        stamp_ns: int,
        xyz: Sequence[float],
        quaternion_xyzw: Sequence[float],
    ) -> None:
        stamped = message_class("geometry_msgs/msg/TransformStamped")(
            header=header(stamp_ns, parent),
            child_frame_id=child,
            transform=message_class("geometry_msgs/msg/Transform")(
                translation=_vector(*xyz), rotation=_rotation(quaternion_xyzw)
            ),
        )
        self._message(topic, TF_MESSAGE, message_class(TF_MESSAGE)([stamped]), stamp_ns)


def _xyz(pose: Pose2) -> tuple[float, float, float]:
    return (pose.x, pose.y, 0.0)


def _quaternion(pose: Pose2) -> tuple[float, float, float, float]:
    return (0.0, 0.0, float(np.sin(0.5 * pose.theta)), float(np.cos(0.5 * pose.theta)))


def _vector(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Any:
    return message_class("geometry_msgs/msg/Vector3")(float(x), float(y), float(z))


def _rotation(xyzw: Sequence[float]) -> Any:
    return message_class("geometry_msgs/msg/Quaternion")(*(float(value) for value in xyzw))


def _placed(xyz: Sequence[float], xyzw: Sequence[float]) -> Any:
    point = message_class("geometry_msgs/msg/Point")(*(float(value) for value in xyz))
    return message_class("geometry_msgs/msg/Pose")(position=point, orientation=_rotation(xyzw))
