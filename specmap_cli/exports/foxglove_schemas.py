"""Foxglove's schemas as protobuf: all fields of the messages that a map needs, in their order.

Foxglove knows a message by its name and expects each field of it, so unused ones are described,
too. A test compares them with those of Foxglove's own SDK.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from specmap_cli.exports.protobuf import Schema

_TIME, _DURATION = "google.protobuf.Timestamp", "google.protobuf.Duration"
_XYZ = "x:double y:double z:double"

# Messages without a package are Foxglove's.
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


def _full(name: str) -> str:
    return name if "." in name else f"foxglove.{name}"


def _full_line(line: str) -> str:
    """The fields of a message, the kinds that are messages by their full names."""
    words = []
    for word in line.split():
        name, kind = word.split(":")
        star, bare = ("*" if kind.startswith("*") else ""), kind.removeprefix("*")
        words.append(f"{name}:{star}{_full(bare) if bare in _MESSAGES else bare}")
    return " ".join(words)


FOXGLOVE = Schema(
    {_full(name): _full_line(line) for name, line in _MESSAGES.items()},
    {f"foxglove.{name}": values for name, values in _ENUMS.items()},
)
