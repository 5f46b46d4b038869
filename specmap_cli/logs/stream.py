"""The stream of sweeps that registration reads: one scan in memory at a time.

Each has the odometry at its stamp, from a topic or from transforms. A scan waits for the odometry
that follows its stamp, but never longer than a few scans; once scans were recorded out of order,
for those stamped before it, too.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from specmap_cli.core.errors import instance_of
from specmap_cli.core.geometry import FloatArray, Pose2, product, wrap_angle
from specmap_cli.core.records import Sweep
from specmap_cli.core.settings import LogConfig
from specmap_cli.core.text import legible, nanoseconds
from specmap_cli.logs.clocks import Disorder
from specmap_cli.logs.clouds import CloudFlattener, Level, PointClock, cloud_points, floor_of
from specmap_cli.logs.messages import (
    BadMessageError,
    CloudRecord,
    ScanRecord,
    decode_odometry,
    decode_scan,
    decode_transforms,
)
from specmap_cli.logs.opening import Log
from specmap_cli.logs.planar import SCAN_TIME_MAX_S, Ceiling, OwnBody, ScanLeveller
from specmap_cli.logs.readers.recording import Message
from specmap_cli.logs.selection import Selection, select

_ODOMETRY_GAP_S = 2.0  # poses farther apart are not interpolated between
_ODOMETRY_HOLD_S = 0.1  # the first and the last pose hold so long before and after it
_CLOCK_RESET_S = 10.0  # odometry stamped so far back means that the clock was set back
MAX_POSES = 8192  # kept at once: 8 s of odometry at 1 kHz, more than any scan waits for


class OdometryBuffer:
    """Odometry of the last while, interpolated at the stamps of scans; its own `stamps_ns` ascend.

    Poses may come in any order; only MAX_POSES are kept. A pose that lies `_CLOCK_RESET_S` or more
    back in time starts the buffer anew, as the clock was set back.
    """

    def __init__(self) -> None:
        self.stamps_ns: list[int] = []
        self._poses: list[Pose2] = []

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def add(self, stamp_ns: int, pose: Pose2) -> None:
        """Take in odom_from_base at a stamp; a repeated stamp replaces the pose."""
        if self.stamps_ns and stamp_ns < self.stamps_ns[-1] - nanoseconds(_CLOCK_RESET_S):
            self.stamps_ns.clear()
            self._poses.clear()
        place = bisect_left(self.stamps_ns, stamp_ns)
        if place < len(self.stamps_ns) and self.stamps_ns[place] == stamp_ns:
            self._poses[place] = pose
            return
        self.stamps_ns.insert(place, stamp_ns)
        self._poses.insert(place, pose)
        if len(self.stamps_ns) > MAX_POSES:
            del self.stamps_ns[: MAX_POSES // 2]
            del self._poses[: MAX_POSES // 2]

    def at(self, stamp_ns: int) -> Pose2 | None:
        """odom_from_base at a stamp, None where the odometry has a hole or does not reach."""
        stamps = self.stamps_ns
        place = bisect_left(stamps, stamp_ns)
        if place < len(stamps) and stamps[place] == stamp_ns:
            return self._poses[place]
        if place in (0, len(stamps)):  # the first or last pose when it is near enough in time
            nearest, hold_ns = max(place - 1, 0), nanoseconds(_ODOMETRY_HOLD_S)
            near = stamps and abs(stamps[nearest] - stamp_ns) <= hold_ns
            return self._poses[nearest] if near else None
        before, after = stamps[place - 1], stamps[place]
        if after - before > nanoseconds(_ODOMETRY_GAP_S):
            return None
        share = (stamp_ns - before) / (after - before)
        a, b = self._poses[place - 1], self._poses[place]
        theta = wrap_angle(a.theta + share * wrap_angle(b.theta - a.theta))
        return Pose2(a.x + share * (b.x - a.x), a.y + share * (b.y - a.y), theta)


class Heard(NamedTuple):
    """Odometry as it was heard: its header stamp, the recorder's time, odom_from_base."""

    stamp_ns: int
    time_ns: int
    pose: Pose2


class OdometryListener:
    """The odometry of one pass over a log: messages in, the base at the stamps of scans out.

    `poses` is what was heard so far, `heard` how many poses that were, `last` the last of them,
    `renamed` how many had other frames than the first, which no transform joins.
    """

    def __init__(self, selection: Selection) -> None:
        self.selection = selection
        self.poses = OdometryBuffer()
        self.heard = 0
        self.last: Heard | None = None
        self.renamed = 0
        self._frames: list[tuple[str, str]] = []  # (parent, child) of the first, and of another
        self._tree = deepcopy(selection.tree)
        self._chain = frozenset(self._tree.ancestors(selection.base_frame))

    def take(self, message: Message) -> None:
        """Remember the odometry in a message; raises BadMessageError when it cannot be read."""
        selection = self.selection
        odom, base = selection.odom_frame or "", selection.base_frame
        heard: list[tuple[int, FloatArray | None]] = []  # header stamps, odom_from_base
        absurd: list[str] = []
        if selection.odometry == "topic":
            record = decode_odometry(message)
            odom_from_base, child_from_base = record.parent_from_child, None
            if record.child and record.child != base:
                child_from_base = self._tree.lookup(record.child, base)
            if child_from_base is not None:
                odom_from_base = record.parent_from_child @ child_from_base
            frames = record.parent, record.child
            self._frames = self._frames or [frames]
            joined = record.child == base or child_from_base is not None
            if frames != (first := self._frames[0]) and not (joined and frames[0] == first[0]):
                self._frames = [first, *self._frames[1:], frames][:2]
                self.renamed += 1
            heard.append((record.stamp_ns, odom_from_base))
        else:
            records, left_out = decode_transforms(message)
            for record in records:  # the chain to the base: its first link sets the time
                if record.child in self._chain:
                    self._tree.add(record, dynamic=True)
                    if record.parent == odom:
                        heard.append((record.stamp_ns, self._tree.lookup(odom, base)))
            absurd = [child for _, child in left_out if child in self._chain]
        for stamp_ns, pose in heard:
            if pose is not None:
                self.heard += 1
                self.last = Heard(stamp_ns, message.time_ns, Pose2.from_matrix(pose))
                known_ns = selection.clock.odometry_ns(stamp_ns, message.time_ns)
                self.poses.add(known_ns, self.last.pose)
        if absurd:
            raise BadMessageError(f"the transform of {absurd[0]!r} is not finite or absurd")

    @property
    def notes(self) -> list[str]:
        """What to know of the frames of the odometry; nothing where they stay the same."""
        if not self.renamed:
            return []
        first, other = (f"{parent!r} -> {child!r}" for parent, child in self._frames)
        return [
            f"the odometry moves {legible(first)}, but in {self.renamed:,} later messages other "
            f"frames, such as {legible(other)}: they are taken to be the same"
        ]

    def own(self, stamp_ns: int, time_ns: int) -> Pose2 | None:
        """odom_from_base of a scan with these header and recorder's times, by the order of the log.

        Odometry with the very times of the scan behind it, such as that of a CARMEN line, belongs
        to this scan, whatever the stamps are. Scans that are stamped by their order have the
        odometry heard last.
        """
        if self.last is None:
            return None
        same = (self.last.stamp_ns, self.last.time_ns) == (stamp_ns, time_ns)
        by_order = self.selection.clock.source == "order"
        return self.last.pose if same or by_order else None


# A scan waits for later odometry until more scans than this wait, and no longer than this by log
# time; longer, up to so many, where the log begins with odometry that takes longer to come.
_ODOMETRY_WAIT_SCANS, _MOST_WAITING = 4, 64
_ODOMETRY_WAIT_S = 0.5

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

    `selection` says what was chosen; `counts`, `ceiling`, `own_body` and `warnings` are of the
    iteration so far. Raises what `selection.select` raises, and TypeError for arguments that are no
    `Log` and `LogConfig`.
    """

    def __init__(self, log: Log, config: LogConfig | None = None) -> None:
        self.log = instance_of(log, Log, "log")
        self.config = instance_of(LogConfig() if config is None else config, LogConfig, "config")
        self.selection: Selection = select(log, self.config)
        self.counts = dict.fromkeys(_COUNTED, 0)
        self.ceiling, self.own_body = Ceiling(), OwnBody()
        self._odometry = OdometryListener(self.selection)

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
        expected_ns = min(chosen.clock.odometry_wait_ns, nanoseconds(_ODOMETRY_GAP_S))
        disorder = Disorder(chosen.clock.scan_wait_ns)
        for message in self.log.messages([chosen.topic.name, *chosen.odom_topics]):
            if message.topic == chosen.topic.name:
                for scan in sweeps.decoded(message, odometry):
                    disorder.take(scan.stamp_ns, scan.time_ns)
                    place, most_ns = len(waiting), disorder.wait_ns
                    while place and 0 < waiting[place - 1].stamp_ns - scan.stamp_ns <= most_ns:
                        place -= 1
                    waiting.insert(place, scan)
            else:
                try:
                    odometry.take(message)
                except BadMessageError:
                    counts["unusable_odometry"] += 1
                counts["odometry"] = odometry.heard
            while waiting:
                first, known_ns = waiting[0], odometry.poses.stamps_ns
                heard = first.own is not None or bool(known_ns and first.stamp_ns <= known_ns[-1])
                waited_ns = message.time_ns - first.time_ns
                many = len(waiting) > _ODOMETRY_WAIT_SCANS
                late = many or waited_ns > nanoseconds(_ODOMETRY_WAIT_S)
                late &= waited_ns > expected_ns or len(waiting) > _MOST_WAITING
                early = 0 <= waited_ns < disorder.wait_ns and len(waiting) <= _MOST_WAITING
                if early or not (chosen.odometry is None or heard or late):
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
        has_height = selection.band_m is not None
        self.flattener = CloudFlattener(
            *(selection.base_from_laser, selection.floor_m, config, leveller.own_body),
            planar=not has_height,
        )
        self._is_level = selection.floor_m is not None or not has_height
        self._level: Level | None = None  # of the latest cloud that showed a floor
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
        self.counts["far_times"] += far_times
        self.counts["foreign_times"] = self.points_clock.foreign
        base_from_laser, floor_m = self.selection.base_from_laser, None
        turn, place = base_from_laser[:3, :3], base_from_laser[:3, 3]
        if not self._is_level:  # the log says wrongly how it lies, or not: the floor tells
            self._level = floor_of(product(points, turn.T)) or self._level
        if self._level is not None:
            turn = product(self._level.rotation, turn)
            floor_m = self._level.floor_m + float(place[2])
        cloud = product(points, turn.T) + place
        in_space = self.selection.in_space
        return Sweep(
            index=self.counts["scans"],
            stamp_ns=stamp_ns,
            planar=self.flattener.flatten(cloud, stamp_ns, floor_m, times_s),
            base_from_laser=self.flattener.mount,
            cloud=cloud if in_space else None,
            cloud_times_s=times_s if in_space else None,
        )
