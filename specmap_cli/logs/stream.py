"""The stream of sweeps that registration reads: one scan in memory at a time.

A scan waits for the odometry that follows its stamp, but never longer than a few scans.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import NamedTuple

from specmap_cli.core.config import LogConfig
from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import Sweep
from specmap_cli.logs.clouds import cloud_points
from specmap_cli.logs.messages import (
    BadMessageError,
    CloudRecord,
    ScanRecord,
    decode_odometry,
    decode_scan,
    decode_transforms,
)
from specmap_cli.logs.planar import CloudFlattener, Mount, ScanLeveller
from specmap_cli.logs.readers.recording import Log, Message
from specmap_cli.logs.selection import Selection, select
from specmap_cli.logs.transforms import OdometryBuffer

MAX_WAITING = 4  # scans held back for odometry
MAX_WAIT_NS = 500_000_000  # of log time


class _Waiting(NamedTuple):
    """A decoded scan and when it was recorded."""

    record: ScanRecord | CloudRecord
    stamp_ns: int
    time_ns: int


class SweepStream:
    """Iterable of the sweeps of a log; every iteration reads the log anew.

    `selection` says what was chosen; `expected` is the number of scans on the topic; `counts` and
    `warnings` are of the iteration so far. Raises what `selection.select` raises.
    """

    def __init__(self, log: Log, config: LogConfig) -> None:
        self.log = log
        self.config = config
        self.selection: Selection = select(log, config)
        self.counts = _no_counts()

    @property
    def expected(self) -> int:
        """How many scans the topic holds, usable or not."""
        return self.selection.scans

    @property
    def warnings(self) -> list[str]:
        """What to know about the input: assumptions, and messages that were not as they should."""
        said = [
            ("unusable_scans", "scans that could not be read and were left out"),
            ("blank_scans", "scans without any return"),
            ("without_odometry", "scans without odometry near their stamp"),
            ("backward_stamps", "scans stamped before the one ahead of them"),
            ("repeated_stamps", "scans that repeat the stamp of the one ahead of them"),
            ("unusable_odometry", "odometry messages that could not be read and were left out"),
        ]
        found = [f"{text}: {self.counts[key]:,}" for key, text in said if self.counts[key]]
        return [*self.log.damage, *self.selection.warnings, *found]

    def __iter__(self) -> Iterator[Sweep]:
        """The sweeps in the order of the log."""
        self.counts = _no_counts()
        assembly = _Assembly(self.selection, self.config, self.counts)
        topics = [self.selection.scan_topic, *self.selection.odom_topics]
        waiting: deque[_Waiting] = deque()
        for message in self.log.messages(topics):
            if message.topic == self.selection.scan_topic:
                waiting.extend(assembly.take_scan(message))
            else:
                assembly.take_odometry(message)
            while waiting and assembly.ready(waiting, message.time_ns):
                yield from assembly.sweep(waiting.popleft())
        while waiting:
            yield from assembly.sweep(waiting.popleft())


def _no_counts() -> dict[str, int]:
    keys = "scans unusable_scans blank_scans without_odometry backward_stamps repeated_stamps"
    return dict.fromkeys([*keys.split(), "odometry", "unusable_odometry"], 0)


class _Assembly:
    """One pass over a log: the odometry heard so far, and how scans become sweeps."""

    def __init__(self, selection: Selection, config: LogConfig, counts: dict[str, int]) -> None:
        self.selection = selection
        self.config = config
        self.counts = counts
        self.odometry = OdometryBuffer()
        self.mount = Mount.from_matrix(selection.base_from_laser)
        self.leveller = ScanLeveller(self.mount)
        self.flattener = CloudFlattener(selection.base_from_laser, selection.floor_m, config)
        self.tree = selection.tree.copy()
        self._chain = set(self.tree.ancestors(selection.base_frame))
        self._last_stamp: int | None = None

    def take_scan(self, message: Message) -> Iterator[_Waiting]:
        """The scan in a message, nothing when it cannot be read."""
        try:
            record = decode_scan(message)
        except BadMessageError:
            self.counts["unusable_scans"] += 1
            return
        stamp = message.time_ns if self.selection.use_log_time else record.stamp_ns
        yield _Waiting(record, stamp, message.time_ns)

    def take_odometry(self, message: Message) -> None:
        """Remember the odometry in a message."""
        try:
            if self.selection.odometry == "tf":
                self._take_transforms(message)
            else:
                self._take_pose(message)
        except BadMessageError:
            self.counts["unusable_odometry"] += 1

    def _take_pose(self, message: Message) -> None:
        record = decode_odometry(message)
        odom_from_base: FloatArray | None = record.frame_from_child
        if record.child and record.child != self.selection.base_frame:
            child_from_base = self.tree.lookup(record.child, self.selection.base_frame)
            if child_from_base is not None:
                odom_from_base = record.frame_from_child @ child_from_base
        self._remember(record.stamp_ns, message.time_ns, odom_from_base)

    def _take_transforms(self, message: Message) -> None:
        """Follow the chain from the odometry frame to the base; its first link sets the time."""
        odom, base = self.selection.odom_frame or "", self.selection.base_frame
        for record in decode_transforms(message):
            if record.child not in self._chain:
                continue
            self.tree.add(record, dynamic=True)
            if record.parent == odom:
                pose = self.tree.lookup(odom, base)
                self._remember(record.stamp_ns, message.time_ns, pose)

    def _remember(self, stamp_ns: int, time_ns: int, odom_from_base: FloatArray | None) -> None:
        if odom_from_base is None:
            return
        self.counts["odometry"] += 1
        unstamped = self.selection.use_log_time or stamp_ns == 0
        self.odometry.add(time_ns if unstamped else stamp_ns, Pose2.from_matrix(odom_from_base))

    def ready(self, waiting: deque[_Waiting], now_ns: int) -> bool:
        """Whether the first waiting scan has its odometry, or has waited long enough."""
        if self.selection.odometry is None or len(waiting) > MAX_WAITING:
            return True
        first = waiting[0]
        latest = self.odometry.latest_ns
        heard = latest is not None and latest >= first.stamp_ns
        return heard or now_ns - first.time_ns > MAX_WAIT_NS

    def sweep(self, scan: _Waiting) -> Iterator[Sweep]:
        """The sweep of a scan, nothing when the scan is unusable."""
        try:
            if isinstance(scan.record, CloudRecord):
                sweep = self._from_cloud(scan.record, scan.stamp_ns)
            else:
                sweep = self._from_scan(scan.record, scan.stamp_ns)
        except BadMessageError:
            self.counts["unusable_scans"] += 1
            return
        self._count(sweep)
        yield sweep

    def _from_scan(self, record: ScanRecord, stamp_ns: int) -> Sweep:
        planar = self.leveller.level(record, stamp_ns)
        odometry = self.odometry.at(stamp_ns)
        index = self.counts["scans"]
        return Sweep(index, stamp_ns, planar, self.mount.base_from_laser, odometry)

    def _from_cloud(self, record: CloudRecord, stamp_ns: int) -> Sweep:
        points, times = cloud_points(record, stamp_ns, self.config.cloud_range_max_m)
        if not len(points):
            raise BadMessageError("a cloud without points")
        base_from_laser = self.selection.base_from_laser
        cloud = points @ base_from_laser[:3, :3].T + base_from_laser[:3, 3]
        planar = self.flattener.flatten(cloud, stamp_ns)
        odometry = self.odometry.at(stamp_ns)
        index = self.counts["scans"]
        return Sweep(index, stamp_ns, planar, self.flattener.mount, odometry, cloud, times)

    def _count(self, sweep: Sweep) -> None:
        counts, last = self.counts, self._last_stamp
        counts["scans"] += 1
        counts["blank_scans"] += not (sweep.planar.ranges < float("inf")).any()
        if self.selection.odometry is not None:
            counts["without_odometry"] += sweep.odom_from_base is None
        if last is not None:
            counts["backward_stamps"] += sweep.stamp_ns < last
            counts["repeated_stamps"] += sweep.stamp_ns == last
        self._last_stamp = sweep.stamp_ns
