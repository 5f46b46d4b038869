"""Real logs written anew: as clouds for KISS-ICP, played several times over, cut into pieces."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from benchmarks.reading import write_rosbag2
from specmap_cli.core.geometry import Pose2, quaternions_from_rpy
from specmap_cli.core.records import Sweep
from specmap_cli.core.settings import LogConfig
from specmap_cli.logs import open_log
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


def write_plays(log: Path, out: Path, plays: int) -> int:
    """A planar log `plays` times over, the stamps of each play behind the last; how many scans.

    The recording ends where it began only by chance: between two plays the robot is carried, and
    its odometry jumps.
    """
    scans, behind_ns = 0, 0
    with open_log([log]) as source, LogWriter(out) as writer:
        start_ns = source.contents.start_ns
        mounting = Pose2.from_matrix(SweepStream(source, LogConfig()).selection.base_from_laser)
        _write_mounting(writer, mounting)
        for _ in range(plays):
            end_ns = start_ns
            for sweep in SweepStream(source, LogConfig()):
                _write_scan(writer, sweep, behind_ns)
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
                _write_mounting(writer, mounting)
            for sweep in stream:
                piece = int(np.searchsorted(bounds, sweep.stamp_ns, side="right")) - 1
                _write_scan(writers[min(max(piece, 0), len(outs) - 1)], sweep, 0)


def _write_mounting(writer: LogWriter, mounting: Pose2) -> None:
    level = np.zeros(1)
    turned = quaternions_from_rpy(level, level, np.array([mounting.theta]))[0].tolist()
    writer.static_transform("base_link", "laser", (mounting.x, mounting.y, 0.0), turned, 0)


def _write_scan(writer: LogWriter, sweep: Sweep, behind_ns: int) -> None:
    """A scan and its odometry, so many nanoseconds later."""
    stamp, planar = sweep.stamp_ns + behind_ns, sweep.planar
    writer.scan(
        "/scan",
        "laser",
        stamp,
        float(planar.bearings[0]),
        float(planar.bearings[1] - planar.bearings[0]),
        planar.ranges,
        range_max=planar.range_max,
    )
    if sweep.odom_from_base is not None:
        writer.odometry("/odom", "odom", "base_link", stamp, sweep.odom_from_base)
