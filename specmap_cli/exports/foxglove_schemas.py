"""Foxglove's schemas as protobuf: all fields of the messages that a map needs, in their order.

Foxglove knows a message by its name and expects each field of it, so unused ones are described,
too. A test compares them with those of Foxglove's own SDK. No file needs to be compiled: Google's
library builds the messages from their description.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

from google.protobuf.descriptor_pb2 import (
    FieldDescriptorProto,
    FileDescriptorProto,
    FileDescriptorSet,
)
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass

_TIME, _DURATION = "google.protobuf.Timestamp", "google.protobuf.Duration"
_XYZ = "x:double y:double z:double"

# A line of text for each message, `name:kind` for the fields 1, 2, 3 and so on. A kind is a scalar,
# the name of a message, or `enum/NAME`; `*` before it is for a list. Messages without a package are
# Foxglove's.
_MESSAGES: Mapping[str, str] = {
    _TIME: "seconds:int64 nanos:int32",
    _DURATION: "seconds:int64 nanos:int32",
    "Vector2": "x:double y:double",
    "Vector3": _XYZ,
    "Point3": _XYZ,
    "Quaternion": f"{_XYZ} w:double",
    "Pose": "position:Vector3 orientation:Quaternion",
    "Color": "r:double g:double b:double a:double",
    "KeyValuePair": "key:string value:string",
    "PackedElementField": "name:string offset:fixed32 type:enum/NumericType",
    "Grid": f"timestamp:{_TIME} frame_id:string pose:Pose column_count:fixed32 cell_size:Vector2 "
    "row_stride:fixed32 cell_stride:fixed32 fields:*PackedElementField data:bytes",
    "FrameTransform": f"timestamp:{_TIME} parent_frame_id:string child_frame_id:string "
    "translation:Vector3 rotation:Quaternion",
    "PoseInFrame": f"timestamp:{_TIME} frame_id:string pose:Pose",
    "PosesInFrame": f"timestamp:{_TIME} frame_id:string poses:*Pose",
    "LaserScan": f"timestamp:{_TIME} frame_id:string pose:Pose start_angle:double "
    "end_angle:double ranges:*double intensities:*double",
    "ArrowPrimitive": "pose:Pose shaft_length:double shaft_diameter:double head_length:double "
    "head_diameter:double color:Color",
    "CubePrimitive": "pose:Pose size:Vector3 color:Color",
    "SpherePrimitive": "pose:Pose size:Vector3 color:Color",
    "CylinderPrimitive": "pose:Pose size:Vector3 bottom_scale:double top_scale:double color:Color",
    "LinePrimitive": "type:enum/Type pose:Pose thickness:double scale_invariant:bool "
    "points:*Point3 color:Color colors:*Color indices:*fixed32",
    "TriangleListPrimitive": "pose:Pose points:*Point3 color:Color colors:*Color indices:*fixed32",
    "TextPrimitive": "pose:Pose billboard:bool font_size:double scale_invariant:bool color:Color "
    "text:string",
    "ModelPrimitive": "pose:Pose scale:Vector3 color:Color override_color:bool url:string "
    "media_type:string data:bytes",
    "SceneEntityDeletion": f"timestamp:{_TIME} type:enum/Type id:string",
    "SceneEntity": f"timestamp:{_TIME} frame_id:string id:string lifetime:{_DURATION} "
    "frame_locked:bool metadata:*KeyValuePair arrows:*ArrowPrimitive cubes:*CubePrimitive "
    "spheres:*SpherePrimitive cylinders:*CylinderPrimitive lines:*LinePrimitive "
    "triangles:*TriangleListPrimitive texts:*TextPrimitive models:*ModelPrimitive",
    "SceneUpdate": "deletions:*SceneEntityDeletion entities:*SceneEntity",
}
_ENUMS: Mapping[str, Sequence[str]] = {
    "PackedElementField.NumericType": (
        ["UNKNOWN", "UINT8", "INT8", "UINT16", "INT16", "UINT32", "INT32", "FLOAT32", "FLOAT64"]
    ),
    "LinePrimitive.Type": ("LINE_STRIP", "LINE_LOOP", "LINE_LIST"),
    "SceneEntityDeletion.Type": ("MATCHING_ID", "ALL"),
}
UINT8 = 1  # of NumericType
LINE_STRIP, LINE_LOOP = 0, 1


def encode(message: str, value: Mapping[str, Any]) -> bytes:
    """A message; what `value` lacks has its default. ValueError for a field that is none."""
    kind = GetMessageClass(_pool().FindMessageTypeByName(full_name(message)))
    return bytes(kind(**value).SerializeToString())


def description(message: str) -> bytes:
    """The FileDescriptorSet of a message and of all that it is made of, a file each."""
    return bytes(FileDescriptorSet(file=_files(message)).SerializeToString())


def full_name(message: str) -> str:
    """The name of a message with its package."""
    return message if "." in message else f"foxglove.{message}"


@cache
def _pool() -> DescriptorPool:
    pool = DescriptorPool()
    for message in _MESSAGES:
        for file in _files(message):
            pool.AddSerializedFile(file.SerializeToString())
    return pool


def _files(message: str) -> list[FileDescriptorProto]:
    """A file for each message that one is made of, after those that it needs."""
    found = {file.name: file for part in _parts(message) for file in _files(part)}
    return [*found.values(), _file(message)]


def _parts(message: str) -> list[str]:
    """The messages that the fields of one are."""
    kinds = {word.split(":")[1].removeprefix("*") for word in _MESSAGES[message].split()}
    return sorted(kinds & _MESSAGES.keys())


def _file(message: str) -> FileDescriptorProto:
    package, _, name = full_name(message).rpartition(".")
    file = FileDescriptorProto(
        name=_file_name(message),
        package=package,
        dependency=[_file_name(part) for part in _parts(message)],
        syntax="proto3",
    )
    described = file.message_type.add(name=name)
    for number, word in enumerate(_MESSAGES[message].split(), start=1):
        field_name, kind = word.split(":")
        label = "LABEL_REPEATED" if kind.startswith("*") else "LABEL_OPTIONAL"
        kind, _, enum = kind.removeprefix("*").partition("/")
        field = described.field.add(name=field_name, number=number)
        field.label = FieldDescriptorProto.Label.Value(label)
        if enum:
            field.type_name = f".{full_name(message)}.{enum}"
            values = described.enum_type.add(name=enum).value
            for count, value in enumerate(_ENUMS[f"{message}.{enum}"]):
                values.add(name=value, number=count)
        elif kind in _MESSAGES:
            field.type_name, kind = f".{full_name(kind)}", "message"
        field.type = FieldDescriptorProto.Type.Value(f"TYPE_{kind.upper()}")
    return file


def _file_name(message: str) -> str:
    package, _, name = full_name(message).rpartition(".")
    # those of Google's own messages are written small
    plain = name.lower() if package == "google.protobuf" else name
    return f"{package.replace('.', '/')}/{plain}.proto"
