"""From CDR bytes to plain records: the only place that knows the fields of ROS messages."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.geometry import FloatArray, rotation_from_quaternion
from specmap_cli.logs.readers import encoding
from specmap_cli.logs.readers.recording import Message

# What no message of a robot reaches: these bounds are checked here, where values enter, and nowhere
# else. A damaged or hostile message would otherwise cost gigabytes or overflow further down.
_FARTHEST_M = 1e8  # twice around the earth: coordinates of any map are smaller
_MOST_BEAMS = 100_000  # of a planar scan; the densest lasers have some thousands
_MOST_POINTS = 4_000_000  # of a cloud; the densest lidars have some hundred thousand
_MOST_BYTES = 2_000_000  # of any message but a cloud


class BadMessageError(ValueError):
    """A message that cannot be used; the text says why."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanLayout:
    """What is the same in all scans of a laser: angles in radians, seconds from beam to beam."""

    angle_min: float
    angle_max: float
    angle_increment: float
    time_increment: float
    beams: int


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanRecord:
    """A LaserScan as recorded, or the first echoes of a MultiEchoLaserScan; ranges (B,) in m."""

    stamp_ns: int
    frame: str
    layout: ScanLayout
    range_min: float
    range_max: float
    ranges: NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class CloudRecord:
    """A PointCloud2 as recorded: `points` a structured array (height, width) over its buffer."""

    layout: ClassVar[None] = None  # only scans have one
    stamp_ns: int
    frame: str
    points: NDArray[np.void]


@dataclass(frozen=True, slots=True)
class TransformRecord:
    """parent_from_child (4, 4) at a stamp, by a transform or by odometry."""

    stamp_ns: int
    parent: str
    child: str
    parent_from_child: FloatArray


def decode_scan(message: Message) -> ScanRecord | CloudRecord:
    """The scan in a message of one of SCAN_TYPES; raises BadMessageError."""
    if message.type not in encoding.SCAN_TYPES:
        raise BadMessageError(f"{message.type} is no scan")
    decoded = _decoded(message, message.type)
    if message.type == encoding.POINT_CLOUD:
        return _cloud(decoded)
    ranges: NDArray[np.float32] = decoded.ranges
    if message.type == encoding.MULTI_ECHO:
        first = [beam.echoes[0] if len(beam.echoes) else np.inf for beam in decoded.ranges]
        ranges = np.array(first, dtype=np.float32)
    if len(ranges) > _MOST_BEAMS:
        raise BadMessageError(f"a scan of {len(ranges):,} beams")
    return ScanRecord(
        stamp_ns=_stamp(decoded.header),
        frame=frame_name(decoded.header.frame_id),
        layout=ScanLayout(
            angle_min=float(decoded.angle_min),
            angle_max=float(decoded.angle_max),
            angle_increment=float(decoded.angle_increment),
            time_increment=float(decoded.time_increment),
            beams=len(ranges),
        ),
        range_min=float(decoded.range_min),
        range_max=float(decoded.range_max),
        ranges=ranges,
    )


def decode_odometry(message: Message) -> TransformRecord:
    """The pose in an Odometry message; raises BadMessageError."""
    decoded = _decoded(message, encoding.ODOMETRY)
    pose, turn = decoded.pose.pose, decoded.pose.pose.orientation
    if not (turn.x or turn.y or turn.z or turn.w):
        raise BadMessageError("odometry without an orientation: its quaternion is zero")
    matrix = _matrix(pose.position, turn)
    if matrix is None:
        raise BadMessageError("odometry is not finite or beyond all bounds")
    header = decoded.header
    return TransformRecord(
        _stamp(header), frame_name(header.frame_id), frame_name(decoded.child_frame_id), matrix
    )


def decode_transforms(message: Message) -> tuple[list[TransformRecord], list[tuple[str, str]]]:
    """Transforms in a TFMessage, (parent, child) of absurd ones; raises BadMessageError."""
    records: list[TransformRecord] = []
    absurd: list[tuple[str, str]] = []
    for stamped in _decoded(message, encoding.TF_MESSAGE).transforms:
        parent, child = frame_name(stamped.header.frame_id), frame_name(stamped.child_frame_id)
        matrix = _matrix(stamped.transform.translation, stamped.transform.rotation)
        if matrix is not None:
            records.append(TransformRecord(_stamp(stamped.header), parent, child, matrix))
        else:
            absurd.append((parent, child))
    return records, absurd


def frame_name(frame: str) -> str:
    """A frame without the leading slash that ROS 1 allowed."""
    return frame.lstrip("/")


def _decoded(message: Message, expected: str) -> Any:
    if message.type != expected:  # a topic may carry two types
        raise BadMessageError(f"{message.type} instead of {expected}")
    if expected != encoding.POINT_CLOUD and len(message.data) > _MOST_BYTES:
        raise BadMessageError(f"{len(message.data):,} bytes are no {expected} of a robot")
    try:
        return encoding.typestore().deserialize_cdr(message.data, message.type)
    except encoding.UNFIT as error:
        raise BadMessageError(f"not a {message.type}: {error}") from None


def _stamp(header: Any) -> int:
    return int(header.stamp.sec) * encoding.NS_PER_S + int(header.stamp.nanosec)


def _matrix(translation: Any, rotation: Any) -> FloatArray | None:
    """A transform (4, 4), None where a number is not finite or beyond all places on earth."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation_from_quaternion(rotation.x, rotation.y, rotation.z, rotation.w)
    matrix[:3, 3] = translation.x, translation.y, translation.z
    possible = np.isfinite(matrix).all() and np.abs(matrix[:3, 3]).max() <= _FARTHEST_M
    return matrix if possible else None


# sensor_msgs/msg/PointField.datatype -> numpy, without the byte order
_DATATYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}


def _cloud(decoded: Any) -> CloudRecord:
    order = ">" if decoded.is_bigendian else "<"
    fields = {f.name: f for f in decoded.fields if f.name and f.datatype in _DATATYPES}
    height, width, step = int(decoded.height), int(decoded.width), int(decoded.point_step)
    row = max(int(decoded.row_step), width * step)
    data = decoded.data
    for name, field in fields.items():  # numpy lets an offset near 2 ** 31 pass and reads there
        if int(field.offset) + np.dtype(_DATATYPES[field.datatype]).itemsize > step:
            raise BadMessageError(
                f"impossible point layout: {name} is beyond the {step} bytes of a point"
            )
    if height * width > _MOST_POINTS:
        raise BadMessageError(f"a cloud of {height:,} x {width:,} points")
    if min(height, width) == 0:
        height = width = 0
    elif (height - 1) * row + width * step > len(data):
        raise BadMessageError(f"{len(data)} bytes are too few for {height} x {width} points")
    try:
        layout = np.dtype(
            {
                "names": list(fields),
                "formats": [order + _DATATYPES[f.datatype] for f in fields.values()],
                "offsets": [int(f.offset) for f in fields.values()],
                "itemsize": step,
            }
        )
        points = np.ndarray((height, width), layout, data, strides=(row, step))
    except (ValueError, TypeError) as error:
        raise BadMessageError(f"impossible point layout: {error}") from None
    if not {"x", "y", "z"} <= set(fields):
        raise BadMessageError(f"no fields x, y and z among {', '.join(fields) or 'none'}")
    return CloudRecord(_stamp(decoded.header), frame_name(decoded.header.frame_id), points)
