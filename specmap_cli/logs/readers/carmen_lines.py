"""Lines of CARMEN logs: FLASER, RLASER, ROBOTLASER1 and ODOM, each parsed on its own."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.text import stamp_ns
from specmap_cli.logs.readers.typestore import NS_PER_S

ODOM_TOPIC = "/odom"

_KEYWORDS = frozenset({b"FLASER", b"RLASER", b"ROBOTLASER1", b"ODOM"})
_INSIDE = re.compile(rb"(?:[FR]LASER|ROBOTLASER1|ODOM)(?= [-0-9])")
_PARTS = (b"LASER", b"ODOM")  # one of them is in each keyword
_KEYWORD_BYTES = 12  # of the longest keyword and what ends it
_FLASER_RANGE_MAX_M = 80.0  # lines do not say: the SICK LMS of these logs gives 81.83 for no return
_SENSORS = (b"LASER", b"SONAR", b"BUMPER")  # in the keywords of lines that tell of a sensor
_FLASER_TAIL = 9  # words behind the ranges: two poses, a stamp, the host, a stamp
_ROBOTLASER_HEAD, _ROBOTLASER_TAIL = 8, 14  # words up to the ranges and behind the remissions
_COUNT_DIGITS = 7  # no line has a million ranges
_STAMP_LIMIT_NS = 1 << 63  # messages have their times in 64 bits,
_FLOAT_LIMIT = 1e30  # and angles and ranges in 32: what still fits when multiplied by the beams

# Field of view of FLASER lines in degrees by the beams of Hokuyo lasers; of all others it is 180.
_FIELDS_OF_VIEW = {541: 270.0, 1081: 270.0, 682: 239.41, 683: 239.77}
_OPEN_ENDED = (180, 360, 720)  # beams of a SICK LMS that stops one increment before the end


@dataclass(frozen=True, slots=True, kw_only=True)
class LaserReading:
    """What a laser line says of its laser: the laser's pose, its angles (rad), ranges (B,) in m."""

    odom_from_laser: Pose2
    angle_min: float
    angle_increment: float
    range_max: float
    ranges: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class CarmenLine:
    """One parsed line; `scan` is None for ODOM."""

    topic: str
    stamp_ns: int
    odom_from_base: Pose2
    scan: LaserReading | None = None

    @property
    def frame(self) -> str:
        """The frame of the laser: its topic without the slash."""
        return self.topic.strip("/")


def damaged_keyword(line: bytes) -> str | None:
    """The keyword that a line started with before a byte of it was damaged; None for another line.

    Another digit at the end is no damage: there are more lasers than those read.
    """
    for keyword in sorted(_KEYWORDS):
        word = line[: len(keyword)]
        wrong = [old for old, new in zip(keyword, word, strict=False) if old != new]
        if len(word) == len(keyword) and len(wrong) <= 1 and not bytes(wrong).isdigit():
            other = not wrong and not line[len(keyword) + 1 : len(keyword) + 2].isdigit()
            return None if other else keyword.decode("ascii")
    return None


def lost_laser(words: list[bytes]) -> bool:
    """Whether the words of a line are those of a laser, but for the first, or without it.

    Comments do not count, nor do lines of other lasers, sonars and bumpers, which may look alike.
    """
    if not words or words[0].startswith(b"#") or any(name in words[0] for name in _SENSORS):
        return False
    return _is_laser_length(words[1:]) or (words[0][:1].isdigit() and _is_laser_length(words))


def _is_laser_length(words: list[bytes]) -> bool:
    """Whether the counts among the words behind a keyword fit the number of words."""
    beams = _count(words, 0)
    if beams > 1 and len(words) == 1 + beams + _FLASER_TAIL:
        return True
    beams = _count(words, _ROBOTLASER_HEAD - 1)
    end = _ROBOTLASER_HEAD + beams
    return beams > 1 and len(words) == end + 1 + _count(words, end) + _ROBOTLASER_TAIL


def _count(words: list[bytes], place: int) -> int:
    """The count at a place, 0 when there is none."""
    word = words[place] if place < len(words) else b""
    return int(word) if word.isdigit() and len(word) < _COUNT_DIGITS else 0


def swallowed_keywords(line: bytes) -> list[str]:
    """The keywords inside a line: those of lines whose line break was damaged."""
    if all(line.find(part, 1) < 0 for part in _PARTS):  # much quicker than the pattern
        return []
    return [word.decode("ascii") for word in _INSIDE.findall(line, 1)]


def topic_of(keyword: str) -> str:
    """The topic of what a line of that keyword holds."""
    return ODOM_TOPIC if keyword == "ODOM" else f"/{keyword.lower()}"


def keyword_of(line: bytes) -> str | None:
    """The keyword that a line starts with, None when it is not one of those read."""
    word = line[:_KEYWORD_BYTES].split(b" ", 1)[0].rstrip()
    return word.decode("ascii") if word in _KEYWORDS else None


def parse_line(keyword: str, words: list[bytes]) -> CarmenLine:
    """One line from its words; raises ValueError or IndexError when it is not whole."""
    if keyword == "ODOM":
        stamp = _stamp(words, 7, 9)
        _check_host(words, 8)
        return CarmenLine(topic=ODOM_TOPIC, stamp_ns=stamp, odom_from_base=_pose(words, 1))
    topic = topic_of(keyword)
    return _robotlaser(topic, words) if keyword == "ROBOTLASER1" else _flaser(topic, words)


def _robotlaser(topic: str, words: list[bytes]) -> CarmenLine:
    """ROBOTLASER1 type start view increment max accuracy mode count ranges count remissions ..."""
    count = int(words[8])
    end = 9 + count
    end += 1 + int(words[end])  # remissions
    _check_host(words, end + 12)
    scan = LaserReading(
        odom_from_laser=_pose(words, end),
        angle_min=_finite(words[2]),
        angle_increment=_finite(words[4]),
        range_max=_finite(words[5]),
        ranges=_ranges(words, 9, count),
    )
    return CarmenLine(
        topic=topic,
        stamp_ns=_stamp(words, end + 11, end + 13),
        odom_from_base=_pose(words, end + 3),
        scan=scan,
    )


def _flaser(topic: str, words: list[bytes]) -> CarmenLine:
    """FLASER count ranges laser_x laser_y laser_theta x y theta ipc_time host logger_time."""
    count = int(words[1])
    end = 2 + count
    _check_host(words, end + 7)
    start, increment = flaser_angles(count)
    scan = LaserReading(
        odom_from_laser=_pose(words, end),
        angle_min=start,
        angle_increment=increment,
        range_max=_FLASER_RANGE_MAX_M,
        ranges=_ranges(words, 2, count),
    )
    return CarmenLine(
        topic=topic,
        stamp_ns=_stamp(words, end + 6, end + 8),
        odom_from_base=_pose(words, end + 3),
        scan=scan,
    )


def flaser_angles(beams: int) -> tuple[float, float]:
    """First bearing and increment of a FLASER line, which gives only the number of beams.

    180 and 360 beams stop one increment before the end of their 180 degrees, 181 and 361 reach it.
    """
    view = math.radians(_FIELDS_OF_VIEW.get(beams, 180.0))
    gaps = beams if beams in _OPEN_ENDED else max(beams - 1, 1)
    return -0.5 * view, view / gaps


def _ranges(words: list[bytes], start: int, count: int) -> FloatArray:
    if count < 1 or len(words) < start + count:
        raise ValueError(count)
    ranges = np.array([float(word) for word in words[start : start + count]])
    if (np.abs(ranges[np.isfinite(ranges)]) > _FLOAT_LIMIT).any():
        raise ValueError(words[start])
    return ranges


def _pose(words: list[bytes], start: int) -> Pose2:
    x, y, theta = (_finite(word) for word in words[start : start + 3])
    return Pose2(x, y, theta)


def _check_host(words: list[bytes], place: int) -> None:
    """Raise ValueError when a line is too long, and has a number where the host should be.

    It has then lost the end of itself, and what follows is of another line.
    """
    if len(words) > place + 2 and _is_number(words[place]):
        raise ValueError(words[place])


def _is_number(word: bytes) -> bool:
    try:
        return math.isfinite(float(word))
    except ValueError:
        return False


def _finite(word: bytes) -> float:
    value = float(word)
    if not abs(value) <= _FLOAT_LIMIT:  # true for NaN as well
        raise ValueError(word)
    return value


def _stamp(words: list[bytes], ipc: int, logger: int) -> int:
    """The time of a line in nanoseconds; decimal digits are taken exactly."""
    word = words[ipc]
    if _finite(word) == 0.0 and len(words) > logger:
        word = words[logger]
    try:
        stamp = stamp_ns(word.decode("ascii"))
    except ValueError:  # with an exponent
        stamp = round(_finite(word) * NS_PER_S)
    if not -_STAMP_LIMIT_NS < stamp < _STAMP_LIMIT_NS:
        raise ValueError(word)
    return stamp
