"""An MCAP that Foxglove opens as a map: grid, regions, names, graph, trajectory, scans over time.

Messages are Foxglove's own, in protobuf, as its SDK writes them: JSON has no word for the infinite
range of a beam without return. What does not change is told once, with the first keyframe. The
frame `base_link` moves in the frame of the map, and each scan lies where its laser is mounted.
Submaps and graph are scenes of lines, points and names: a click on one of them shows what the map
knows of it. Colours are those of overview.png.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import IO, Any

import numpy as np
from mcap.writer import CompressionType, Writer

from specmap_cli import __version__
from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.json_values import Point
from specmap_cli.core.progress import Progress
from specmap_cli.drawing.palette import darker
from specmap_cli.exports.foxglove_schemas import (
    LINE_LOOP,
    LINE_STRIP,
    UINT8,
    description,
    encode,
    full_name,
)
from specmap_cli.exports.layers import (
    LAYER_STEP_M,
    WAY,
    Layer,
    Rgb,
    colours,
    graph_lines,
    layers,
    scans_of,
    start_of,
)
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.maps.flat import Fields, known, told_of
from specmap_cli.maps.keyframe_log import EvenSpacing
from specmap_cli.maps.store import Map

BASE_FRAME = "base_link"
_CHUNK_BYTES = 512 * 1024
_NS = 1_000_000_000
_MM_PER_M = 1000.0  # ranges are kept to a millimetre, as in keyframes.mcap


class Foxglove:
    """Topics: /map, /regions, /submaps, /graph, /trajectory; /tf, /pose and /scan over time."""

    description = "MCAP: map, submaps, graph, trajectory and scans, for Foxglove"

    def write(self, stored: Map, target: IO[bytes], progress: Progress) -> None:
        """Write a map; one without scans has no topics over time."""
        start_ns, frame = start_of(stored), stored.frame
        log = _Log(target, start_ns)
        fills = colours(stored)
        for number, layer in enumerate(layers(stored, fills)):
            log.add(f"/{layer.name}", "Grid", _grid(layer, frame, number, log.stamp))
        log.add("/submaps", "SceneUpdate", submap_scene(stored, log.stamp, fills))
        log.add("/graph", "SceneUpdate", graph_scene(stored, log.stamp))
        with scans_of(stored, progress) as scans:
            if scans is not None:
                poses = [_pose(Pose2(*pose)) for pose in stored.trajectory.driven.tolist()]
                path = {"timestamp": log.stamp, "frame_id": frame, "poses": poses}
                log.add("/trajectory", "PosesInFrame", path)
                _write_scans(log, scans, stored.labels.poses, frame, progress)
        log.finish()


class _Log:
    """An MCAP that is being written: a topic is there with its first message."""

    def __init__(self, target: IO[bytes], start_ns: int) -> None:
        self._writer = Writer(target, chunk_size=_CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(profile="", library=f"specmap {__version__}")
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self.stamp = _time(start_ns)
        self._time_ns = start_ns

    def at(self, stamp_ns: int) -> None:
        """What follows is of another time; log times never go back, as stamps may."""
        self.stamp = _time(stamp_ns)
        self._time_ns = max(stamp_ns, self._time_ns + 1)

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
        log.add(
            "/tf",
            "FrameTransform",
            {
                "timestamp": log.stamp,
                "parent_frame_id": frame,
                "child_frame_id": BASE_FRAME,
                "translation": there["position"],
                "rotation": there["orientation"],
            },
        )
        log.add("/pose", "PoseInFrame", {"timestamp": log.stamp, "frame_id": frame, "pose": there})
        spacing = spacings.setdefault(mounting, EvenSpacing())
        even = spacing.beams(scan)
        log.add(
            "/scan",
            "LaserScan",
            {
                "timestamp": log.stamp,
                "frame_id": BASE_FRAME,
                "pose": _pose(mounting),
                "start_angle": even.angle_min,
                "end_angle": even.angle_min + even.increment * (len(even.ranges) - 1),
                "ranges": np.round(even.ranges * _MM_PER_M) / _MM_PER_M,
            },
        )
        progress.advance()


def _grid(layer: Layer, frame: str, number: int, stamp: Fields) -> Fields:
    """A grid of coloured cells; Foxglove takes such fields as they are."""
    width = layer.rgba.shape[1]
    channels = ("red", "green", "blue", "alpha")
    return {
        "timestamp": stamp,
        "frame_id": frame,
        "pose": _pose(Pose2(*layer.origin, 0.0), number * LAYER_STEP_M),
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


def submap_scene(stored: Map, stamp: Fields, fills: Mapping[int, Rgb]) -> dict[str, Any]:
    """The outline and the name of each submap."""
    entities = []
    for node in stored.rooms.values():
        colour = darker(fills[node.id])
        outline = [_line(node.outline.tolist(), colour, _OUTLINE_PX, _OUTLINE_Z, LINE_LOOP)]
        name = {
            "pose": _at(node.place, _TEXT_Z),
            "billboard": True,
            "font_size": _TEXT_PX,
            "scale_invariant": True,
            "color": _colour(colour),
            "text": node.name,
        }
        entity = _entity(f"submap {node.id}", stored.frame, stamp, told_of(node))
        entities.append({**entity, "lines": outline if len(node.outline) else [], "texts": [name]})
    return {"entities": entities}


def graph_scene(stored: Map, stamp: Fields) -> dict[str, Any]:
    """Anchors, ways and doors; a link without a way is thin."""
    frame = stored.frame
    size = {"x": _ANCHOR_M, "y": _ANCHOR_M, "z": 0.01}
    entities = []
    for node in stored.rooms.values():
        if node.anchor is not None:
            pose = _at(node.anchor, _ANCHOR_Z)
            sphere = {"pose": pose, "size": size, "color": _colour(WAY)}
            told = {"clearance_m": node.anchor_clearance_m}
            entity = _entity(f"anchor {node.id}", frame, stamp, told)
            entities.append({**entity, "spheres": [sphere]})
    for one in graph_lines(stored):
        width_px = _LINE_PX if one.is_way else _NO_WAY_PX
        if one.kind == "door":
            width_px = 2.0 * _LINE_PX
        entity = _entity(f"{one.kind} {one.ids}", frame, stamp, one.told)
        line = _line(one.points, one.colour, width_px, _WAY_Z)
        entities.append({**entity, "lines": [line]})
    return {"entities": entities}


def _entity(id_: str, frame: str, stamp: Fields, told: Fields) -> dict[str, Any]:
    """What all entities have; what they tell stands in their metadata."""
    pairs = [{"key": key, "value": str(value)} for key, value in known(told).items()]
    return {"timestamp": stamp, "frame_id": frame, "id": id_, "metadata": pairs}


def _line(
    points: Sequence[Point], colour: Rgb, thickness_px: float, z: float, kind: int = LINE_STRIP
) -> dict[str, Any]:
    """A line as wide on the screen at any distance."""
    return {
        "type": kind,
        "pose": _at((0.0, 0.0), 0.0),
        "thickness": thickness_px,
        "scale_invariant": True,
        "points": [{"x": x, "y": y, "z": z} for x, y in points],
        "color": _colour(colour),
    }


def _at(place: Point, z: float) -> dict[str, Any]:
    x, y = place
    return {"position": {"x": x, "y": y, "z": z}, "orientation": {"w": 1.0}}


def _colour(rgb: Rgb) -> dict[str, float]:
    red, green, blue = (channel / 255.0 for channel in rgb)
    return {"r": red, "g": green, "b": blue, "a": 1.0}
