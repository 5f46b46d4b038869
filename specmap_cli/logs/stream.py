"""The stream of sweeps that registration reads: one scan in memory at a time.

A scan waits for the odometry that follows its stamp, but never longer than a few scans.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from specmap_cli.core.arguments import instance_of
from specmap_cli.core.geometry import Pose2, product
from specmap_cli.core.records import Sweep
from specmap_cli.core.settings import LogConfig
from specmap_cli.core.text import legible, nanoseconds
from specmap_cli.logs.clouds import CloudFlattener, Level, PointClock, cloud_points, floor_of
from specmap_cli.logs.messages import BadMessageError, CloudRecord, ScanRecord, decode_scan
from specmap_cli.logs.odometry import OdometryBuffer, OdometryListener
from specmap_cli.logs.opening import Log
from specmap_cli.logs.planar import (
    SCAN_TIME_MAX_S,
    Ceiling,
    OwnBody,
    ScanLeveller,
)
from specmap_cli.logs.readers.recording import Message
from specmap_cli.logs.selection import Selection, select

_ODOMETRY_WAIT_SCANS = 4  # a scan waits for later odometry until more scans than this wait
_ODOMETRY_WAIT_S = 0.5  # a scan waits for later odometry no longer than this, by log time

# What is counted beside the sweeps and the odometry, and what to say when it occurs.
_SAID = {
    "unusable_scans": "scans that could not be read and were left out",
    "other_sensor": "scans of another sensor on the topic that were left out",
    "blank_scans": "scans without any return",
    "far_times": "scans whose point times reach farther than a sweep lasts and were not used",
    "foreign_times": "scans whose point times have another clock than their stamps and were "
    "counted from the earliest point",
    "without_odometry": "scans without odometry near their stamp",
    "backward_stamps": "scans stamped before the one ahead of them",
    "unstamped_scans": "scans stamped zero, for which the recorder's times are used",
    "repeated_stamps": "scans that repeat the stamp of the one ahead of them",
    "unusable_odometry": "odometry messages that could not be read and were left out",
}

# What to do about it, and the share of the scans from which on it is worth a word: a drive begins
# and ends with a scan or two outside its odometry, and scan matching places them.
_ADVICE = {
    "without_odometry": "; scan matching alone places them: is the odometry of the same clock, and "
    "of the whole drive?"
}
_LEAST_SHARE = {"without_odometry": 0.01}
_COUNTED = ("scans", "odometry", *_SAID)


class SweepStream:
    """Iterable of the sweeps of a log; every iteration reads the log anew.

    `selection` says what was chosen; `expected` is the number of scans on the topic; `counts`,
    `ceiling`, `own_body` and `warnings` are of the iteration so far. Raises what `selection.select`
    raises, and TypeError for arguments that are no `Log` and `LogConfig`.
    """

    def __init__(self, log: Log, config: LogConfig) -> None:
        self.log = instance_of(log, Log, "log")
        self.config = instance_of(config, LogConfig, "config")
        self.selection: Selection = select(log, config)
        self.counts = dict.fromkeys(_COUNTED, 0)
        self.ceiling, self.own_body = Ceiling(), OwnBody()
        self._odometry = OdometryListener(self.selection)

    @property
    def expected(self) -> int:
        """How many scans the topic holds, usable or not."""
        return self.selection.topic.count

    @property
    def warnings(self) -> list[str]:
        """What to know about the input: assumptions, and messages that were not as they should."""
        found = [
            f"{text}: {self.counts[key]:,}{_ADVICE.get(key, '')}"
            for key, text in _SAID.items()
            if self.counts[key] > _LEAST_SHARE.get(key, 0.0) * self.counts["scans"]
        ]
        assumed = [legible(line) for line in self.selection.warnings]
        found += self._odometry.notes
        return [*self.log.damage, *assumed, *found, *self.ceiling.notes, *self.own_body.notes]

    def __iter__(self) -> Iterator[Sweep]:
        """The sweeps in the order of the log."""
        self.counts = counts = dict.fromkeys(_COUNTED, 0)
        chosen = self.selection
        self._odometry = odometry = OdometryListener(chosen)
        self.ceiling, self.own_body = Ceiling(chosen.ceilings_m), OwnBody()
        leveller = ScanLeveller(chosen.base_from_laser, self.ceiling, self.own_body)
        sweeps = _SweepMaker(chosen, self.config, counts, leveller)
        waiting: deque[_Waiting] = deque()
        for message in self.log.messages([chosen.topic.name, *chosen.odom_topics]):
            if message.topic == chosen.topic.name:
                waiting.extend(sweeps.decoded(message, odometry))
            else:
                try:
                    odometry.take(message)
                except BadMessageError:
                    counts["unusable_odometry"] += 1
                counts["odometry"] = odometry.heard
            while waiting:
                first, latest = waiting[0], odometry.poses.latest_ns
                heard = first.own is not None or (latest is not None and latest >= first.stamp_ns)
                late = message.time_ns - first.time_ns > nanoseconds(_ODOMETRY_WAIT_S)
                late |= len(waiting) > _ODOMETRY_WAIT_SCANS
                if not (chosen.odometry is None or heard or late):
                    break
                yield from sweeps.made(waiting.popleft(), odometry.poses)
        while waiting:
            yield from sweeps.made(waiting.popleft(), odometry.poses)


class _Waiting(NamedTuple):
    """A decoded scan, when it was recorded, and odom_from_base where the log ties one to it."""

    record: ScanRecord | CloudRecord
    stamp_ns: int
    time_ns: int
    own: Pose2 | None


class _SweepMaker:
    """One pass over a log: how its scans become sweeps. What it meets goes into `counts`."""

    def __init__(
        self,
        selection: Selection,
        config: LogConfig,
        counts: dict[str, int],
        leveller: ScanLeveller,
    ) -> None:
        self.selection = selection
        self.counts = counts
        self.leveller = leveller
        in_space = selection.band_m is not None
        self.flattener = CloudFlattener(
            selection.base_from_laser, selection.floor_m, config, planar=not in_space
        )
        # a cloud that shows no floor has the level of the one before it
        self._is_level = selection.floor_m is not None or not in_space
        self._level = Level(np.eye(3), None)
        self.points_clock = PointClock()
        self._last_stamp: int | None = None
        self._number = 0  # of the sensor's scans so far

    def decoded(self, message: Message, odometry: OdometryListener) -> Iterator[_Waiting]:
        """The scan in a message, nothing when it cannot be read or is of another sensor."""
        try:
            record = decode_scan(message)
        except BadMessageError:
            self.counts["unusable_scans"] += 1
            return
        chosen = self.selection
        if not chosen.sensor.made(record):
            self.counts["other_sensor"] += 1
            return
        clock = chosen.clock
        unset = clock.source == "header" and clock.zero_is_unset and record.stamp_ns == 0
        self.counts["unstamped_scans"] += unset
        stamp = clock.scan_ns(self._number, record.stamp_ns, message.time_ns)
        self._number += 1
        own = odometry.own(record.stamp_ns, message.time_ns)
        yield _Waiting(record, stamp, message.time_ns, own)

    def made(self, scan: _Waiting, odometry: OdometryBuffer) -> Iterator[Sweep]:
        """The sweep of a scan, nothing when the scan is unusable."""
        counts, last = self.counts, self._last_stamp
        try:
            if isinstance(scan.record, CloudRecord):
                sweep = self._from_cloud(scan.record, scan.stamp_ns)
            else:
                sweep = Sweep(
                    index=counts["scans"],
                    stamp_ns=scan.stamp_ns,
                    planar=self.leveller.level(scan.record, scan.stamp_ns),
                    base_from_laser=self.leveller.mount,
                )
                layout = scan.record.layout
                lasts_s = layout.time_increment * (layout.beams - 1)
                counts["far_times"] += lasts_s > SCAN_TIME_MAX_S
        except BadMessageError:
            counts["unusable_scans"] += 1
            return
        pose = odometry.at(scan.stamp_ns) if scan.own is None else scan.own
        counts["scans"] += 1
        counts["blank_scans"] += not np.isfinite(sweep.planar.ranges).any()
        if self.selection.odometry is not None:
            counts["without_odometry"] += pose is None
        if last is not None:
            counts["backward_stamps"] += scan.stamp_ns < last
            counts["repeated_stamps"] += scan.stamp_ns == last
        self._last_stamp = scan.stamp_ns
        yield replace(sweep, odom_from_base=pose)

    def _from_cloud(self, record: CloudRecord, stamp_ns: int) -> Sweep:
        points, times_s, far_times = cloud_points(record, stamp_ns, self.points_clock)
        if not len(points):
            raise BadMessageError("a cloud without points")
        self.counts["far_times"] += far_times
        self.counts["foreign_times"] = self.points_clock.foreign
        base_from_laser = self.selection.base_from_laser
        if not self._is_level:  # the log does not say how it lies: by the floor in the cloud
            self._level = floor_of(points) or self._level
        turn = product(self._level.rotation, base_from_laser[:3, :3])
        cloud = product(points, turn.T) + base_from_laser[:3, 3]
        in_space = self.selection.band_m is not None
        return Sweep(
            index=self.counts["scans"],
            stamp_ns=stamp_ns,
            planar=self.flattener.flatten(cloud, stamp_ns, self._level.floor_m, times_s),
            base_from_laser=self.flattener.mount,
            cloud=cloud if in_space else None,
            cloud_times_s=times_s if in_space else None,
        )
