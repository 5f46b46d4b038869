"""ROS 1 bags, format 2.0: with their index, without one, and damaged.

A bag is a sequence of records of a header (named fields) and data. Chunks hold the messages and
the connections they came on; the end of the file repeats the connections and says where the
chunks are.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from operator import attrgetter
from pathlib import Path
from typing import NamedTuple

from specmap_cli.core.errors import LogError
from specmap_cli.logs.readers.chunked import Channel, ChunkedFile, ChunkRef, Entry, Index
from specmap_cli.logs.readers.compression import decompress
from specmap_cli.logs.readers.recording import Contents, TopicInfo
from specmap_cli.logs.readers.typestore import NS_PER_S, normalized_type

MAGIC = b"#ROSBAG V"
MESSAGE, BAG_HEADER, INDEX, CHUNK, CHUNK_INFO, CONNECTION = range(2, 8)
_OPCODES = frozenset(bytes([opcode]) for opcode in range(2, 8))
_MAX_HEADER_BYTES = 1 << 20
_RECORDS_CHECKED = 20_000
_INDEX_ENTRY_BYTES = 12
_U32, _U64, _U32_PAIR = struct.Struct("<I"), struct.Struct("<Q"), struct.Struct("<II")

Fields = dict[bytes, bytes]


class _Record(NamedTuple):
    """A record's place: its fields, where its data starts and how long it is."""

    fields: Fields
    start: int
    length: int

    @property
    def opcode(self) -> int:
        return self.fields[b"op"][0]

    @property
    def end(self) -> int:
        return self.start + self.length


class BadRecordError(ValueError):
    """Bytes that are no record."""


class Rosbag1File(ChunkedFile):
    """One ROS 1 bag."""

    format = "ROS 1 bag"

    def __init__(self, path: Path) -> None:
        self._first = 0
        super().__init__(path)

    def _read_index(self) -> Index | None:
        line = self.read_at(0, 32).split(b"\n")[0]
        if line != b"#ROSBAG V2.0":
            version = line.removeprefix(MAGIC).decode("ascii", errors="replace")
            message = f"{self.path}: bag format {version[:8]} is not supported"
            raise LogError(f"{message}; bring it to 2.0 with `rosbag fix`")
        self._first = len(line) + 1
        try:
            header = self._record(self._first)
            if header.opcode != BAG_HEADER:
                return None
            position = _U64.unpack(header.fields[b"index_pos"])[0]
            chunks = _U32.unpack(header.fields[b"chunk_count"])[0]
            return self._index_at(position, chunks) if position else None
        except (BadRecordError, KeyError, struct.error):
            return None

    def _index_at(self, position: int, expected: int) -> Index | None:
        """The index that starts at `position`, None when chunks of the file are missing in it."""
        counts: dict[int, int] = {}
        refs: list[ChunkRef] = []
        found = 0
        while position < self.size:
            record = self._record(position)
            data = self.read_at(record.start, record.length)
            if record.opcode == CONNECTION:
                self._connect(record.fields, data)
            elif record.opcode == CHUNK_INFO:
                found += 1
                ref, contained = _chunk_info(record.fields, data)
                if self._is_chunk(ref):
                    refs.append(ref)
                    for connection, count in contained.items():
                        counts[connection] = counts.get(connection, 0) + count
            position = record.end
        if found != expected or not set(counts) <= set(self.channels) or not refs:
            return None
        index = Index(self._contents_of(counts, refs), tuple(refs))
        broken = self._broken_record(sorted(ref.offset for ref in refs))
        if broken is not None:
            self.report(
                f"the record at byte {broken} is damaged and was passed over: "
                f"all {index.contents.messages} messages of the file's list of chunks are there"
            )
        return index

    def _broken_record(self, chunks: list[int]) -> int | None:
        """Offset of a record that does not lead to the next chunk, None when all is well.

        Looks at so many records only, as it explains damage but is not needed for reading.
        """
        offset = before = self._first
        checked = 0
        for chunk in chunks:
            while offset < chunk and checked < _RECORDS_CHECKED:
                record = self._record_or_none(offset)
                if record is None:
                    return before
                before, offset, checked = offset, record.end, checked + 1
            if offset > chunk:
                return before
        return None

    def _is_chunk(self, ref: ChunkRef) -> bool:
        """Whether a chunk record starts where the index says; if not, it is reported."""
        try:
            record = self._record(ref.offset)
            sound = record.opcode == CHUNK and record.end <= self.size
        except BadRecordError:
            sound = False
        if not sound:
            self.report_chunk(ref)
        return sound

    def _contents_of(self, counts: dict[int, int], refs: list[ChunkRef]) -> Contents:
        topics: dict[tuple[str, str], int] = {}
        for number, channel in self.channels.items():
            key = (channel.topic, channel.type)
            topics[key] = topics.get(key, 0) + counts.get(number, 0)
        return Contents(
            tuple(TopicInfo(*key, topics[key]) for key in sorted(topics)),
            min(ref.start_ns for ref in refs),
            max(ref.end_ns for ref in refs),
        )

    def _chunk(self, ref: ChunkRef) -> Iterator[Entry]:
        record = self._record(ref.offset)
        data, complete = self._opened(record)
        if not complete:
            self.report_chunk(ref)
        yield from sorted(self._entries(data), key=attrgetter("time_ns"))

    def _walk(self) -> Iterator[Entry]:
        offset, last = self._first, 0
        while offset < self.size or offset == self._first:
            record = self._record_or_none(offset)
            if record is None:
                self.report_end(offset, last)
                return
            for entry in self._held(offset, record):
                last = entry.time_ns
                yield entry
            if record.end > self.size:
                self.report_end(self.size, last)
                return
            offset = self._following(offset, record)

    def _held(self, offset: int, record: _Record) -> Iterator[Entry]:
        """The messages in a record met on the walk, or in its readable part."""
        if record.opcode == CHUNK:
            data, complete = self._opened(record)
            yield from self._entries(data)
            if not complete and record.end <= self.size:
                self.report(f"chunk at byte {offset} is damaged: some of its messages are lost")
        elif record.opcode in (MESSAGE, CONNECTION) and record.end <= self.size:
            yield from self._entries(self.read_at(offset, record.end - offset))

    def _following(self, offset: int, record: _Record) -> int:
        """Where the next record starts: some writers give their index records a wrong length."""
        end = record.end
        count = record.fields.get(b"count", b"")
        if record.opcode != INDEX or len(count) != 4 or self._record_or_none(end) is not None:
            return end
        counted = record.start + _INDEX_ENTRY_BYTES * _U32.unpack(count)[0]
        if counted == end or self._record_or_none(counted) is None:
            return end
        self.report(f"the record at byte {offset} is damaged and was passed over")
        return int(counted)

    def _record_or_none(self, offset: int) -> _Record | None:
        try:
            return self._record(offset)
        except BadRecordError:
            return None

    def _record(self, offset: int) -> _Record:
        """The record at `offset`; raises BadRecordError where there is none."""
        length = self.read_at(offset, 4)
        if len(length) < 4 or not 0 < _U32.unpack(length)[0] <= _MAX_HEADER_BYTES:
            raise BadRecordError(offset)
        head = length + self.read_at(offset + 4, _U32.unpack(length)[0] + 4)
        record = _parse(head, 0)
        return record._replace(start=offset + record.start)

    def _opened(self, record: _Record) -> tuple[bytes, bool]:
        """The records inside a chunk and whether they are all there."""
        data = self.read_at(record.start, record.length)
        compression = record.fields.get(b"compression", b"").decode("ascii", errors="replace")
        records, complete = decompress(data, compression)
        return records, complete and len(data) == record.length

    def _entries(self, data: bytes) -> Iterator[Entry]:
        """The messages among the records in `data`, up to the first that is not whole."""
        position = 0
        while position < len(data):
            try:
                fields, start, length = record = _parse(data, position)
                opcode = record.opcode
                position = start + length
                if position > len(data):
                    return
                if opcode == CONNECTION:
                    self._connect(fields, data[start:position])
                elif opcode == MESSAGE:
                    connection = _U32.unpack(fields[b"conn"])[0]
                    if connection in self.channels:
                        yield Entry(_time(fields[b"time"]), connection, data[start:position])
            except (BadRecordError, KeyError, struct.error):
                return

    def _connect(self, fields: Fields, data: bytes) -> None:
        """Take in a connection record."""
        described = _fields(data, 0, len(data))
        topic = fields[b"topic"].decode("utf-8", errors="replace")
        name = described[b"type"].decode("utf-8", errors="replace")
        number = _U32.unpack(fields[b"conn"])[0]
        self.channels[number] = Channel(topic, normalized_type(name), ros1=True)


def _parse(data: bytes, position: int) -> _Record:
    """The record at `position` of `data`, whose own data may reach beyond the end."""
    try:
        header = _U32.unpack_from(data, position)[0]
        start = position + 4 + header
        length = _U32.unpack_from(data, start)[0]
    except struct.error:
        raise BadRecordError(position) from None
    fields = _fields(data, position + 4, start)
    if fields.get(b"op", b"")[:1] not in _OPCODES:
        raise BadRecordError(position)
    return _Record(fields, start + 4, length)


def _fields(data: bytes, position: int, end: int) -> Fields:
    """The fields `name=value` of a header."""
    fields: Fields = {}
    while position + 4 <= end:
        length = _U32.unpack_from(data, position)[0]
        position += 4
        if position + length > end:
            raise BadRecordError(position)
        name, separator, value = data[position : position + length].partition(b"=")
        if not separator:
            raise BadRecordError(position)
        fields[name] = value
        position += length
    return fields


def _time(value: bytes) -> int:
    seconds_, nanoseconds = _U32_PAIR.unpack(value)
    return int(seconds_) * NS_PER_S + int(nanoseconds)


def _chunk_info(fields: Fields, data: bytes) -> tuple[ChunkRef, dict[int, int]]:
    """Where a chunk is, and how many messages of each connection it holds."""
    counts = dict(_U32_PAIR.iter_unpack(data[: 8 * _U32.unpack(fields[b"count"])[0]]))
    ref = ChunkRef(
        _time(fields[b"start_time"]),
        _time(fields[b"end_time"]),
        _U64.unpack(fields[b"chunk_pos"])[0],
        0,
        frozenset(counts),
    )
    return ref, counts
