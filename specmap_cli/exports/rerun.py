"""A recording (.rrd) for the Rerun viewer: the same as for Foxglove, as Rerun has it.

Needs rerun-sdk, the extra `specmap-cli[rerun]`; nothing else does, so it is loaded when it is used.
Its files hold random numbers: the same map gives the same data, not the same bytes.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterable
from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, Any

import numpy as np

from specmap_cli.core.files import temporary_files
from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.plugins import extra
from specmap_cli.core.progress import Progress
from specmap_cli.core.text import encodable
from specmap_cli.drawing.palette import darker
from specmap_cli.exports import layers
from specmap_cli.maps.rooms import Fields, known, told_of
from specmap_cli.maps.store import Map

_TRAJECTORY: layers.Rgb = (150, 60, 150)
_OUTLINE_Z, _WAY_Z, _NAME_Z = 0.02, 0.04, 0.06  # above the map, metres


def rerun(stored: Map, target: IO[bytes], progress: Progress) -> None:
    """RRD: map, submaps, graph, trajectory and scans, for the Rerun viewer.

    Entities map, regions, submaps, graph, trajectory; robot and robot/scan on a timeline.
    Raises UsageError when rerun-sdk is not installed.
    """
    needed = "the format rerun needs rerun-sdk, which is not installed"
    sdk = extra("rerun", "'specmap-cli[rerun]'", needed)
    with temporary_files():
        folder = TemporaryDirectory(prefix="specmap-")
    with folder as name:
        path = Path(name) / "map.rrd"  # the SDK writes to a path only
        with closing(_Recording(sdk, path)) as recording:
            _write(recording, stored, progress)
        with path.open("rb") as file:
            shutil.copyfileobj(file, target)


def _write(recording: _Recording, stored: Map, progress: Progress) -> None:
    fills = layers.colours(stored)
    for number, layer in enumerate(layers.layers(stored, fills)):
        recording.grid(layer, number * layers.LAYER_STEP_M)
    for node in stored.rooms.values():
        colour, entity = darker(fills[node.id]), f"submaps/{node.id}"
        if len(node.outline):
            ring = node.outline[[*range(len(node.outline)), 0]].tolist()
            recording.line(f"{entity}/outline", ring, colour, _OUTLINE_Z, {})
        place = node.place
        recording.point(entity, place, colour, encodable(node.name), told_of(node))
    for one in layers.graph_lines(stored):
        entity = f"graph/{one.kind}s/{one.ids}"
        recording.line(entity, one.points, one.colour, _WAY_Z, one.told)
    with layers.scans_of(stored, progress) as scans:
        if scans is None:
            return
        recording.line("trajectory", stored.trajectory.driven[:, :2], _TRAJECTORY, _WAY_Z, {})
        progress.start("writing scans", len(scans))
        for number, pose in enumerate(stored.labels.poses.tolist()):  # in the finished map
            scan = scans.scan(number)
            points = scans.base_from_laser(number).apply(scan.hits())
            recording.scan(scan.stamp_ns, Pose2(*pose), points)
            progress.advance()


class _Recording:
    """A recording of Rerun that is written to a file as it grows."""

    def __init__(self, sdk: Any, path: Path) -> None:
        self._sdk = sdk
        self._stream = sdk.RecordingStream("specmap", recording_id="map", send_properties=False)
        self._stream.set_log_time_enabled(False)  # when the file was made matters to nobody
        self._stream.set_log_tick_enabled(False)
        self._stream.save(path)

    def close(self) -> None:
        """Write what is waiting, and the index."""
        self._stream.disconnect()

    def grid(self, layer: layers.Layer, z: float) -> None:
        """A grid as a picture on a rectangle."""
        rows, columns = layer.rgba.shape[:2]
        corners = np.array([[0, 0], [columns, 0], [columns, rows], [0, rows]], dtype=np.float64)
        places = corners * layer.resolution + layer.origin
        mesh = self._sdk.Mesh3D(
            vertex_positions=_in_space(places, z),
            triangle_indices=[[0, 1, 2], [0, 2, 3]],
            vertex_texcoords=[[0, 1], [1, 1], [1, 0], [0, 0]],
            albedo_texture=np.ascontiguousarray(layer.rgba[::-1]),
        )
        self._stream.log(layer.name, mesh, static=True)

    def line(
        self, entity: str, points: Iterable[Any], colour: layers.Rgb, z: float, told: Fields
    ) -> None:
        """A line that tells of itself."""
        places = _in_space(np.array(list(points), dtype=np.float64).reshape(-1, 2), z)
        strips = self._sdk.LineStrips3D([places], colors=[colour])
        self._stream.log(entity, strips, *self._facts(told), static=True)

    def point(
        self, entity: str, place: Iterable[float], colour: layers.Rgb, label: str, told: Fields
    ) -> None:
        """A point with a name that tells of itself."""
        places = _in_space(np.array([list(place)], dtype=np.float64), _NAME_Z)
        points = self._sdk.Points3D(places, radii=[0.1], colors=[colour], labels=[label])
        self._stream.log(entity, points, *self._facts(told), static=True)

    def scan(self, stamp_ns: int, pose: Pose2, points: FloatArray) -> None:
        """Where the robot is, and the points (N, 2) that it sees, in its frame."""
        self._stream.set_time("time", timestamp=np.datetime64(stamp_ns, "ns"))
        turn = [0.0, 0.0, float(np.sin(pose.theta / 2.0)), float(np.cos(pose.theta / 2.0))]
        transform = self._sdk.Transform3D(
            translation=[pose.x, pose.y, 0.0], quaternion=self._sdk.Quaternion(xyzw=turn)
        )
        self._stream.log("robot", transform)
        self._stream.log("robot/scan", self._sdk.Points3D(_in_space(points, _WAY_Z), radii=[0.03]))

    def _facts(self, told: Fields) -> list[Any]:
        facts = {key: encodable(str(value)) for key, value in known(told).items()}
        return [self._sdk.AnyValues(**facts)] if facts else []


def _in_space(points: FloatArray, z: float) -> FloatArray:
    """(N, 3) places of the plane (N, 2) at a height."""
    return np.column_stack([points, np.full(len(points), z)])
