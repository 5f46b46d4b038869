"""Writing recordings: ROS 2 messages in CDR, in an MCAP file that any ROS 2 tool opens.

The same calls give the same bytes. The file is written under a temporary name beside the target
and renamed when complete, so that an interrupted run leaves nothing that looks like a log.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType, Writer
from numpy.typing import ArrayLike

from specmap_cli import __version__
from specmap_cli.core.errors import Paths, path_of, paths_of
from specmap_cli.core.files import complete_file, refuse_existing
from specmap_cli.core.progress import Progress, Silent
from specmap_cli.core.settings import LogConfig
from specmap_cli.core.text import counted, legible
from specmap_cli.logs.opening import open_log
from specmap_cli.logs.readers import encoding
from specmap_cli.logs.readers.recording import TopicInfo, refused

CHUNK_BYTES = 512 * 1024  # what a reader holds in memory at once; compresses well from here on

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
    cannot be written, TypeError when `path` is none, ValueError for a message after `close`.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = path_of(path, "path")
        self._channels: dict[tuple[str, str], int] = {}
        self._schemas: dict[str, int] = {}
        self._is_open = True
        self._held = ExitStack()
        file = self._held.enter_context(complete_file(self.path))
        self._writer = Writer(file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
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
        fixed = encoding.Transform(parent, child, xyz, quaternion_xyzw)
        data = encoding.transforms_cdr(stamp_ns, [fixed])
        self.raw(encoding.TF_STATIC, encoding.TF_MESSAGE, data, stamp_ns)

    def transform(
        self, parent: str, child: str, stamp_ns: int, parent_from_child: encoding.Planar
    ) -> None:
        """A motion of the plane, (x, y, theta), at one time, on `/tf`."""
        moved = encoding.Transform(parent, child, *encoding.in_space(parent_from_child))
        data = encoding.transforms_cdr(stamp_ns, [moved])
        self.raw("/tf", encoding.TF_MESSAGE, data, stamp_ns)

    def odometry(
        self, topic: str, frame_id: str, child_frame_id: str, stamp_ns: int, pose: encoding.Planar
    ) -> None:
        """`pose` is frame_from_child, (x, y, theta), by dead reckoning: `nav_msgs/msg/Odometry`."""
        data = encoding.odometry_cdr(frame_id, child_frame_id, stamp_ns, pose)
        self.raw(topic, encoding.ODOMETRY, data, stamp_ns)

    def scan(
        self,
        topic: str,
        frame_id: str,
        stamp_ns: int,
        angle_min: float,
        angle_increment: float,
        ranges: ArrayLike,
        *,
        range_max: float,
        **rest: float,
    ) -> None:
        """One `sensor_msgs/msg/LaserScan` of ranges (B,) in metres: +inf = no return.

        `rest` are `range_min`, `time_increment` and `scan_time`, 0 unless they are given.
        """
        angles = angle_min, angle_increment
        data = encoding.scan_cdr(frame_id, stamp_ns, *angles, ranges, range_max=range_max, **rest)
        self.raw(topic, encoding.LASER_SCAN, data, stamp_ns)

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
        data = encoding.cloud_cdr(frame_id, stamp_ns, points, times_s)
        self.raw(topic, encoding.POINT_CLOUD, data, stamp_ns)

    def raw(self, topic: str, msgtype: str, cdr: bytes, log_time_ns: int) -> None:
        """A message already serialised as CDR; `msgtype` is a ROS 2 name, or ValueError says so."""
        if not self._is_open:
            raise ValueError(f"{self.path}: is closed: it takes no more messages")
        key = (topic, msgtype)
        if key not in self._channels:
            if msgtype not in self._schemas:
                definition = encoding.message_definition(msgtype)
                number = self._writer.register_schema(msgtype, "ros2msg", definition)
                self._schemas[msgtype] = number
            schema = self._schemas[msgtype]
            latched = {"offered_qos_profiles": _LATCHED} if topic == encoding.TF_STATIC else {}
            self._channels[key] = self._writer.register_channel(topic, "cdr", schema, latched)
        time_ns = max(int(log_time_ns), 0)  # the format has no times before 1970
        self._writer.add_message(self._channels[key], time_ns, cdr, time_ns)

    def close(self) -> None:
        """Complete the file and give it its name."""
        if self._is_open:
            self._is_open = False
            with self._held:
                self._writer.finish()  # type: ignore[no-untyped-call]

    def __enter__(self) -> LogWriter:
        return self

    def __exit__(self, kind: Any, error: BaseException | None, trace: Any) -> None:
        if error is None:
            self.close()
        self._is_open = False
        self._held.__exit__(kind, error, trace)


@dataclass(frozen=True, slots=True, kw_only=True)
class Conversion:
    """What was written, what was left out as no stage reads it, and what was lost to damage."""

    path: Path
    written: tuple[TopicInfo, ...]
    skipped: tuple[TopicInfo, ...]
    damage: tuple[str, ...]

    def lines(self) -> list[str]:
        """The result as lines for people."""
        total = sum(t.count for t in self.written)
        told = [f"wrote {self.path}: {counted(total, 'message')}"]
        told += [f"  {t.name}  {t.count:,}  {t.type}" for t in self.written]
        told += [
            f"left out {t.name}: {counted(t.count, 'message')} of {t.type}" for t in self.skipped
        ]
        return [legible(line) for line in told + [f"damage: {line}" for line in self.damage]]


def convert(
    paths: Paths,
    out: Path | str,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
    config: LogConfig | None = None,
) -> Conversion:
    """Write the scans, odometry and transforms of a log to the MCAP file `out`.

    `config` bounds what is unpacked, as in `open_log`. Messages keep their order, their topics and
    their header stamps; log times that step back become that of the message ahead. Raises
    UsageError when `out` exists (unless `overwrite`) or cannot be written, LogError when the log
    holds nothing to convert, TypeError for what is no path.
    """
    given, target = paths_of(paths, "paths"), path_of(out, "out")
    if not overwrite:
        refuse_existing(target)
    with open_log(given, config) as log:
        topics = log.topics()
        wanted = [t for t in topics if t.type in encoding.SUPPORTED_TYPES and t.count]
        if not wanted:
            there = ", ".join(f"{t.name} ({t.type})" for t in topics) or "no messages at all"
            nothing = f"no scans, odometry or transforms; it has {there}"
            raise refused(legible(log.name), legible(nothing))
        told = progress or Silent()
        told.start("converting", sum(topic.count for topic in wanted))
        counts: Counter[tuple[str, str]] = Counter()
        latest_ns = 0
        with LogWriter(target) as writer:
            for message in log.messages({topic.name for topic in wanted}):
                if message.type in encoding.SUPPORTED_TYPES:
                    # a reader of MCAP would take what steps back in log time away from its place
                    latest_ns = max(latest_ns, message.time_ns)
                    writer.raw(message.topic, message.type, message.data, latest_ns)
                    counts[message.topic, message.type] += 1
                    told.advance()
        return Conversion(
            path=target,
            written=tuple(TopicInfo(*key, counts[key]) for key in sorted(counts)),
            skipped=tuple(t for t in topics if t.type not in encoding.SUPPORTED_TYPES and t.count),
            damage=tuple(log.damage),
        )
