"""Chunks of messages as values: where they lie, what an index lists of them, what is missing."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from specmap_cli.logs.readers.compression import Unpacked

MAX_SPOTS = 1_000_000  # of one chunk, some 200 MB of memory; intact chunks have thousands

# A message in the records of a chunk: its log time, its channel, where its data starts and ends.
Spot = tuple[int, int, int, int]


class Channel(NamedTuple):
    """One stream of messages in a file."""

    topic: str
    type: str
    ros1: bool  # messages are in ROS 1 serialisation, not CDR


class Entry(NamedTuple):
    """A message as stored."""

    time_ns: int
    channel: int
    data: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class ChunkRef:
    """Where the record of a chunk lies, and what the index says of the chunk.

    `length` is of the whole record, `size` of the unpacked records inside, 0 when unknown; so are
    the times. `channels` have messages in it, None when unknown; `counts` say how many.
    """

    offset: int
    length: int = 0
    size: int = 0
    start_ns: int = 0
    end_ns: int = 0
    channels: frozenset[int] | None = None
    counts: Mapping[int, int] = field(default_factory=dict)


class OpenedChunk(NamedTuple):
    """The records inside a chunk; `sound` says that the head of its own record is."""

    unpacked: Unpacked
    sound: bool = True

    @property
    def well(self) -> bool:
        """Whether everything is there."""
        return self.sound and self.unpacked.complete


class Listing(NamedTuple):
    """What stands behind a chunk: its messages by channel, and on demand their times and places."""

    counts: Mapping[int, int]
    entries: Callable[[], list[tuple[int, int]]]

    def next_start(self, position: int) -> int | None:
        """Where in the records of the chunk the first message behind `position` starts."""
        return min((start for _, start in self.entries() if start > position), default=None)


NOTHING_LISTED = Listing({}, list)


def expected_counts(*sources: Mapping[int, int]) -> Counter[int]:
    """The messages of each channel; where sources differ, as one is damaged, the larger number."""
    counts: Counter[int] = Counter()
    for source in sources:
        counts |= Counter(source)
    return counts


def by_topic(counts: Mapping[int, int], channels: Mapping[int, Channel]) -> Counter[str]:
    """Counts by channel as counts by topic; channels that are not known have none."""
    named: Counter[str] = Counter()
    for number, count in counts.items():
        if count > 0 and number in channels:
            named[channels[number].topic] += count
    return named


def overlapping_bytes(chunks: Iterable[ChunkRef]) -> int:
    """The most that chunks which cover one time amount to together, unpacked."""
    most = total = 0
    covering: list[tuple[int, int]] = []
    for ref in sorted(chunks, key=lambda ref: ref.start_ns):
        while covering and covering[0][0] < ref.start_ns:
            total -= heapq.heappop(covering)[1]
        size = max(ref.size, ref.length)
        heapq.heappush(covering, (ref.end_ns, size))
        total += size
        most = max(most, total)
    return most
