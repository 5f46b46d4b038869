"""Odometry at the stamps of scans, from an Odometry topic or from transforms."""

from __future__ import annotations

from bisect import bisect_left
from typing import NamedTuple

from specmap_cli.core.geometry import FloatArray, Pose2, wrap_angle
from specmap_cli.core.text import legible, nanoseconds
from specmap_cli.logs.messages import BadMessageError, decode_odometry, decode_transforms
from specmap_cli.logs.readers.recording import Message
from specmap_cli.logs.selection import Selection

_ODOMETRY_GAP_S = 2.0  # poses farther apart are not interpolated between
_ODOMETRY_HOLD_S = 0.1  # the first and the last pose hold so long before and after it
_CLOCK_RESET_S = 10.0  # odometry stamped so far back means that the clock was set back
MAX_POSES = 8192  # kept at once: 8 s of odometry at 1 kHz, more than any scan waits for


class OdometryBuffer:
    """Odometry of the last while, interpolated at the stamps of scans.

    Poses may come in any order; only MAX_POSES are kept. A pose that lies `_CLOCK_RESET_S` or more
    back in time starts the buffer anew, as the clock was set back.
    """

    def __init__(self) -> None:
        self._gap_ns = nanoseconds(_ODOMETRY_GAP_S)
        self._hold_ns = nanoseconds(_ODOMETRY_HOLD_S)
        self._reset_ns = nanoseconds(_CLOCK_RESET_S)
        self._stamps: list[int] = []
        self._poses: list[Pose2] = []

    def __len__(self) -> int:
        return len(self._stamps)

    @property
    def latest_ns(self) -> int | None:
        """The latest stamp, None while empty."""
        return self._stamps[-1] if self._stamps else None

    def add(self, stamp_ns: int, pose: Pose2) -> None:
        """Take in odom_from_base at a stamp; a repeated stamp replaces the pose."""
        if self._stamps and stamp_ns < self._stamps[-1] - self._reset_ns:
            self._stamps.clear()
            self._poses.clear()
        place = bisect_left(self._stamps, stamp_ns)
        if place < len(self._stamps) and self._stamps[place] == stamp_ns:
            self._poses[place] = pose
            return
        self._stamps.insert(place, stamp_ns)
        self._poses.insert(place, pose)
        if len(self._stamps) > MAX_POSES:
            del self._stamps[: MAX_POSES // 2]
            del self._poses[: MAX_POSES // 2]

    def at(self, stamp_ns: int) -> Pose2 | None:
        """odom_from_base at a stamp, None where the odometry has a hole or does not reach."""
        place = bisect_left(self._stamps, stamp_ns)
        if place < len(self._stamps) and self._stamps[place] == stamp_ns:
            return self._poses[place]
        if place in (0, len(self._stamps)):  # the first or last pose when it is near enough in time
            nearest = max(place - 1, 0)
            near = self._stamps and abs(self._stamps[nearest] - stamp_ns) <= self._hold_ns
            return self._poses[nearest] if near else None
        before, after = self._stamps[place - 1], self._stamps[place]
        if after - before > self._gap_ns:
            return None
        share = (stamp_ns - before) / (after - before)
        return interpolated(self._poses[place - 1], self._poses[place], share)


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
        self._tree = selection.tree.copy()
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
            joined = record.child == base or child_from_base is not None
            self._compare((record.parent, record.child), joined=joined)
            heard.append((record.stamp_ns, odom_from_base))
        else:
            transforms = decode_transforms(message)
            for record in transforms.records:  # the chain to the base: its first link sets the time
                if record.child in self._chain:
                    self._tree.add(record, dynamic=True)
                    if record.parent == odom:
                        heard.append((record.stamp_ns, self._tree.lookup(odom, base)))
            absurd = [child for _, child in transforms.absurd if child in self._chain]
        for stamp_ns, pose in heard:
            if pose is not None:
                self.heard += 1
                self.last = Heard(stamp_ns, message.time_ns, Pose2.from_matrix(pose))
                known_ns = selection.clock.odometry_ns(stamp_ns, message.time_ns)
                self.poses.add(known_ns, self.last.pose)
        if absurd:
            raise BadMessageError(f"the transform of {absurd[0]!r} is not finite or absurd")

    def _compare(self, frames: tuple[str, str], *, joined: bool) -> None:
        """Count odometry between other frames than those of the first message."""
        self._frames = self._frames or [frames]
        if frames != (first := self._frames[0]) and not (joined and frames[0] == first[0]):
            self._frames = [first, *self._frames[1:], frames][:2]
            self.renamed += 1

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


def interpolated(a: Pose2, b: Pose2, share: float) -> Pose2:
    """The pose a share of the way from `a` (0) to `b` (1)."""
    turn = wrap_angle(b.theta - a.theta)
    return Pose2(
        a.x + share * (b.x - a.x),
        a.y + share * (b.y - a.y),
        wrap_angle(a.theta + share * turn),
    )
