"""CARMEN logs: lines of FLASER, RLASER, ROBOTLASER1 and ODOM, read as ROS 2 messages.

Each laser line becomes a LaserScan on `/flaser`, `/rlaser` or `/robotlaser1`, preceded by an
Odometry with the robot's own pose of that line on `/odom`, where ODOM lines go too; so a scan
always has odometry at its very stamp. Stamps are the lines' `ipc_timestamp`, or
`logger_timestamp` where that is zero. The mounting of a laser, the difference of the two poses on
its lines where it is the same on all of them, comes first on `/tf_static`.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np

from specmap_cli.core.geometry import Pose2
from specmap_cli.core.settings import LogConfig
from specmap_cli.logs.readers.carmen_lines import (
    ODOM_TOPIC,
    CarmenLine,
    LaserReading,
    damaged_keyword,
    keyword_of,
    lost_laser,
    parse_line,
    swallowed_keywords,
    topic_of,
)
from specmap_cli.logs.readers.encoding import in_space, odometry_cdr, scan_cdr, transform_cdr
from specmap_cli.logs.readers.recording import (
    Contents,
    Message,
    Recording,
    TopicInfo,
    survey,
    time_text,
    unreadable,
)
from specmap_cli.logs.readers.sniffing import is_text
from specmap_cli.logs.readers.typestore import LASER_SCAN, ODOMETRY, TF_MESSAGE

ODOM_FRAME, BASE_FRAME, TF_STATIC = "odom", "base_link", "/tf_static"

_SEARCH_BYTES = 1 << 22  # comments and PARAM lines come first: some hundred kilobytes at the most
_MAX_LINE_BYTES = 1 << 20  # a line of 1,081 beams has 10 kB: a longer one is damaged
_CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1f]")  # in no text, and in no encoding of one
_NO_TEXT = "piece that is no text"  # such as zeros, as a disk leaves them after a crash
_SOME_LASER = "laser line"  # its keyword is lost, so that nothing says which laser it was
_SAME_MOUNT_M, _SAME_MOUNT_RAD = 0.01, 0.01  # poses are written with rounded digits


class CarmenFile(Recording):
    """One CARMEN log."""

    format = "CARMEN log"

    def __init__(
        self, file: Path, path: Path | None = None, config: LogConfig | None = None
    ) -> None:
        super().__init__(file, path, config)
        try:
            self._lines_of = file.open("rb")
        except OSError as error:
            raise unreadable(self.path, error) from None

    @classmethod
    def sniff(cls, head: bytes, file: Path) -> bool:
        """Whether one of the first lines of a text is CARMEN's."""
        if not is_text(head):
            return False
        searched = 0
        with file.open("rb") as lines:
            for line in iter(lambda: lines.readline(_MAX_LINE_BYTES), b""):
                searched += len(line)
                if keyword_of(line) is not None:
                    return True
                if searched > _SEARCH_BYTES:
                    return False
        return False

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
            mountings = TopicInfo(TF_STATIC, TF_MESSAGE, len(mounts))
            contents = replace(contents, topics=(*contents.topics, mountings))
        return contents, mounts

    def _entries(self, mounts: dict[str, Pose2 | None]) -> Iterator[tuple[str, str, int]]:
        """Topic, type and time of every message but the mountings, which go into `mounts`."""
        for line in self._lines():
            yield ODOM_TOPIC, ODOMETRY, line.stamp_ns
            if line.scan is None:
                continue
            yield line.topic, LASER_SCAN, line.stamp_ns
            mount = line.odom_from_base.inverse() @ line.scan.odom_from_laser
            known = mounts.setdefault(line.topic, mount)
            if known is None or _same(known, mount):
                continue
            others = [other for topic, other in mounts.items() if topic != line.topic]
            if any(other is not None and _same(other, mount) for other in others):
                self._report_other_laser(line)
            else:
                mounts[line.topic] = None  # someone corrected the laser's poses

    def _report_other_laser(self, line: CarmenLine) -> None:
        """Note a scan that another laser took by its mounting: a letter of its keyword differs."""
        self.report(
            f"the scan on {line.topic} at {time_text(line.stamp_ns)} has the mounting of another "
            "laser: its keyword is damaged, and one scan of that laser is missing"
        )

    @property
    def _mounts(self) -> dict[str, Pose2]:
        return self._survey[1]

    def messages(self, topics: Collection[str] | None = None) -> Iterator[Message]:
        """The messages on `topics`, in the order of the lines."""
        started: set[str] = set()  # lasers whose mounting has been told
        for line in self._lines():
            if line.scan is not None and line.topic not in started:
                started.add(line.topic)
                if line.topic in self._mounts and _wanted(TF_STATIC, topics):
                    yield self._mounting(line)
            if _wanted(ODOM_TOPIC, topics):
                data = odometry_cdr(ODOM_FRAME, BASE_FRAME, line.stamp_ns, line.odom_from_base)
                yield Message(ODOM_TOPIC, ODOMETRY, line.stamp_ns, data)
            if line.scan is not None and _wanted(line.topic, topics):
                yield _scan_message(line, line.scan)

    def _mounting(self, line: CarmenLine) -> Message:
        mount = in_space(self._mounts[line.topic])
        data = transform_cdr(BASE_FRAME, line.frame, line.stamp_ns, *mount)
        return Message(TF_STATIC, TF_MESSAGE, line.stamp_ns, data)

    def _lines(self) -> Iterator[CarmenLine]:
        """The lines that carry data; one that cannot be parsed is reported and left out."""
        offset, number, last = 0, 0, 0
        while True:
            self._lines_of.seek(offset)
            text = self._lines_of.readline(_MAX_LINE_BYTES)
            if not text:
                return
            offset += len(text)
            number += 1
            line, lost = _read(text)
            for what in lost:
                self.report(
                    f"line {number} (byte {offset - len(text)}) is damaged: "
                    f"one {what} after {time_text(last)} is lost",
                    {} if what in (_SOME_LASER, _NO_TEXT) else {topic_of(what): 1},
                )
            if line is not None:
                last = line.stamp_ns
                yield line

    def close(self) -> None:
        """Release the file."""
        self._lines_of.close()


def _read(text: bytes) -> tuple[CarmenLine | None, list[str]]:
    """What a line holds, None for nothing, and what of it is lost."""
    keyword, words = keyword_of(text), text.split()
    lost = swallowed_keywords(text)
    if (damaged := None if keyword else damaged_keyword(text)) is not None:
        return None, [*lost, damaged]
    if lost_laser(words):
        return None, [*lost, _SOME_LASER]
    if keyword is None:
        no_text = _CONTROL.search(text) and text.strip(b"\0\r\n")  # all zeros is padding
        return None, lost or ([_NO_TEXT] if no_text else [])
    try:
        return parse_line(keyword, words), lost
    except (ValueError, IndexError):
        return None, [*lost, keyword]


def _wanted(topic: str, topics: Collection[str] | None) -> bool:
    return topics is None or topic in topics


def _scan_message(line: CarmenLine, scan: LaserReading) -> Message:
    data = scan_cdr(
        line.frame,
        line.stamp_ns,
        scan.angle_min,
        scan.angle_increment,
        np.where(scan.ranges >= scan.range_max, np.inf, scan.ranges),
        range_max=scan.range_max,
    )
    return Message(line.topic, LASER_SCAN, line.stamp_ns, data)


def _same(a: Pose2, b: Pose2) -> bool:
    off = a.inverse() @ b
    return off.distance <= _SAME_MOUNT_M and abs(off.theta) <= _SAME_MOUNT_RAD
