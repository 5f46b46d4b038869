"""Files that are a sequence of records holding compressed chunks of messages: MCAP, ROS 1 bags.

With a usable index the chunks are merged by their start times and messages inside a chunk are
sorted by log time. Without one (a recorder that was killed, a truncated or damaged file) the
records are walked from the start, and the readable part of the last chunk is kept.
"""

from __future__ import annotations

import os
from abc import abstractmethod
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import NamedTuple

from rosbags.serde import SerdeError

from specmap_cli.logs.readers.recording import (
    Contents,
    Message,
    Recording,
    merge_in_time,
    seconds,
    survey,
    unreadable,
)
from specmap_cli.logs.readers.typestore import SUPPORTED_TYPES, typestore


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


class ChunkRef(NamedTuple):
    """Where a chunk's record lies; `channels` that have messages in it, empty when unknown."""

    start_ns: int
    end_ns: int
    offset: int
    length: int
    channels: frozenset[int]


@dataclass(frozen=True, slots=True)
class Index:
    """What the summary at the end of a file says."""

    contents: Contents
    chunks: tuple[ChunkRef, ...]


class ChunkedFile(Recording):
    """Common reading of MCAP and ROS 1 bags; a subclass knows the records."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        try:
            self._fd = os.open(path, os.O_RDONLY)
        except OSError as error:
            raise unreadable(path, error) from None
        self.size = os.fstat(self._fd).st_size
        self.channels: dict[int, Channel] = {}
        try:
            self._index = self._read_index()
        except BaseException:
            self.close()
            raise

    @abstractmethod
    def _read_index(self) -> Index | None:
        """The summary and the channels, or None when it is missing or damaged."""

    @abstractmethod
    def _chunk(self, ref: ChunkRef) -> Iterator[Entry]:
        """The entries of one indexed chunk in time order; damage is reported, not raised."""

    @abstractmethod
    def _walk(self) -> Iterator[Entry]:
        """All entries from the first record on; damage is reported and ends or skips."""

    @cached_property
    def contents(self) -> Contents:
        """From the index, or by one pass over a file without."""
        if self._index is not None:
            return self._index.contents
        return survey((*self.channels[entry.channel][:2], entry.time_ns) for entry in self._walk())

    def messages(self, topics: Collection[str] | None = None) -> Iterator[Message]:
        """The messages on `topics`, in time order with an index and as written without."""
        if self._index is None:
            return self._select(self._walk(), topics)
        return merge_in_time(
            [
                (ref.start_ns, partial(self._chunk_messages, ref, topics))
                for ref in self._index.chunks
                if self._holds(ref, topics)
            ]
        )

    def close(self) -> None:
        """Release the file."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def read_at(self, offset: int, length: int) -> bytes:
        """Up to `length` bytes from `offset` on; fewer at the end of the file."""
        try:
            return os.pread(self._fd, max(min(length, self.size - offset), 0), offset)
        except OSError as error:
            raise unreadable(self.path, error) from None

    def report_end(self, offset: int, last_ns: int) -> None:
        """Note that no record can be read at `offset`, where the walk ends; at the end: cut off."""
        where = f"damaged at byte {offset} of {self.size}"
        if offset >= self.size:
            where = f"cut off at byte {self.size}"
        lost = f"what followed {seconds(last_ns)}" if last_ns > 0 else "everything"
        self.report(f"{where}: {lost} is lost")

    def report_chunk(self, ref: ChunkRef) -> None:
        """Note that messages of an indexed chunk are lost."""
        self.report(
            f"chunk at byte {ref.offset} is damaged: messages between {seconds(ref.start_ns)} "
            f"and {seconds(ref.end_ns)} are lost"
        )

    def _holds(self, ref: ChunkRef, topics: Collection[str] | None) -> bool:
        if topics is None or not ref.channels:
            return True
        return any(self.channels[c].topic in topics for c in ref.channels if c in self.channels)

    def _chunk_messages(self, ref: ChunkRef, topics: Collection[str] | None) -> Iterator[Message]:
        return self._select(self._chunk(ref), topics)

    def _select(
        self, entries: Iterator[Entry], topics: Collection[str] | None
    ) -> Iterator[Message]:
        for entry in entries:
            topic, type_name, ros1 = self.channels[entry.channel]
            if topics is not None and topic not in topics:
                continue
            data = entry.data
            if ros1 and type_name in SUPPORTED_TYPES:
                try:
                    data = bytes(typestore().ros1_to_cdr(data, type_name))
                except SerdeError:
                    self.report(f"a message on {topic} does not fit its type {type_name}; skipped")
                    continue
            yield Message(topic, type_name, entry.time_ns, data)
