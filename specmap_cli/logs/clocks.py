"""What stamps are worth: which times stamp the sweeps, and where the odometry has another clock.

Header stamps are used while they say anything. A driver that never sets them, or sets all to one
value, leaves the recorder's times; where these say nothing either, the order of the scans remains.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import islice, pairwise
from statistics import median_low
from typing import Literal

from specmap_cli.core.text import nanoseconds
from specmap_cli.logs.messages import (
    BadMessageError,
    TransformRecord,
    decode_odometry,
    decode_scan,
    decode_transforms,
)
from specmap_cli.logs.opening import Log
from specmap_cli.logs.readers.encoding import TF_MESSAGE
from specmap_cli.logs.readers.recording import Message
from specmap_cli.logs.sensors import ScanSensor

_ASCENDING_SHARE = 0.25  # share of stamps that must follow the one ahead, or they are of no use
_ORDER_INTERVAL_S = 0.1  # between scans stamped by order: a usual laser's 10 Hz
# Scans stamped by order are so far apart that a robot this fast drives the first steps.
_ORDER_SPEED_MPS = 0.5
_LATE_S = 0.5  # odometry stamped this far from scans recorded beside it is told of
_PERIODS = 1.5  # of odometry, in which the next message comes: it may be half of one late
_CLOCKS_APART_S = 2.0  # odometry stamped this far from scans recorded beside it has another clock
_DISORDER_S = 2.0  # stamped and recorded so much too late it is none: the clock was set back
_RECENT = 100  # scans that one out of order may belong before
_MOST_SET_BACK = 2  # steps back of a clock that is set; more of them are scans out of order
_LATER = 1.5  # no scans show how late others can come: it may be half as much again
_FEWEST = 3  # stamps: two that are equal may be a scan that was sent twice
_PAIRS = 20  # of scans and odometry: their median does not heed some late messages
_LONGEST_S = 60.0  # between scans stamped by order: a longer step is no driving
MOST_MESSAGES = 5_000  # read for their stamps: odometry at 1 kHz for 5 s

OdometryKind = Literal["topic", "tf"]
TimeSource = Literal["header", "recorder", "order"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Clock:
    """What stamps the scans: header stamps, the recorder's times, or the order of the scans.

    By order the n-th scan has the stamp `first_ns + n * interval_ns`, and the odometry that was
    heard last. `odometry_shift_ns` is added to header stamps of odometry, which then are of the
    scans' clock. `odometry_apart_ns` is how far these are behind those of scans recorded beside
    them, where odometry that is recorded late looks the same as another clock. Odometry newer than
    a scan is due `odometry_wait_ns` after it, and so long as `scan_wait_ns` a scan stamped before
    it may come. `zero_is_unset` says that a header stamp of zero stands for the recorder's time, as
    the two clocks otherwise agree. `why` is the fault of the header stamps, if they have one.
    """

    source: TimeSource = "header"
    why: str = ""
    zero_is_unset: bool = False
    first_ns: int = 0
    interval_ns: int = 0
    odometry_shift_ns: int = 0
    odometry_apart_ns: int = 0
    odometry_wait_ns: int = 0
    scan_wait_ns: int = 0

    def scan_ns(self, number: int, stamp_ns: int, time_ns: int) -> int:
        """The stamp of the scan of that number with these header and recorder's times."""
        if self.source == "order":
            return self.first_ns + number * self.interval_ns
        unset = self.zero_is_unset and stamp_ns == 0
        return time_ns if self.source == "recorder" or unset else stamp_ns

    def odometry_ns(self, stamp_ns: int, time_ns: int) -> int:
        """The stamp of odometry; a header stamp of zero is none."""
        if self.source != "header" or stamp_ns == 0:
            return time_ns
        return stamp_ns + self.odometry_shift_ns


@dataclass(slots=True)
class Disorder:
    """How late scans come, as far as a log has shown: `wait_ns` after one, by the recorder's times.

    One stamped before it may come so long. A clock that is set back is no disorder: of few steps
    back in time nothing is thought.
    """

    wait_ns: int = 0
    _recent: deque[tuple[int, int]] = field(default_factory=lambda: deque(maxlen=_RECENT))
    _ahead_ns: int = 0
    _late_ns: int = 0
    _steps_back: int = 0

    def take(self, stamp_ns: int, time_ns: int) -> None:
        """The next scan, with its stamp and the recorder's time."""
        if stamp_ns < self._ahead_ns:
            self._steps_back += 1
            most_ns = nanoseconds(_DISORDER_S)
            late = (
                time_ns - time
                for stamp, time in self._recent
                if stamp_ns < stamp
                and time < time_ns
                and stamp - stamp_ns + time_ns - time < most_ns
            )
            self._late_ns = max(self._late_ns, *late, 0)
            if self._steps_back > _MOST_SET_BACK:
                self.wait_ns = max(self.wait_ns, round(_LATER * self._late_ns))
        self._ahead_ns = stamp_ns
        self._recent.append((stamp_ns, time_ns))


@dataclass(frozen=True, slots=True)
class StampPair:
    """Odometry and the scan recorded next: header stamp and recorder's time of each, ns.

    `place` is (x, y) by the odometry, metres.
    """

    odometry: tuple[int, int]
    scan: tuple[int, int]
    place: tuple[float, float] = (0.0, 0.0)


def choose_clock(scans: Sequence[tuple[int, int]], pairs: Sequence[StampPair]) -> Clock:
    """The clock of a log by the stamps and times of its sensor's first scans, and the odometry.

    Where header stamps say nothing, it is the recorder's, or the order of the scans where its times
    say nothing either. Stamps that never step back, such as whole seconds, still give the first
    stamp and the rate of that order. Otherwise scans are so far apart in time that the robot can
    have driven from one to the next.
    """
    stamps, times = [stamp for stamp, _ in scans], [time for _, time in scans]
    if not _ascends(stamps):
        why = "header stamps do not ascend" if any(stamps) else "header stamps are zero"
        if _ascends(times) or len(times) < _FEWEST:
            return Clock(source="recorder", why=why)
        known = stamps if any(stamps) else times
        mean = (known[-1] - known[0]) // (len(known) - 1)
        steady = mean > 0 and all(b >= a for a, b in pairwise(known))
        step = max((math.dist(a.place, b.place) for a, b in pairwise(pairs)), default=0.0)
        driving_s = min(step / _ORDER_SPEED_MPS, _LONGEST_S)
        interval = mean if steady else nanoseconds(max(_ORDER_INTERVAL_S, driving_s))
        return Clock(source="order", why=why, first_ns=max(known[0], 0), interval_ns=interval)
    apart = nanoseconds(_CLOCKS_APART_S)
    near = [abs(stamp - time) <= apart for stamp, time in zip(stamps, times, strict=True) if stamp]
    disorder = Disorder()
    for stamp, time in scans:
        disorder.take(stamp, time)
    header = Clock(zero_is_unset=2 * sum(near) > len(near), scan_wait_ns=disorder.wait_ns)
    # a message counts once, with the first scan after it: in a burst many scans follow one message
    told = list({pair.odometry: pair for pair in reversed(pairs) if pair.odometry[0] != 0}.values())
    if not told:
        return header
    if len(told) >= _FEWEST and len({pair.odometry[0] for pair in told}) == 1:
        same = "header stamps of the odometry are all the same"
        return Clock(source="recorder", why=same) if _ascends(times) else header
    # how far the clock of the scans is ahead of that of the odometry
    differences = [
        pair.scan[0] - pair.odometry[0] - (pair.scan[1] - pair.odometry[1]) for pair in told
    ]
    ahead = median_low(differences)
    if abs(ahead) > apart:
        return replace(header, odometry_shift_ns=ahead)
    if len(told) < 2:
        return header
    steady = len(told) >= _FEWEST and all(
        2 * abs(each - ahead) < abs(ahead) for each in differences
    )  # not in bursts
    period = median_low(b - a for a, b in pairwise(sorted(pair.odometry[0] for pair in told)))
    late = ahead if steady else 0
    return replace(
        header,
        odometry_wait_ns=round(_PERIODS * period) + max(0, late),
        odometry_apart_ns=late if abs(late) > nanoseconds(_LATE_S) else 0,
    )


def _ascends(stamps: Sequence[int]) -> bool:
    """Whether stamps tell time: not all are zero, and enough are later than the one before."""
    if not any(stamps):
        return False
    ahead = sum(b > a for a, b in pairwise(stamps))
    return len(stamps) < _FEWEST or ahead >= _ASCENDING_SHARE * (len(stamps) - 1)


def stamp_pairs(
    log: Log,
    scan_topic: str,
    sensor: ScanSensor,
    odom_topics: Sequence[str],
    odom_frame: str | None,
) -> list[StampPair]:
    """The odometry ahead of each of the first scans of a sensor, in the order of the log."""
    found: list[StampPair] = []
    last: tuple[int, int] | None = None
    place = (0.0, 0.0)
    if not odom_topics:
        return found
    for message in islice(log.messages([scan_topic, *odom_topics]), MOST_MESSAGES):
        try:
            if message.topic != scan_topic:
                heard = odometry_of(message, odom_frame)
                if heard is not None:
                    last = heard.stamp_ns, message.time_ns
                    x, y = heard.parent_from_child[:2, 3].tolist()
                    place = x, y
            elif last is not None:
                record = decode_scan(message)
                if sensor.made(record):
                    found.append(StampPair(last, (record.stamp_ns, message.time_ns), place))
        except BadMessageError:
            continue
        if len(found) >= _PAIRS:
            break
    return found


def odometry_of(message: Message, odometry_frame: str | None) -> TransformRecord | None:
    """The odometry in a message, None in one of other transforms.

    Raises BadMessageError for a message that cannot be read.
    """
    if message.type != TF_MESSAGE:
        return decode_odometry(message)
    records = decode_transforms(message)[0]
    return next((record for record in records if record.parent == odometry_frame), None)
