"""Reading a recording to its end: is every message there, are there pauses, do stamps step back?"""

from __future__ import annotations

from array import array
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from specmap_cli.core.arguments import instance_of
from specmap_cli.core.progress import Progress, Silent
from specmap_cli.core.text import counted
from specmap_cli.logs.log import Log
from specmap_cli.logs.messages import (
    BadMessageError,
    decode_odometry,
    decode_scan,
    decode_transforms,
)
from specmap_cli.logs.readers.recording import Message
from specmap_cli.logs.readers.typestore import NS_PER_S, ODOMETRY, SCAN_TYPES, TF_MESSAGE

PAUSE_INTERVALS = 5.0  # a pause is told that is so many usual intervals, medians, long

_Key = tuple[str, str]  # topic and type
_STAMP_LIMIT_NS = (1 << 62) - 1  # differences of such stamps fit into 64 bits; they end in 2116


@dataclass(frozen=True, slots=True, kw_only=True)
class Pauses:
    """Pauses between the messages of a topic: how many, and the longest with its beginning."""

    count: int = 0
    longest_s: float = 0.0
    longest_at_s: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicCheck:
    """What came of reading a topic to its end.

    `expected` is the number that the file counts, `read` how many were read, `unusable` how many of
    these cannot be decoded. `steps_back` counts messages whose stamp is earlier than that of the
    message before, `repeats` those with the same stamp.
    """

    name: str
    type: str
    read: int
    expected: int
    unusable: int = 0
    pauses: Pauses = field(default_factory=Pauses)
    steps_back: int = 0
    repeats: int = 0

    def text(self) -> str:
        """The result in words, without the name."""
        told = [f"{self.read:,} of {counted(self.expected, 'message')} read"]
        if self.unusable:
            told.append(f"{self.unusable:,} unusable")
        if self.pauses.count:
            told.append(
                f"{counted(self.pauses.count, 'pause')}, the longest {self.pauses.longest_s:.2f} s "
                f"from {self.pauses.longest_at_s:.3f} s on"
            )
        if self.steps_back:
            told.append(f"stamps earlier than the stamp before: {self.steps_back:,}")
        if self.repeats:
            told.append(f"stamps equal to the stamp before: {self.repeats:,}")
        return "; ".join(told)


@dataclass(slots=True)
class _Heard:
    """What was read of a topic so far: 8 bytes a message."""

    stamps_ns: array[int] = field(default_factory=lambda: array("q"))
    unusable: int = 0


def check(log: Log, progress: Progress | None = None) -> tuple[TopicCheck, ...]:
    """Read every message of a log, one in memory at a time; the topics in the order of `contents`.

    Losses that are met are in `log.damage` afterwards. Stamps are those of the headers of scans and
    odometry, otherwise the recorder's times. Raises TypeError for what is no `Log`.
    """
    instance_of(log, Log, "log")
    told = Silent() if progress is None else progress
    expected = {(topic.name, topic.type): topic.count for topic in log.contents.topics}
    heard: dict[_Key, _Heard] = {key: _Heard() for key in expected}
    told.start("reading", log.contents.messages)
    for message in log.messages():
        _hear(heard.setdefault((message.topic, message.type), _Heard()), message)
        told.advance()
    return tuple(_topic(key, heard[key], expected) for key in sorted(heard))


def _hear(topic: _Heard, message: Message) -> None:
    try:
        stamp = _stamp(message)
    except BadMessageError:
        topic.unusable += 1
        stamp = 0
    stamp = stamp or message.time_ns
    topic.stamps_ns.append(max(-_STAMP_LIMIT_NS, min(stamp, _STAMP_LIMIT_NS)))


def _stamp(message: Message) -> int:
    """The stamp in a scan or an odometry message, 0 for another; raises BadMessageError."""
    if message.type in SCAN_TYPES:
        return decode_scan(message).stamp_ns
    if message.type == ODOMETRY:
        return decode_odometry(message).stamp_ns
    if message.type == TF_MESSAGE:
        decode_transforms(message)
    return 0


def _topic(key: _Key, heard: _Heard, expected: Mapping[_Key, int]) -> TopicCheck:
    stamps = np.array(heard.stamps_ns, dtype=np.int64)
    steps = np.diff(stamps)
    return TopicCheck(
        name=key[0],
        type=key[1],
        read=len(stamps),
        expected=expected.get(key, 0),
        unusable=heard.unusable,
        pauses=_pauses(stamps, PAUSE_INTERVALS),
        steps_back=int((steps < 0).sum()),
        repeats=int((steps == 0).sum()),
    )


def _pauses(stamps_ns: np.ndarray[tuple[int], np.dtype[np.int64]], intervals: float) -> Pauses:
    """Steps longer than so many usual ones, the median of those that go ahead."""
    steps = np.diff(stamps_ns) / NS_PER_S
    ahead = steps[steps > 0]
    if not len(ahead):
        return Pauses()
    count = int((steps > intervals * np.median(ahead)).sum())
    if not count:
        return Pauses()
    longest = int(np.argmax(steps))
    return Pauses(
        count=count,
        longest_s=round(float(steps[longest]), 6),
        longest_at_s=round(float(stamps_ns[longest]) / NS_PER_S, 6),
    )
