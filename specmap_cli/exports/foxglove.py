"""An MCAP that Foxglove opens as a map: grid, regions, names, graph, trajectory, scans over time.

Messages are Foxglove's own, in protobuf, as its SDK writes them: JSON has no word for the infinite
range of a beam without return. What does not change is told once, with the first keyframe. The
frame `base_link` moves in the frame of the map, and each scan lies where its laser is mounted.
Submaps and graph are scenes of lines, points and names: a click on one of them shows what the map
knows of it. Colours are those of overview.png.

Foxglove knows a message by its name and expects each field of it, in its order, so unused ones are
described, too. A test compares them with those of Foxglove's own SDK. No file needs to be compiled:
Google's library builds the messages from their description.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cache
from typing import IO, Any

import numpy as np
from google.protobuf.descriptor_pb2 import (
    FieldDescriptorProto,
    FileDescriptorProto,
    FileDescriptorSet,
)
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from mcap.writer import CompressionType, Writer

from specmap_cli import __version__
from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.json_values import Point
from specmap_cli.core.progress import Progress
from specmap_cli.drawing.palette import darker
from specmap_cli.exports import layers
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.maps.keyframe_log import EvenSpacing
from specmap_cli.maps.rooms import Fields, known, told_of
from specmap_cli.maps.store import Map

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


BASE_FRAME = "base_link"
_CHUNK_BYTES = 512 * 1024
_NS = 1_000_000_000
_MM_PER_M = 1000.0  # ranges are kept to a millimetre, as in keyframes.mcap


def foxglove(stored: Map, target: IO[bytes], progress: Progress) -> None:
    """MCAP: map, submaps, graph, trajectory and scans, for Foxglove.

    Topics: /map, /regions, /submaps, /graph, /trajectory; /tf, /pose and /scan over time.
    """
    stamps_ns, frame = stored.keyframes.stamps_ns, stored.frame
    start_ns = max(int(stamps_ns[0]), 0) if len(stamps_ns) else 0
    log = _Log(target, start_ns)
    fills = layers.colours(stored)
    for number, layer in enumerate(layers.layers(stored, fills)):
        log.add(f"/{layer.name}", "Grid", log.head(frame) | _grid(layer, number))
    log.add("/submaps", "SceneUpdate", submap_scene(stored, log.head(frame), fills))
    log.add("/graph", "SceneUpdate", graph_scene(stored, log.head(frame)))
    with layers.scans_of(stored, progress) as scans:
        if scans is not None:
            poses = [_pose(Pose2(*pose)) for pose in stored.trajectory.driven.tolist()]
            log.add("/trajectory", "PosesInFrame", log.head(frame) | {"poses": poses})
            _write_scans(log, scans, stored.labels.poses, frame, progress)
    log.finish()


class _Log:
    """An MCAP that is being written: a topic is there with its first message."""

    def __init__(self, target: IO[bytes], start_ns: int) -> None:
        self._writer = Writer(target, chunk_size=_CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(profile="", library=f"specmap {__version__}")
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._stamp = _time(start_ns)
        self._time_ns = start_ns

    def at(self, stamp_ns: int) -> None:
        """What follows is of another time; log times never go back, as stamps may."""
        self._stamp = _time(stamp_ns)
        self._time_ns = max(stamp_ns, self._time_ns + 1)

    def head(self, frame: str) -> Fields:
        """What all that is in a frame begins with."""
        return {"timestamp": self._stamp, "frame_id": frame}

    def add(self, topic: str, schema: str, message: Mapping[str, Any]) -> None:
        """One message of a schema of Foxglove."""
        if schema not in self._schemas:
            self._schemas[schema] = self._writer.register_schema(
                full_name(schema), "protobuf", description(schema)
            )
        if topic not in self._channels:
            self._channels[topic] = self._writer.register_channel(
                topic, "protobuf", self._schemas[schema]
            )
        data, now = encode(schema, message), self._time_ns
        self._writer.add_message(self._channels[topic], now, data, now)

    def finish(self) -> None:
        """Write the index."""
        self._writer.finish()  # type: ignore[no-untyped-call]


def _write_scans(
    log: _Log, scans: KeyframeStore, poses: FloatArray, frame: str, progress: Progress
) -> None:
    """Pose and scan of each keyframe, with `poses` (n, 3) in the finished map."""
    progress.start("writing scans", len(scans))
    spacings: dict[Pose2, EvenSpacing] = {}
    for number, pose in enumerate(poses.tolist()):
        scan, mounting = scans.scan(number), scans.base_from_laser(number)
        log.at(scan.stamp_ns)
        there = _pose(Pose2(*pose))
        moved = {
            "timestamp": _time(scan.stamp_ns),
            "parent_frame_id": frame,
            "child_frame_id": BASE_FRAME,
            "translation": there["position"],
            "rotation": there["orientation"],
        }
        log.add("/tf", "FrameTransform", moved)
        log.add("/pose", "PoseInFrame", log.head(frame) | {"pose": there})
        even = spacings.setdefault(mounting, EvenSpacing()).beams(scan)
        seen = {
            "pose": _pose(mounting),
            "start_angle": even.angle_min,
            "end_angle": even.angle_min + even.increment * (len(even.ranges) - 1),
            "ranges": np.round(even.ranges * _MM_PER_M) / _MM_PER_M,
        }
        log.add("/scan", "LaserScan", log.head(BASE_FRAME) | seen)
        progress.advance()


def _grid(layer: layers.Layer, number: int) -> Fields:
    """A grid of coloured cells; Foxglove takes such fields as they are."""
    width = layer.rgba.shape[1]
    channels = ("red", "green", "blue", "alpha")
    return {
        "pose": _pose(Pose2(*layer.origin, 0.0), number * layers.LAYER_STEP_M),
        "column_count": width,
        "cell_size": {"x": layer.resolution, "y": layer.resolution},
        "row_stride": 4 * width,
        "cell_stride": 4,
        "fields": [
            {"name": name, "offset": offset, "type": UINT8} for offset, name in enumerate(channels)
        ],
        "data": layer.rgba.tobytes(),
    }


def _pose(pose: Pose2, z: float = 0.0) -> dict[str, Any]:
    half = 0.5 * pose.theta
    return {
        "position": {"x": pose.x, "y": pose.y, "z": z},
        "orientation": {"x": 0.0, "y": 0.0, "z": math.sin(half), "w": math.cos(half)},
    }


def _time(stamp_ns: int) -> Fields:
    seconds, nanos = divmod(max(stamp_ns, 0), _NS)  # the format has no times before 1970
    return {"seconds": seconds, "nanos": nanos}


_LINE_PX, _NO_WAY_PX, _OUTLINE_PX, _TEXT_PX = 3.0, 1.0, 2.0, 14.0
_ANCHOR_M = 0.25
# Heights at which things lie above the map, metres: each is seen on those below.
_OUTLINE_Z, _WAY_Z, _ANCHOR_Z, _TEXT_Z = 0.02, 0.04, 0.06, 0.5


def submap_scene(stored: Map, head: Fields, fills: Mapping[int, layers.Rgb]) -> dict[str, Any]:
    """The outline and the name of each submap; `head` is what each begins with."""
    entities = []
    for node in stored.rooms.values():
        colour = darker(fills[node.id])
        outline = [_line(node.outline.tolist(), colour, _OUTLINE_PX, _OUTLINE_Z, LINE_LOOP)]
        name = {
            "pose": _pose(Pose2(*node.place, 0.0), _TEXT_Z),
            "billboard": True,
            "font_size": _TEXT_PX,
            "scale_invariant": True,
            "color": _colour(colour),
            "text": node.name,
        }
        drawn = {"lines": outline if len(node.outline) else [], "texts": [name]}
        entities.append(_entity(f"submap {node.id}", head, told_of(node), **drawn))
    return {"entities": entities}


def graph_scene(stored: Map, head: Fields) -> dict[str, Any]:
    """Anchors, ways and doors; a link without a way is thin. `head` is what each begins with."""
    size = {"x": _ANCHOR_M, "y": _ANCHOR_M, "z": 0.01}
    entities = []
    for node in stored.rooms.values():
        if node.anchor is not None:
            pose = _pose(Pose2(*node.anchor, 0.0), _ANCHOR_Z)
            spheres = [{"pose": pose, "size": size, "color": _colour(layers.WAY)}]
            told = {"clearance_m": node.anchor_clearance_m}
            entities.append(_entity(f"anchor {node.id}", head, told, spheres=spheres))
    for one in layers.graph_lines(stored):
        width_px = _LINE_PX if one.is_way else _NO_WAY_PX
        if one.kind == "door":
            width_px = 2.0 * _LINE_PX
        lines = [_line(one.points, one.colour, width_px, _WAY_Z)]
        entities.append(_entity(f"{one.kind} {one.ids}", head, one.told, lines=lines))
    return {"entities": entities}


def _entity(id_: str, head: Fields, told: Fields, **drawn: Any) -> dict[str, Any]:
    """An entity of what is drawn; what it tells stands in its metadata."""
    pairs = [{"key": key, "value": str(value)} for key, value in known(told).items()]
    return {**head, "id": id_, "metadata": pairs, **drawn}


def _line(
    points: Sequence[Point],
    colour: layers.Rgb,
    thickness_px: float,
    z: float,
    kind: int = LINE_STRIP,
) -> dict[str, Any]:
    """A line as wide on the screen at any distance."""
    return {
        "type": kind,
        "pose": _pose(Pose2(0.0, 0.0, 0.0)),
        "thickness": thickness_px,
        "scale_invariant": True,
        "points": [{"x": x, "y": y, "z": z} for x, y in points],
        "color": _colour(colour),
    }


def _colour(rgb: layers.Rgb) -> dict[str, float]:
    red, green, blue = (channel / 255.0 for channel in rgb)
    return {"r": red, "g": green, "b": blue, "a": 1.0}
