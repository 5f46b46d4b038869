"""CARMEN logs: lines of FLASER, RLASER, ROBOTLASER1 and ODOM, read as ROS 2 messages.

Each laser line becomes a LaserScan on `/flaser`, `/rlaser` or `/robotlaser1`, preceded by an
Odometry with the robot's own pose of that line on `/odom`, where ODOM lines go too; so a scan
always has odometry at its very stamp. Stamps are the lines' `ipc_timestamp`, or
`logger_timestamp` where that is zero. The mounting of a laser, the difference of the two poses on
its lines where it is the same on all of them, comes first on `/tf_static`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterator
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from specmap_cli.core.geometry import IDENTITY, FloatArray, Pose2
from specmap_cli.core.settings import LogConfig
from specmap_cli.core.text import stamp_ns
from specmap_cli.logs.readers import encoding, recording

ODOM_TOPIC = "/odom"

_KEYWORDS = frozenset({b"FLASER", b"RLASER", b"ROBOTLASER1", b"ODOM"})
_INSIDE = re.compile(rb"(?:[FR]LASER|ROBOTLASER1|ODOM)(?= [-0-9])")
_NUMBER = tuple(bytes([byte]) for byte in b"-0123456789")  # what one begins with
_PARTS = (b"LASER", b"ODOM")  # one of them is in each keyword
_KEYWORD_BYTES = 12  # of the longest keyword and what ends it
_FLASER_RANGE_MAX_M = 80.0  # lines do not say: the SICK LMS of these logs gives 81.83 for no return
_KEYWORD = re.compile(rb"[A-Z]\w*")  # what one looks like
_MOST_KEYWORDS = 1000  # of a log, that are not read
_FLASER_TAIL = 9  # words behind the ranges: two poses, a stamp, the host, a stamp
# which of the last words of any line are numbers: the host is not
_END = [True] * 6 + [False, True]
_ROBOTLASER_HEAD, _ROBOTLASER_TAIL = 8, 14  # words up to the ranges and behind the remissions
_ODOM_WORDS = 9  # a pose, three speeds, a stamp, the host, a stamp
_COUNT_DIGITS = 7  # no line has a million ranges
_STAMP_LIMIT_NS = 1 << 63  # messages have their times in 64 bits,
_FLOAT_LIMIT = 1e30  # and angles and ranges in 32: what still fits when multiplied by the beams

# Field of view of FLASER lines in degrees by the beams of Hokuyo lasers; of all others it is 180.
_FIELDS_OF_VIEW = {541: 270.0, 1081: 270.0, 682: 239.41, 683: 239.77}
_OPEN_ENDED = (180, 360, 720)  # beams of a SICK LMS that stops one increment before the end


class CarmenLine(NamedTuple):
    """One parsed line, with the laser's pose, first angle and increment (rad), ranges (B,) in m.

    ODOM has no ranges.
    """

    topic: str
    stamp_ns: int
    odom_from_base: Pose2
    odom_from_laser: Pose2 = IDENTITY
    angles: tuple[float, float] = (0.0, 0.0)
    range_max: float = 0.0
    ranges: FloatArray | None = None


def damaged_keyword(line: bytes) -> str | None:
    """The keyword that a line started with before a byte of it was damaged; None for another line.

    Another digit at the end is no damage: there are more lasers than those read. Nor is a word that
    lacks a byte, or has one more, without a number behind it.
    """
    first, _, rest = line.partition(b" ")
    for keyword in sorted(_KEYWORDS):
        if abs(len(first) - len(keyword)) == 1 and rest[:1] in _NUMBER:
            longer, shorter = sorted((first, keyword), key=len, reverse=True)
            spare = (at for at in range(len(longer)) if longer[:at] + longer[at + 1 :] == shorter)
            at = next(spare, None)
            if at is not None and (len(first) < len(keyword) or not first[at : at + 1].isdigit()):
                return keyword.decode("ascii")
        word = line[: len(keyword)]
        wrong = [(old, new) for old, new in zip(keyword, word, strict=False) if old != new]
        another = any(bytes(pair).isdigit() for pair in wrong)
        if len(word) == len(keyword) and len(wrong) <= 1 and not another:
            behind = line[len(keyword) : len(keyword) + 2]  # no keyword goes on beyond ASCII
            other = not wrong and behind[:1] < b"\x80" and not behind[1:].isdigit()
            return None if other else keyword.decode("ascii")
    return None


def lost_line(words: list[bytes]) -> str | None:
    """What was lost where a line has no keyword that is read, but the numbers of one that is.

    It has the length of a laser's, or the end of a laser's or of odometry: behind what damage left
    of a keyword, or behind a comment or a parameter if bytes were cut out across lines. So do lines
    of other sensors.
    """
    if len(words) < len(_END):
        return None
    whole = [words] if words[0][:1].isdigit() else []
    for behind in (words[1:], *whole):
        if len(behind) in (_length("FLASER", behind), _length("ROBOTLASER1", behind)):
            return _SOME_LASER
    numeric = [_is_number(word) for word in words[-len(_END) :]]
    return _SOME_LINE if numeric == _END else None


def _length(keyword: str, words: list[bytes]) -> int:
    """How many words a line has behind its keyword, by the counts among them; 0 without one."""
    if keyword == "ODOM":
        return _ODOM_WORDS
    if keyword != "ROBOTLASER1":
        beams = _count(words, 0)
        return 1 + beams + _FLASER_TAIL if beams > 1 else 0
    beams = _count(words, _ROBOTLASER_HEAD - 1)
    end = _ROBOTLASER_HEAD + beams
    return end + 1 + _count(words, end) + _ROBOTLASER_TAIL if beams > 1 else 0


def _count(words: list[bytes], place: int) -> int:
    """The count at a place, 0 when there is none."""
    word = words[place] if place < len(words) else b""
    return int(word) if word.isdigit() and len(word) < _COUNT_DIGITS else 0


def topic_of(keyword: str) -> str:
    """The topic of what a line of that keyword holds."""
    return ODOM_TOPIC if keyword == "ODOM" else f"/{keyword.lower()}"


def keyword_of(line: bytes) -> str | None:
    """The keyword that a line starts with, None when it is not one of those read."""
    word = line[:_KEYWORD_BYTES].split(b" ", 1)[0].rstrip()
    return word.decode("ascii") if word in _KEYWORDS else None


def parse_line(keyword: str, words: list[bytes]) -> CarmenLine:
    """One line from its words; raises ValueError or IndexError when it is not whole.

    ODOM x y theta tv rv accel ipc_time host logger_time
    FLASER count ranges laser_x laser_y laser_theta x y theta ipc_time host logger_time
    ROBOTLASER1 type start view increment max accuracy mode count ranges count remissions
        laser_x laser_y laser_theta x y theta and five more, ipc_time host logger_time
    """
    if keyword == "ODOM":
        _check_host(words, 8)
        return CarmenLine(ODOM_TOPIC, _stamp(words, 7), _pose(words, 1))
    if keyword == "ROBOTLASER1":
        count, first, behind = int(words[8]), 9, 11
        poses = first + count + 1 + int(words[first + count])  # behind the remissions
        first_rad, step_rad, range_max = (_finite(words[place]) for place in (2, 4, 5))
        angles = first_rad, step_rad
    else:
        count, first, behind = int(words[1]), 2, 6
        poses = first + count
        angles, range_max = flaser_angles(count), _FLASER_RANGE_MAX_M
    _check_host(words, poses + behind + 1)
    if count < 1 or len(words) < first + count:
        raise ValueError(count)
    ranges = np.array([float(word) for word in words[first : first + count]])
    if (np.abs(ranges[np.isfinite(ranges)]) > _FLOAT_LIMIT).any():
        raise ValueError(words[first])
    for word in words[poses : poses + behind]:
        float(word)  # a host before its place: what is between was cut out
    return CarmenLine(
        topic=topic_of(keyword),
        stamp_ns=_stamp(words, poses + behind),
        odom_from_base=_pose(words, poses + 3),
        odom_from_laser=_pose(words, poses),
        angles=angles,
        range_max=range_max,
        ranges=ranges,
    )


def flaser_angles(beams: int) -> tuple[float, float]:
    """First bearing and increment of a FLASER line, which gives only the number of beams.

    180 and 360 beams stop one increment before the end of their 180 degrees, 181 and 361 reach it.
    """
    view = math.radians(_FIELDS_OF_VIEW.get(beams, 180.0))
    gaps = beams if beams in _OPEN_ENDED else max(beams - 1, 1)
    return -0.5 * view, view / gaps


def _pose(words: list[bytes], start: int) -> Pose2:
    x, y, theta = (_finite(word) for word in words[start : start + 3])
    return Pose2(x, y, theta)


def _check_host(words: list[bytes], place: int) -> None:
    """Raise ValueError for a number where a host should be: the end of another line follows."""
    if len(words) > place + 2 and _is_number(words[place]):
        raise ValueError(words[place])


def _is_number(word: bytes) -> bool:
    """Whether a word is a finite number."""
    try:
        return math.isfinite(float(word))
    except ValueError:
        return False


def _finite(word: bytes) -> float:
    value = float(word)
    if not abs(value) <= _FLOAT_LIMIT:  # true for NaN as well
        raise ValueError(word)
    return value


def _stamp(words: list[bytes], place: int) -> int:
    """The time of a line, or the logger's behind the host, in ns; decimal digits exactly."""
    word = words[place]
    if _finite(word) == 0.0 and len(words) > place + 2:
        word = words[place + 2]
    try:
        stamp = stamp_ns(word.decode("ascii"))
    except ValueError:  # with an exponent
        stamp = round(_finite(word) * encoding.NS_PER_S)
    if not -_STAMP_LIMIT_NS < stamp < _STAMP_LIMIT_NS:
        raise ValueError(word)
    return stamp


ODOM_FRAME, BASE_FRAME = "odom", "base_link"

_SEARCH_BYTES = 1 << 22  # comments and PARAM lines come first: some hundred kilobytes at the most
_MAX_LINE_BYTES = 1 << 20  # a line of 1,081 beams has 10 kB: a longer one is damaged
_CONTROLS = bytes([*range(9), *range(14, 32), 127])  # in no text, and in no encoding of one
_NO_TEXT = "piece that is no text"  # such as zeros, as a disk leaves them after a crash
_SOME_LASER = "laser line"  # its keyword is lost, so that nothing says which laser it was
_SOME_LINE = "other line (but for its end)"  # it ran into the one before
_SAME_MOUNT_M, _SAME_MOUNT_RAD = 0.01, 0.01  # poses are written with rounded digits


class CarmenFile(recording.Recording):
    """One CARMEN log."""

    format = "CARMEN log"

    def __init__(
        self, file: Path, path: Path | None = None, config: LogConfig | None = None
    ) -> None:
        super().__init__(file, path, config)
        try:
            self._lines_of = file.open("rb")
        except OSError as error:
            raise recording.unreadable(self.path, error) from None

    @classmethod
    def sniff(cls, head: bytes, file: Path) -> bool:
        """Whether one of the first lines of a text is CARMEN's."""
        if not recording.is_text(head):
            return False
        searched = 0
        try:
            with file.open("rb") as lines:
                for line in iter(lambda: lines.readline(_MAX_LINE_BYTES), b""):
                    searched += len(line)
                    if keyword_of(line) is not None:
                        return True
                    if searched > _SEARCH_BYTES:
                        return False
        except OSError as error:
            raise recording.unreadable(file, error) from None
        return False

    @property
    def contents(self) -> recording.Contents:
        """From one pass over the file, as there is no index."""
        return self._survey[0]

    @cached_property
    def _survey(self) -> tuple[recording.Contents, dict[str, Pose2]]:
        """The contents, and base_from_laser by topic of lasers whose lines all give the same."""
        compared: dict[str, Pose2 | None] = {}
        contents = recording.survey(self._entries(compared))
        mounts = {topic: mount for topic, mount in compared.items() if mount is not None}
        if mounts:
            mountings = recording.TopicInfo(encoding.TF_STATIC, encoding.TF_MESSAGE, len(mounts))
            contents = replace(contents, topics=(*contents.topics, mountings))
        return contents, mounts

    def _entries(self, mounts: dict[str, Pose2 | None]) -> Iterator[tuple[str, str, int]]:
        """Topic, type and time of every message but the mountings, which go into `mounts`."""
        for line in self._lines():
            yield ODOM_TOPIC, encoding.ODOMETRY, line.stamp_ns
            if line.ranges is None:
                continue
            yield line.topic, encoding.LASER_SCAN, line.stamp_ns
            mount = line.odom_from_base.inverse() @ line.odom_from_laser
            known = mounts.setdefault(line.topic, mount)
            if known is None or _same(known, mount):
                continue
            others = [other for topic, other in mounts.items() if topic != line.topic]
            if any(other is not None and _same(other, mount) for other in others):
                when = recording.time_text(line.stamp_ns)
                self.report(
                    f"the scan on {line.topic} at {when} has the mounting of another laser: its "
                    "keyword is damaged, and one scan of that laser is missing"
                )
            else:
                mounts[line.topic] = None  # someone corrected the laser's poses

    def messages(self, topics: Collection[str] | None = None) -> Iterator[recording.Message]:
        """The messages on `topics`, in the order of the lines."""
        mounts = dict(self._survey[1])  # of lasers whose mounting has not been told
        for line in self._lines():
            ranges, stamp_ns, frame = line.ranges, line.stamp_ns, line.topic.strip("/")
            mount = mounts.pop(line.topic, None) if ranges is not None else None
            if mount is not None and (topics is None or encoding.TF_STATIC in topics):
                mounting = encoding.Transform(BASE_FRAME, frame, *encoding.in_space(mount))
                data = encoding.transforms_cdr(stamp_ns, [mounting])
                yield recording.Message(encoding.TF_STATIC, encoding.TF_MESSAGE, stamp_ns, data)
            if topics is None or ODOM_TOPIC in topics:
                data = encoding.odometry_cdr(ODOM_FRAME, BASE_FRAME, stamp_ns, line.odom_from_base)
                yield recording.Message(ODOM_TOPIC, encoding.ODOMETRY, stamp_ns, data)
            if ranges is not None and (topics is None or line.topic in topics):
                far, range_max = ranges >= line.range_max, line.range_max
                ranges = np.where(far, np.inf, ranges)
                data = encoding.scan_cdr(frame, stamp_ns, *line.angles, ranges, range_max=range_max)
                yield recording.Message(line.topic, encoding.LASER_SCAN, stamp_ns, data)

    def _lines(self) -> Iterator[CarmenLine]:
        """The lines that carry data; damage is told, such as a keyword that comes only once."""
        offset, number, last = 0, 0, 0
        once = dict[bytes, str]()  # by keywords that are not read; empty for one that came again
        while True:
            try:
                self._lines_of.seek(offset)
                text = self._lines_of.readline(_MAX_LINE_BYTES)
            except OSError as error:
                raise recording.unreadable(self.path, error) from None
            if not text:
                break
            offset += len(text)
            number += 1
            line, lost, other = _read(text)
            for what in lost:
                damage = (
                    f"line {number} (byte {offset - len(text)}) is damaged: "
                    f"one {what} after {recording.time_text(last)} is lost"
                )
                if other and (other in once or len(once) < _MOST_KEYWORDS):
                    once[other] = "" if other in once else damage
                    continue
                unnamed = what in (_SOME_LASER, _SOME_LINE, _NO_TEXT)
                self.report(damage, {} if unnamed else {topic_of(what): 1})
            if line is not None:
                last = line.stamp_ns
                yield line
        for damage in filter(None, once.values()):
            self.report(damage, {})

    def close(self) -> None:
        """Release the file."""
        self._lines_of.close()


def _read(text: bytes) -> tuple[CarmenLine | None, list[str], bytes]:
    """What a line holds, what of it is lost, and the keyword of another sensor's whole line."""
    keyword, words = keyword_of(text), text.split()
    lost: list[str] = []  # of lines whose line break was damaged
    if any(text.find(part, 1) >= 0 for part in _PARTS):  # much quicker than the pattern
        lost = [word.decode("ascii") for word in _INSIDE.findall(text, 1)]
    if (damaged := None if keyword else damaged_keyword(text)) is not None:
        return None, [*lost, damaged], b""
    unread = lost_line(words) if keyword in (None, "ODOM") else None
    if unread is _SOME_LASER or (unread and not keyword and not lost):
        other = not lost and not keyword and _KEYWORD.fullmatch(words[0]) and words[0] != b"PARAM"
        return None, [*lost, unread], words[0] if other else b""
    no_text = len(text.translate(None, _CONTROLS)) < len(text) and text.strip(b"\0\r\n")
    lost = lost or [_NO_TEXT] * bool(no_text)  # all zeros is padding
    if keyword is None:
        return None, lost, b""
    if not text.endswith(b"\n") and text.endswith(words[-1]):
        words = words[:-1]  # it is cut: who knows what its end was
    if not lost and (end := _first_end(keyword, words)):
        words, lost = words[:end], [_SOME_LINE]
    try:
        return parse_line(keyword, words), lost, b""
    except (ValueError, IndexError):
        return None, [*lost, keyword], b""


def _first_end(keyword: str, words: list[bytes]) -> int | None:
    """How many words end at the host of a line into which the end of another ran; else None."""
    host = words[-2] if len(words) > 2 else b"0"
    if _is_number(host):
        return None
    first, own = words.index(host), _length(keyword, words[1:]) - 1
    if 0 < own < first and not _is_number(words[own]):
        first = own
    return first + 1 if first < len(words) - 2 else None


def _same(a: Pose2, b: Pose2) -> bool:
    off = a.inverse() @ b
    return off.distance <= _SAME_MOUNT_M and abs(off.theta) <= _SAME_MOUNT_RAD
