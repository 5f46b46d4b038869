"""Files that are a sequence of records holding compressed chunks of messages: MCAP, ROS 1 bags.

An intact file has an index: its chunks are merged by their start times, and messages inside a chunk
are sorted by log time. A file without a usable one (a recorder that was killed, a truncated or
damaged file) is salvaged: its records are walked from the start, and the readable part of the last
chunk is kept.

What is read of a chunk is compared with what is listed of it, and what is read of a topic with
what the index lists of the topic: nothing is lost without a word.
"""

from __future__ import annotations

import heapq
import os
import struct
from abc import abstractmethod
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from operator import itemgetter
from pathlib import Path
from typing import NamedTuple

from specmap_cli.core.settings import LogConfig
from specmap_cli.logs.readers.compression import MAGIC, Unpacked, decompress
from specmap_cli.logs.readers.encoding import SUPPORTED_TYPES, UNFIT, typestore
from specmap_cli.logs.readers.recording import (
    Contents,
    Message,
    Recording,
    contents_of,
    lost_text,
    merge_in_time,
    survey,
    time_text,
    unreadable,
)

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


class Listing(NamedTuple):
    """What stands behind a chunk: its messages by channel, and on demand their times and places."""

    counts: Mapping[int, int]
    entries: Callable[[], list[tuple[int, ...]]]

    def next_start(self, position: int) -> int | None:
        """Where in the records of the chunk the first message behind `position` starts."""
        return min((start for _, start in self.entries() if start > position), default=None)


NOTHING_LISTED = Listing({}, list)


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


_OVERLAPPING = 2  # chunks of the largest size that may be in memory together


@dataclass(frozen=True, slots=True)
class Index:
    """What the summary at the end of a file says; `checked` when a checksum vouches for it."""

    contents: Contents
    chunks: tuple[ChunkRef, ...]
    checked: bool


class ChunkedFile(Recording):
    """Common reading of MCAP and ROS 1 bags; a subclass knows the records."""

    def __init__(
        self, file: Path, path: Path | None = None, config: LogConfig | None = None
    ) -> None:
        super().__init__(file, path, config)
        try:
            self._fd = os.open(file, os.O_RDONLY)
        except OSError as error:
            raise unreadable(self.path, error) from None
        self.size = os.fstat(self._fd).st_size
        self.channels: dict[int, Channel] = {}
        self._index: Index | None = None
        try:
            self._index = self._read_index()
        except BaseException:
            self.close()
            raise

    @abstractmethod
    def _read_index(self) -> Index | None:
        """The summary and the channels, or None when it is missing or damaged."""

    @abstractmethod
    def _salvaged(self) -> Iterator[Entry]:
        """All entries from the first record on; damage is reported and ends or skips."""

    @abstractmethod
    def _open_chunk(self, ref: ChunkRef) -> Unpacked:
        """The records inside a chunk; complete when its own record is sound, too."""

    @abstractmethod
    def _listing(self, ref: ChunkRef) -> Listing:
        """What the records behind a chunk list of it."""

    @abstractmethod
    def _spots(self, records: bytes, listing: Listing) -> tuple[list[Spot], bool]:
        """Whole messages of known channels, by the listing behind damage; whether all is whole."""

    @cached_property
    def contents(self) -> Contents:
        """From the index, or by one pass over a file without."""
        if self._index is not None:
            return self._index.contents
        entries = self._salvaged()
        return survey((*self.channels[entry.channel][:2], entry.time_ns) for entry in entries)

    def messages(self, topics: Collection[str] | None = None) -> Iterator[Message]:
        """The messages on `topics`, in time order with an index and as written without.

        They come chunk by chunk when too many chunks overlap.
        """
        if self._index is None:
            for entry in self._salvaged():
                if topics is None or self.channels[entry.channel].topic in topics:
                    yield from self._message(*entry)
            return
        chunks = list(self._index.chunks)
        if topics is not None:
            wanted = {n for n, channel in self.channels.items() if channel.topic in topics}
            chunks = [ref for ref in chunks if self._may_hold(ref, wanted, self._index)]
        sources = [(ref.start_ns, partial(self._chunk_messages, ref, topics)) for ref in chunks]
        if overlapping_bytes(chunks) <= _OVERLAPPING * self.chunk_max:
            merged = merge_in_time(sources)
        else:
            self.report("more chunks overlap in time than log.chunk_max_mb allows: read one by one")
            merged = (message for _, opened in sources for message in opened())
        found: Counter[str] = Counter()
        for message in merged:
            found[message.topic] += 1
            yield message
        listed: Counter[str] = Counter()
        for topic in self._index.contents.topics:
            if topics is None or topic.name in topics:
                listed[topic.name] += topic.count
        self.compare(listed, found)

    def _may_hold(self, ref: ChunkRef, wanted: set[int], index: Index) -> bool:
        """Whether a chunk may have messages of channels: what no checksum proves is asked twice."""
        if ref.channels is None or wanted & ref.channels:
            return True
        listed = {} if index.checked else self._listing(ref).counts
        return not index.checked and (not listed or not wanted.isdisjoint(listed))

    def compare(self, listed: Counter[str], found: Counter[str]) -> None:
        """After a pass to the end: say what is listed by topic and what no chunk was short of."""
        lost = listed - found - self.missing
        if lost:
            self.report(f"{lost_text(lost, listed)} of the index are not in the file", lost)

    def close(self) -> None:
        """Release the file."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def read_at(self, offset: int, length: int) -> bytes:
        """Up to `length` bytes from `offset` on; fewer at the end of the file."""
        if offset >= self.size:
            return b""
        try:
            return os.pread(self._fd, max(min(length, self.size - offset), 0), offset)
        except OSError as error:
            raise unreadable(self.path, error) from None

    def rows_at(
        self, places: Iterable[tuple[int, int]], row: struct.Struct
    ) -> Iterator[tuple[int, ...]]:
        """The whole rows of a table whose pieces stand at (offset, length)."""
        for offset, length in places:
            data = self.read_at(offset, min(length, self.chunk_max))
            yield from row.iter_unpack(data[: len(data) // row.size * row.size])

    def report_end(self, offset: int, last_ns: int) -> None:
        """Note that no record can be read at `offset`, where the walk ends; at the end: cut off."""
        where = f"damaged at byte {offset} of {self.size}"
        if offset >= self.size:
            where = f"cut off at byte {self.size}"
        lost = f"what followed {time_text(last_ns)}" if last_ns > 0 else "everything"
        self.report(f"{where}: {lost} is lost")

    def define(self, number: int, channel: Channel) -> None:
        """Take in a channel; the first word on one stands, and another is reported."""
        known = self.channels.setdefault(number, channel)
        if known != channel:
            self.report(
                f"channel {number} is described twice, as {known.topic} ({known.type}) and as "
                f"{channel.topic} ({channel.type}): read as the first"
            )

    def contents_of(self, counts: Mapping[int, int], start_ns: int, end_ns: int) -> Contents:
        """The contents from the number of messages of each channel."""
        counted = ((c.topic, c.type, counts.get(number, 0)) for number, c in self.channels.items())
        return contents_of(counted, start_ns, end_ns)

    def _chunk_messages(self, ref: ChunkRef, topics: Collection[str] | None) -> Iterator[Message]:
        """The messages of a chunk on `topics` in time order."""
        records, spots = self._read_spots(ref)
        if topics is not None:
            spots = [spot for spot in spots if self.channels[spot[1]].topic in topics]
        spots.sort(key=itemgetter(0))
        for entry in entries_at(records, spots):
            yield from self._message(*entry)

    def _read_spots(self, ref: ChunkRef) -> tuple[bytes, list[Spot]]:
        """Records of a chunk and where messages stand in them, as written; damage is reported."""
        chunk, listing = self._open_chunk(ref), self._listing(ref)
        spots, whole = self._spots(chunk.data, listing)
        expected = Counter(ref.counts) | Counter(listing.counts)  # one may be damaged: the larger
        missing = expected - Counter(map(itemgetter(1), spots))
        cut = self._index is None and ref.offset + ref.length > self.size  # which is told elsewhere
        if not cut and (missing or not (whole and chunk.complete)):
            fault = "beyond log.chunk_max_mb" if chunk.beyond else "damaged"
            self._tell(ref, fault, listing, expected, missing)
        return chunk.data, spots

    def _tell(
        self,
        ref: ChunkRef,
        fault: str,
        listing: Listing,
        expected: Mapping[int, int],
        missing: Mapping[int, int],
    ) -> None:
        """Say what is lost of a chunk: the messages `expected` in it, and those `missing`."""
        what = f"chunk at byte {ref.offset} is {fault}"
        there, lost = by_topic(expected, self.channels), by_topic(missing, self.channels)
        if there and not lost:
            self.report(f"{what}, but all of its {there.total():,} messages are found")
            return
        start_ns, end_ns = ref.start_ns, ref.end_ns  # by the index, or what stands behind the chunk
        if not (start_ns or end_ns):
            times = [time_ns for time_ns, _ in listing.entries()]
            start_ns, end_ns = min(times, default=0), max(times, default=0)
        span = ""
        if start_ns or end_ns:
            span = f"between {time_text(start_ns)} and {time_text(end_ns)}"
        if lost:
            self.report(f"{what}: {lost_text(lost, there)}{span and f', {span},'} are lost", lost)
        else:
            messages = f"messages {span}" if span else "some of its messages"
            self.report(f"{what}: {messages} are lost")

    def _message(self, time_ns: int, number: int, data: bytes) -> Iterator[Message]:
        """A message in ROS 2 CDR; one that cannot be read as its type is reported and left out."""
        topic, type_name, ros1 = self.channels[number]
        fault = ""
        if not ros1 and data.startswith(MAGIC["zstd"]):  # rosbag2 compressed it by itself
            data, complete, _ = unpacked = decompress(data, "zstd", self.chunk_max)
            fault = "" if complete else f"is {unpacked.fault}"
        elif ros1 and type_name in SUPPORTED_TYPES:
            try:
                data = bytes(typestore().ros1_to_cdr(data, type_name))
            except UNFIT:
                fault = f"does not fit its type {type_name}"
        if fault:
            told = f"the message on {topic} at {time_text(time_ns)} {fault}; left out"
            self.report(told, {topic: 1})
            return
        yield Message(topic, type_name, time_ns, data)


def entries_at(records: bytes, spots: Iterable[Spot]) -> Iterator[Entry]:
    """The messages at some places of records."""
    for time_ns, channel, start, end in spots:
        yield Entry(time_ns, channel, records[start:end])
