"""ROS 1 bags, format 2.0: with their index, without one, and damaged.

A bag is a sequence of records of a header (named fields) and data. Chunks hold the messages and
the connections they came on; the end of the file repeats the connections and says where the
chunks are.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import NamedTuple

from specmap_cli.logs.readers import chunked
from specmap_cli.logs.readers.compression import Unpacked, decompress
from specmap_cli.logs.readers.encoding import NS_PER_S, normalized_type
from specmap_cli.logs.readers.recording import refused

MESSAGE, BAG_HEADER, INDEX, CHUNK, CHUNK_INFO, CONNECTION = range(2, 8)
INDEX_ENTRY = struct.Struct("<III")  # of an index record: seconds, nanoseconds, place in the chunk
U32, U64, U32_PAIR = struct.Struct("<I"), struct.Struct("<Q"), struct.Struct("<II")

_OPCODES = frozenset(bytes([opcode]) for opcode in range(2, 8))
_FIELDS = {  # by the format, what the header of a record of each opcode holds
    MESSAGE: {b"conn", b"time"},
    BAG_HEADER: {b"index_pos", b"conn_count", b"chunk_count"},
    INDEX: {b"ver", b"conn", b"count"},
    CHUNK: {b"compression", b"size"},
    CHUNK_INFO: {b"ver", b"chunk_pos", b"start_time", b"end_time", b"count"},
    CONNECTION: {b"conn", b"topic"},
}

Fields = dict[bytes, bytes]


class Record(NamedTuple):
    """A record's place: its fields, where its data starts and how long it is."""

    fields: Fields
    start: int
    length: int

    @property
    def opcode(self) -> int:
        """What kind of record it is."""
        return self.fields[b"op"][0]

    @property
    def end(self) -> int:
        """Where its data ends."""
        return self.start + self.length

    @property
    def sound(self) -> bool:
        """Whether its header holds what those of its kind do."""
        return self.fields.keys() >= _FIELDS[self.opcode]


class BadRecordError(ValueError):
    """Bytes that are no record."""


def parse_record(data: bytes, position: int) -> Record:
    """The record at `position` of `data`, whose own data may reach beyond the end.

    Raises BadRecordError where there is none.
    """
    try:
        header = U32.unpack_from(data, position)[0]
        start = position + 4 + header
        length = U32.unpack_from(data, start)[0]
    except struct.error:
        raise BadRecordError(position) from None
    fields = parse_fields(data, position + 4, start)
    if fields.get(b"op", b"")[:1] not in _OPCODES:
        raise BadRecordError(position)
    return Record(fields, start + 4, length)


def parse_fields(data: bytes, position: int, end: int) -> Fields:
    """The fields `name=value` of a header; raises BadRecordError where there is none."""
    fields: Fields = {}
    while position + 4 <= end:
        length = U32.unpack_from(data, position)[0]
        position += 4
        if position + length > end:
            raise BadRecordError(position)
        name, separator, value = data[position : position + length].partition(b"=")
        if not separator:
            raise BadRecordError(position)
        fields[name] = value
        position += length
    return fields


def connection_of(fields: Fields) -> int:
    """The number of the connection that a record is of."""
    return int(U32.unpack(fields[b"conn"])[0])


def time_of(value: bytes) -> int:
    """Nanoseconds of a field that holds a time."""
    seconds_, nanoseconds = U32_PAIR.unpack(value)
    return int(seconds_) * NS_PER_S + int(nanoseconds)


MAGIC = b"#ROSBAG V"
_FIRST_LINE = b"#ROSBAG V2.0"
_FIRST_RECORD = len(_FIRST_LINE) + 1
_MAX_HEADER_BYTES = 1 << 20  # headers have some hundred bytes: a longer one is damaged
_RECORDS_CHECKED = 20_000  # about a second of reading, for an explanation that nothing needs
_BAD_RECORD = (BadRecordError, KeyError, struct.error)


class Rosbag1File(chunked.ChunkedFile):
    """One ROS 1 bag."""

    format = "ROS 1 bag"
    magic = MAGIC

    def _read_index(self) -> chunked.Index | None:
        line = self.read_at(0, 32).split(b"\n")[0]
        if line != _FIRST_LINE:
            version = line.removeprefix(MAGIC).decode("ascii", errors="replace")
            found = f"bag format {version[:8]} is not supported"
            raise refused(self.path, found, "bring it to 2.0 with `rosbag fix`")
        try:
            header = self._record(_FIRST_RECORD)
            if header.opcode != BAG_HEADER:
                return None
            position = U64.unpack(header.fields[b"index_pos"])[0]
            return self._index_at(position, header.fields) if position else None
        except _BAD_RECORD:
            return None

    def _index_at(self, position: int, header: Fields) -> chunked.Index | None:
        """The index that starts at `position`, None when it is not what the bag header says."""
        counts: Counter[int] = Counter()
        refs: list[chunked.ChunkRef] = []
        connections: set[int] = set()
        while position < self.size:
            record = self._record(position)
            data = self.read_at(record.start, min(record.length, self.chunk_max))
            if record.opcode == CONNECTION:
                self._connect(record.fields, data)
                connections.add(connection_of(record.fields))
            elif record.opcode == CHUNK_INFO:
                refs.append(_chunk_ref(record.fields, data))
            position = record.end
        expected = [len({ref.offset for ref in refs}), len(connections)]
        if expected != [U32.unpack(header[key])[0] for key in (b"chunk_count", b"conn_count")]:
            return None
        sound: list[chunked.ChunkRef] = []
        for ref in refs:
            chunk = self._record_or_none(ref.offset)
            if chunk is None or chunk.opcode != CHUNK or chunk.end > self.size:
                self._tell(ref, "damaged", chunked.NOTHING_LISTED, ref.counts, ref.counts)
                continue
            size = U32.unpack(chunk.fields.get(b"size", bytes(4)))[0]
            sound.append(replace(ref, length=chunk.end - ref.offset, size=size))
            counts.update(ref.counts)
        if not set(counts) <= connections or not sound:
            return None
        start, end = min(ref.start_ns for ref in sound), max(ref.end_ns for ref in sound)
        index = chunked.Index(self.contents_of(counts, start, end), tuple(sound), checked=False)
        broken = self._broken_record(sorted(ref.offset for ref in sound))
        if broken is not None:
            self.report(
                f"the record at byte {broken} is damaged and was passed over: "
                f"all {index.contents.messages} messages of the file's list of chunks are there"
            )
        return index

    def _broken_record(self, chunks: list[int]) -> int | None:
        """Offset of a record, of the first ones, that does not lead to the next chunk; or None."""
        offset = before = _FIRST_RECORD
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

    def _open_chunk(self, ref: chunked.ChunkRef) -> Unpacked:
        """The records inside a chunk."""
        record = self._record(ref.offset)
        if record.length > self.chunk_max:
            return Unpacked(b"", complete=False, beyond=True)
        data = self.read_at(record.start, record.length)
        compression = record.fields.get(b"compression", b"").decode("ascii", errors="replace")
        size = int.from_bytes(record.fields.get(b"size", b""), "little")
        found = decompress(data, compression, self.chunk_max, size)
        complete = found.complete and len(found.data) == size and len(data) == record.length
        return found._replace(complete=complete and record.sound)

    def _listing(self, ref: chunked.ChunkRef) -> chunked.Listing:
        counts: Counter[int] = Counter()
        places: list[tuple[int, int]] = []  # of the entries: offset and length
        position = ref.offset + ref.length
        while (record := self._record_or_none(position)) is not None:
            fields = record.fields
            if record.opcode != INDEX or not record.sound or len(fields[b"count"]) != 4:
                break
            count = U32.unpack(fields[b"count"])[0]
            if count * INDEX_ENTRY.size != record.length or len(fields[b"conn"]) != 4:
                return chunked.NOTHING_LISTED
            counts[connection_of(fields)] += count
            places.append((record.start, record.length))
            position = record.end
        rows = partial(self.rows_at, places, INDEX_ENTRY)
        return chunked.Listing(
            counts, lambda: sorted((s * NS_PER_S + ns, at) for s, ns, at in rows())
        )

    def _salvaged(self) -> Iterator[chunked.Entry]:
        offset, last = _FIRST_RECORD, 0
        while offset < self.size or offset == _FIRST_RECORD:
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
            start, offset, count = offset, record.end, record.fields.get(b"count", b"")
            counted = offset
            if record.opcode == INDEX and len(count) == 4:
                counted = record.start + INDEX_ENTRY.size * U32.unpack(count)[0]
            if counted != offset:  # some writers give their index records a wrong length
                there = self._record_or_none(counted) is not None
                offset = counted if there else offset
                what = "and was passed over" if there else ": what it holds is lost"
                self.report(f"the record at byte {start} is damaged{what}")

    def _held(self, offset: int, record: Record) -> Iterator[chunked.Entry]:
        """The messages in a record met on the walk, or in its readable part."""
        if record.opcode == CHUNK:
            ref = chunked.ChunkRef(offset=offset, length=record.end - offset)
            yield from chunked.entries_at(*self._read_spots(ref))
            return
        whole = record.sound and record.end <= self.size
        if record.opcode in (MESSAGE, CONNECTION) and whole:
            data = self.read_at(offset, min(record.end - offset, self.chunk_max))
            spots, whole = self._spots(data, chunked.NOTHING_LISTED)
            yield from chunked.entries_at(data, spots)
        if not whole and record.end <= self.size:  # of a cut the walk tells
            self.report(f"record at byte {offset} is damaged: what it holds is lost")

    def _record_or_none(self, offset: int) -> Record | None:
        try:
            return self._record(offset)
        except BadRecordError:
            return None

    def _record(self, offset: int) -> Record:
        """The record at `offset`; raises BadRecordError where there is none."""
        length = self.read_at(offset, 4)
        if len(length) < 4 or not 0 < U32.unpack(length)[0] <= _MAX_HEADER_BYTES:
            raise BadRecordError(offset)
        head = length + self.read_at(offset + 4, U32.unpack(length)[0] + 4)
        record = parse_record(head, 0)
        return record._replace(start=offset + record.start)

    def _spots(self, records: bytes, listing: chunked.Listing) -> tuple[list[chunked.Spot], bool]:
        spots: list[chunked.Spot] = []
        position: int | None = 0
        whole, known = True, self.channels
        while position is not None and position < len(records) and len(spots) < chunked.MAX_SPOTS:
            try:
                fields, start, length = record = parse_record(records, position)
                end = start + length
                if end > len(records):
                    raise BadRecordError(position)
                number = connection_of(fields)
                if record.opcode == CONNECTION:
                    self._connect(fields, records[start:end])
                elif record.opcode == MESSAGE and number in known:
                    spots.append((time_of(fields[b"time"]), number, start, end))
                else:
                    whole = False
                position = end
            except _BAD_RECORD:
                whole = False
                position = listing.next_start(position)
        return spots, whole and position == len(records)

    def _connect(self, fields: Fields, data: bytes) -> None:
        """Take in a connection record."""
        described = parse_fields(data, 0, len(data))
        topic = fields[b"topic"].decode("utf-8", errors="replace")
        name = described[b"type"].decode("utf-8", errors="replace")
        self.define(connection_of(fields), chunked.Channel(topic, normalized_type(name), ros1=True))


def _chunk_ref(fields: Fields, data: bytes) -> chunked.ChunkRef:
    """What the index says of a chunk; raises BadRecordError when it does not fit together."""
    pairs = list(U32_PAIR.iter_unpack(data[: len(data) // U32_PAIR.size * U32_PAIR.size]))
    counts = dict(pairs)
    if len(counts) != U32.unpack(fields[b"count"])[0] or len(counts) * U32_PAIR.size != len(data):
        raise BadRecordError(0)
    return chunked.ChunkRef(
        start_ns=time_of(fields[b"start_time"]),
        end_ns=time_of(fields[b"end_time"]),
        offset=U64.unpack(fields[b"chunk_pos"])[0],
        channels=frozenset(counts),
        counts=counts,
    )
