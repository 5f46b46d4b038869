"""Real logs written anew: as clouds for KISS-ICP, played several times over, cut into pieces."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer

from benchmarks.making.recordings import mount, write_scan
from specmap_cli.core.geometry import Pose2
from specmap_cli.core.settings import LogConfig
from specmap_cli.logs import Message, open_log
from specmap_cli.logs.readers.encoding import typestore
from specmap_cli.logs.stream import SweepStream
from specmap_cli.logs.writer import LogWriter

_PAUSE_NS = 10**9  # between two plays


def write_clouds(log: Path, out: Path, max_range: float) -> int:
    """The returns of every planar scan as PointCloud2 messages on /points; how many scans."""
    count = 0
    with open_log([log]) as source, LogWriter(out) as writer:
        for sweep in SweepStream(source, LogConfig()):
            hits = sweep.planar.hits(max_range)
            points = np.column_stack([hits, np.zeros(len(hits))]).astype(np.float32)
            writer.cloud("/points", "laser", sweep.stamp_ns, points)
            count += 1
    return count


def write_cloud_bag(log: Path, out: Path, topic: str) -> int:
    """The clouds of a 3D log as a rosbag2 directory; how many."""
    with open_log([log]) as source:
        messages = list(source.messages([topic]))
    write_rosbag2(out, messages)
    return len(messages)


def write_rosbag2(path: Path, messages: Sequence[Message]) -> None:
    """Messages as a rosbag2 directory with an SQLite file."""
    with Rosbag2Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        types = {message.topic: message.type for message in messages}
        connections = {
            topic: writer.add_connection(topic, kind, typestore=typestore())
            for topic, kind in types.items()
        }
        for message in messages:
            writer.write(connections[message.topic], message.time_ns, message.data)


def write_plays(log: Path, out: Path, plays: int) -> int:
    """A planar log `plays` times over, the stamps of each play behind the last; how many scans.

    The recording ends where it began only by chance: between two plays the robot is carried, and
    its odometry jumps.
    """
    scans, behind_ns = 0, 0
    with open_log([log]) as source, LogWriter(out) as writer:
        start_ns = source.contents.start_ns
        mounting = Pose2.from_matrix(SweepStream(source, LogConfig()).selection.base_from_laser)
        mount(writer, "laser", mounting, 0)
        for _ in range(plays):
            end_ns = start_ns
            for sweep in SweepStream(source, LogConfig()):
                write_scan(writer, sweep, behind_ns)
                end_ns = sweep.stamp_ns
                scans += 1
            behind_ns += end_ns + _PAUSE_NS - start_ns
    return scans


def write_pieces(log: Path, outs: Sequence[Path]) -> None:
    """A planar log cut by time into as many pieces of the same length as there are files."""
    with open_log([log]) as source:
        start_ns, end_ns = source.contents.start_ns, source.contents.end_ns
        bounds = np.linspace(start_ns, end_ns + 1, len(outs) + 1).astype(np.int64).tolist()
        stream = SweepStream(source, LogConfig())
        mounting = Pose2.from_matrix(stream.selection.base_from_laser)
        with ExitStack() as stack:
            writers = [stack.enter_context(LogWriter(out)) for out in outs]
            for writer in writers:
                mount(writer, "laser", mounting, 0)
            for sweep in stream:
                piece = int(np.searchsorted(bounds, sweep.stamp_ns, side="right")) - 1
                write_scan(writers[min(max(piece, 0), len(outs) - 1)], sweep)
