"""CARMEN logs: lines of FLASER, RLASER, ROBOTLASER1 and ODOM, read as ROS 2 messages.

Each laser line becomes a LaserScan on `/flaser`, `/rlaser` or `/robotlaser1`, preceded by an
Odometry with the robot's own pose of that line on `/odom`, where ODOM lines go too; so a scan
always has odometry at its very stamp. Stamps are the lines' `ipc_timestamp`, or
`logger_timestamp` where that is zero. The mounting of a laser, the difference of the two poses on
its lines where it is the same on all of them, comes first on `/tf_static`.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.logs.readers.encoding import odometry_cdr, placed, scan_cdr, transform_cdr
from specmap_cli.logs.readers.recording import (
    Contents,
    Message,
    Recording,
    TopicInfo,
    seconds,
    survey,
    unreadable,
)
from specmap_cli.logs.readers.typestore import LASER_SCAN, NS_PER_S, ODOMETRY, TF_MESSAGE

KEYWORDS = ("FLASER", "RLASER", "ROBOTLASER1", "ODOM")
ODOM_FRAME, BASE_FRAME = "odom", "base_link"
ODOM_TOPIC, TF_STATIC = "/odom", "/tf_static"
RANGE_MAX_M = 80.0  # FLASER lines do not say; readings from here on mean no return
_MAX_LINE_BYTES = 1 << 20
_SAME_MOUNT_M, _SAME_MOUNT_RAD = 0.01, 0.01

# Field of view of FLASER lines by their number of beams; all others cover 180 degrees.
_FIELDS_OF_VIEW = {541: 270.0, 1081: 270.0, 682: 239.41, 683: 239.77}


class _Line(NamedTuple):
    """One parsed line; `scan` is None for ODOM."""

    topic: str
    stamp_ns: int
    odom_from_base: Pose2
    odom_from_laser: Pose2 | None = None
    angle_min: float = 0.0
    angle_increment: float = 0.0
    range_max: float = 0.0
    ranges: FloatArray | None = None

    @property
    def frame(self) -> str:
        return self.topic.strip("/")


class CarmenFile(Recording):
    """One CARMEN log."""

    format = "CARMEN log"

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        try:
            self._file = path.open("rb")
        except OSError as error:
            raise unreadable(path, error) from None

    @property
    def contents(self) -> Contents:
        """From one pass over the file, as there is no index."""
        return self._survey[0]

    @cached_property
    def _survey(self) -> tuple[Contents, dict[str, Pose2]]:
        """The contents, and base_from_laser by topic of lasers whose lines all give the same."""
        compared: dict[str, Pose2 | None] = {}
        contents = survey(self._entries(compared))
        mounts = {topic: mount for topic, mount in compared.items() if mount is not None}
        if mounts:
            placings = TopicInfo(TF_STATIC, TF_MESSAGE, len(mounts))
            contents = replace(contents, topics=(*contents.topics, placings))
        return contents, mounts

    def _entries(self, mounts: dict[str, Pose2 | None]) -> Iterator[tuple[str, str, int]]:
        """Topic, type and time of every message but the mountings, which go into `mounts`."""
        for line in self._lines():
            yield ODOM_TOPIC, ODOMETRY, line.stamp_ns
            if line.odom_from_laser is not None:
                yield line.topic, LASER_SCAN, line.stamp_ns
                mount = line.odom_from_base.inverse() @ line.odom_from_laser
                known = mounts.setdefault(line.topic, mount)
                if known is not None and not _same(known, mount):
                    mounts[line.topic] = None  # someone corrected the laser's poses

    @property
    def _mounts(self) -> dict[str, Pose2]:
        return self._survey[1]

    def messages(self, topics: Collection[str] | None = None) -> Iterator[Message]:
        """The messages on `topics`, in the order of the lines."""
        started: set[str] = set()  # lasers whose mounting has been told
        for line in self._lines():
            if line.ranges is not None and line.topic not in started:
                started.add(line.topic)
                if line.topic in self._mounts and _wanted(TF_STATIC, topics):
                    yield self._mounting(line)
            if _wanted(ODOM_TOPIC, topics):
                data = odometry_cdr(ODOM_FRAME, BASE_FRAME, line.stamp_ns, line.odom_from_base)
                yield Message(ODOM_TOPIC, ODOMETRY, line.stamp_ns, data)
            if line.ranges is not None and _wanted(line.topic, topics):
                yield _scan(line, line.ranges)

    def _mounting(self, line: _Line) -> Message:
        mount = placed(self._mounts[line.topic])
        data = transform_cdr(BASE_FRAME, line.frame, line.stamp_ns, *mount)
        return Message(TF_STATIC, TF_MESSAGE, line.stamp_ns, data)

    def _lines(self) -> Iterator[_Line]:
        """The lines that carry data; one that cannot be parsed is reported and left out."""
        offset, number, last = 0, 0, 0
        while True:
            self._file.seek(offset)
            text = self._file.readline(_MAX_LINE_BYTES)
            if not text:
                return
            offset += len(text)
            number += 1
            keyword = text[:12].split(b" ")[0].decode("ascii", errors="replace")
            if keyword not in KEYWORDS:
                continue
            try:
                line = _parse(keyword, text.split())
            except (ValueError, IndexError):
                self.report(
                    f"line {number} (byte {offset - len(text)}) is damaged: "
                    f"one {keyword} after {seconds(last)} is lost"
                )
                continue
            last = line.stamp_ns
            yield line

    def close(self) -> None:
        """Release the file."""
        self._file.close()


def _wanted(topic: str, topics: Collection[str] | None) -> bool:
    return topics is None or topic in topics


def _scan(line: _Line, ranges: FloatArray) -> Message:
    data = scan_cdr(
        line.frame,
        line.stamp_ns,
        line.angle_min,
        line.angle_increment,
        np.where(ranges >= line.range_max, np.inf, ranges),
        range_max=line.range_max,
    )
    return Message(line.topic, LASER_SCAN, line.stamp_ns, data)


def _parse(keyword: str, words: list[bytes]) -> _Line:
    """One line from its words; raises ValueError or IndexError when it is not whole."""
    if keyword == "ODOM":
        return _Line(ODOM_TOPIC, _stamp(words, 7, 9), _pose(words, 1))
    topic = f"/{keyword.lower()}"
    if keyword == "ROBOTLASER1":
        count = int(words[8])
        end = 9 + count
        end += 1 + int(words[end])  # remissions
        start, increment, longest = float(words[2]), float(words[4]), float(words[5])
        ranges = _ranges(words, 9, count)
        stamp = _stamp(words, end + 11, end + 13)
        return _Line(
            topic,
            stamp,
            _pose(words, end + 3),
            _pose(words, end),
            start,
            increment,
            longest,
            ranges,
        )
    count = int(words[1])
    end = 2 + count
    start, increment = flaser_angles(count)
    stamp = _stamp(words, end + 6, end + 8)
    laser, base, ranges = _pose(words, end), _pose(words, end + 3), _ranges(words, 2, count)
    return _Line(topic, stamp, base, laser, start, increment, RANGE_MAX_M, ranges)


def flaser_angles(beams: int) -> tuple[float, float]:
    """First bearing and increment of a FLASER line, which gives only the number of beams.

    180 and 360 beams stop one increment before the end of their 180 degrees, 181 and 361 reach it.
    """
    view = math.radians(_FIELDS_OF_VIEW.get(beams, 180.0))
    gaps = beams if beams in (180, 360, 720) else max(beams - 1, 1)
    return -0.5 * view, view / gaps


def _same(a: Pose2, b: Pose2) -> bool:
    off = a.inverse() @ b
    return off.distance <= _SAME_MOUNT_M and abs(off.theta) <= _SAME_MOUNT_RAD


def _ranges(words: list[bytes], start: int, count: int) -> FloatArray:
    if count < 1 or len(words) < start + count:
        raise ValueError(count)
    return np.array([float(word) for word in words[start : start + count]])


def _pose(words: list[bytes], start: int) -> Pose2:
    x, y, theta = (float(word) for word in words[start : start + 3])
    return Pose2(x, y, theta)


def _stamp(words: list[bytes], ipc: int, logger: int) -> int:
    """The time of a line in nanoseconds; decimal digits are taken exactly."""
    text = words[ipc]
    if float(text) == 0.0 and len(words) > logger:
        text = words[logger]
    whole, _, fraction = text.decode("ascii").partition(".")
    if not whole.lstrip("-").isdigit() or not (fraction or "0").isdigit():
        return round(float(text) * NS_PER_S)
    return int(whole) * NS_PER_S + int(fraction[:9].ljust(9, "0") or 0)
