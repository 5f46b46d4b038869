"""MCAP files: with their index, without one, and cut off.

The layout is that of the MCAP specification, version 0: records of an opcode, a length and a body,
messages either among them or inside chunk records, a summary at the end.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from operator import itemgetter
from pathlib import Path

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.records import Channel as ChannelRecord
from mcap.records import ChunkIndex, Footer, Schema, Statistics

from specmap_cli.logs.readers.chunked import Channel, ChunkedFile, ChunkRef, Entry, Index
from specmap_cli.logs.readers.compression import decompress
from specmap_cli.logs.readers.recording import Contents, TopicInfo, seconds
from specmap_cli.logs.readers.typestore import normalized_type

MAGIC = b"\x89MCAP0\r\n"

FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, CHUNK_INDEX = 0x02, 0x03, 0x04, 0x05, 0x06, 0x08
STATISTICS, DATA_END = 0x0B, 0x0F
_LAST_OPCODE = 0x0F  # 0x80 and above are private records, to be skipped

_RECORD = struct.Struct("<BQ")  # opcode, length of the body
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_CHUNK = struct.Struct("<QQQII")  # start, end, size, crc, length of the compression's name
_FOOTER_BYTES = _RECORD.size + 20 + len(MAGIC)
_BAD_BODY = (struct.error, ValueError, McapError)


class McapFile(ChunkedFile):
    """One MCAP file of ROS 2 or ROS 1 messages."""

    format = "MCAP"

    def __init__(self, path: Path) -> None:
        self._schemas: dict[int, str] = {}
        super().__init__(path)

    def _read_index(self) -> Index | None:
        start = self._summary_start()
        if start is None:
            return None
        summary = self.read_at(start, self.size - start - _FOOTER_BYTES)
        chunks: list[ChunkIndex] = []
        statistics: Statistics | None = None
        try:
            for opcode, body in _records(summary):
                if opcode == CHUNK_INDEX:
                    chunks.append(ChunkIndex.read(_stream(body)))
                elif opcode == STATISTICS:
                    statistics = Statistics.read(_stream(body))
                else:
                    self._define(opcode, body)
        except _BAD_BODY:
            return None
        if statistics is None or len(chunks) != statistics.chunk_count or not chunks:
            return None
        if not set(statistics.channel_message_counts) <= set(self.channels):
            return None
        refs = tuple(self._sound_chunks(chunks))
        return Index(self._contents_of(statistics), refs) if refs else None

    def _summary_start(self) -> int | None:
        """Offset of the summary when the file ends in a footer that names a sound one."""
        tail = self.read_at(max(self.size - _FOOTER_BYTES, 0), _FOOTER_BYTES)
        if len(tail) < _FOOTER_BYTES or not tail.endswith(MAGIC) or tail[0] != FOOTER:
            return None
        footer = Footer.read(_stream(tail[_RECORD.size :]))
        end = self.size - _FOOTER_BYTES
        if not len(MAGIC) <= footer.summary_start < end:
            return None
        if footer.summary_crc:
            summary = self.read_at(footer.summary_start, end - footer.summary_start)
            checked = summary + tail[: _RECORD.size + 16]
            if zlib.crc32(checked) != footer.summary_crc:
                return None
        return int(footer.summary_start)

    def _sound_chunks(self, chunks: list[ChunkIndex]) -> Iterator[ChunkRef]:
        """The chunks that are where the index says; the others are reported."""
        for chunk in sorted(chunks, key=lambda c: (c.message_start_time, c.chunk_start_offset)):
            ref = ChunkRef(
                chunk.message_start_time,
                chunk.message_end_time,
                chunk.chunk_start_offset,
                chunk.chunk_length,
                frozenset(chunk.message_index_offsets),
            )
            head = self.read_at(ref.offset, _RECORD.size)
            if head == _RECORD.pack(CHUNK, max(ref.length - _RECORD.size, 0)):
                yield ref
            else:
                self.report_chunk(ref)

    def _contents_of(self, statistics: Statistics) -> Contents:
        counts: dict[tuple[str, str], int] = {}
        for number, channel in self.channels.items():
            key = (channel.topic, channel.type)
            count = statistics.channel_message_counts.get(number, 0)
            counts[key] = counts.get(key, 0) + count
        return Contents(
            tuple(TopicInfo(*key, counts[key]) for key in sorted(counts)),
            statistics.message_start_time,
            statistics.message_end_time,
        )

    def _chunk(self, ref: ChunkRef) -> Iterator[Entry]:
        body = self.read_at(ref.offset + _RECORD.size, ref.length - _RECORD.size)
        records, complete = _opened(body)
        if not complete:
            self.report_chunk(ref)
        for time_ns, channel, start, end in sorted(self._entries(records), key=itemgetter(0)):
            yield Entry(time_ns, channel, records[start:end])

    def _walk(self) -> Iterator[Entry]:
        offset, last = len(MAGIC), 0
        while offset + _RECORD.size <= self.size:
            opcode, length = _RECORD.unpack(self.read_at(offset, _RECORD.size))
            start = offset + _RECORD.size
            if opcode in (DATA_END, FOOTER):
                if self.read_at(self.size - len(MAGIC), len(MAGIC)) != MAGIC:
                    self.report(f"cut off in the index after byte {offset}: no message is lost")
                return
            if opcode == 0 or _LAST_OPCODE < opcode < 0x80:
                self.report_end(offset, last)
                return
            for entry in self._held(opcode, offset, start, length):
                last = entry.time_ns
                yield entry
            offset = start + length
        self.report_end(self.size, last)

    def _held(self, opcode: int, offset: int, start: int, length: int) -> Iterator[Entry]:
        """The messages of a record met on the walk, or of the readable part of a chunk."""
        if opcode == CHUNK:
            yield from self._walk_chunk(offset, self.read_at(start, length))
        elif opcode in (SCHEMA, CHANNEL, MESSAGE) and start + length <= self.size:
            yield from self._single(opcode, self.read_at(start, length))

    def _walk_chunk(self, offset: int, body: bytes) -> Iterator[Entry]:
        """The entries of a chunk met on the walk, or of its readable part."""
        records, complete = _opened(body)
        last = None
        for time_ns, channel, start, end in self._entries(records):
            last = time_ns
            yield Entry(time_ns, channel, records[start:end])
        if not complete and offset + _RECORD.size + len(body) < self.size:
            kept = "all of it is" if last is None else f"what followed {seconds(last)} in it is"
            self.report(f"chunk at byte {offset} is damaged: {kept} lost")

    def _single(self, opcode: int, body: bytes) -> Iterator[Entry]:
        """A message outside any chunk, or a definition."""
        if opcode != MESSAGE:
            self._define(opcode, body)
        elif len(body) >= _MESSAGE.size:
            channel, _, time_ns, _ = _MESSAGE.unpack_from(body)
            if channel in self.channels:
                yield Entry(time_ns, channel, body[_MESSAGE.size :])

    def _entries(self, records: bytes) -> Iterator[tuple[int, int, int, int]]:
        """(log time, channel, start, end) of each whole message in the records of a chunk."""
        position, size = 0, len(records)
        while position + _RECORD.size <= size:
            opcode, length = _RECORD.unpack_from(records, position)
            position += _RECORD.size
            end = position + length
            if end > size:
                return
            if opcode == MESSAGE and length >= _MESSAGE.size:
                channel, _, time_ns, _ = _MESSAGE.unpack_from(records, position)
                if channel in self.channels:
                    yield time_ns, channel, position + _MESSAGE.size, end
            elif opcode in (SCHEMA, CHANNEL):
                self._define(opcode, records[position:end])
            position = end

    def _define(self, opcode: int, body: bytes) -> None:
        """Take in a schema or a channel; one that cannot be parsed defines nothing."""
        try:
            if opcode == SCHEMA:
                schema = Schema.read(_stream(body))
                self._schemas[schema.id] = normalized_type(schema.name)
            elif opcode == CHANNEL:
                channel = ChannelRecord.read(_stream(body))
                name = self._schemas.get(channel.schema_id, "unknown")
                encoding = channel.message_encoding
                if encoding not in ("cdr", "ros1"):
                    name = f"{name} ({encoding or 'no encoding'})"
                self.channels[channel.id] = Channel(channel.topic, name, encoding == "ros1")
        except _BAD_BODY:
            return


def _stream(body: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(body))


def _records(data: bytes) -> Iterator[tuple[int, bytes]]:
    position = 0
    while position < len(data):
        opcode, length = _RECORD.unpack_from(data, position)
        position += _RECORD.size
        yield opcode, data[position : position + length]
        position += length


def _opened(body: bytes) -> tuple[bytes, bool]:
    """The records inside the body of a chunk, possibly cut off, and whether they are all there."""
    if len(body) < _CHUNK.size:
        return b"", False
    _, _, size, crc, name_length = _CHUNK.unpack_from(body)
    start = _CHUNK.size + name_length + 8
    compression = body[_CHUNK.size : start - 8].decode("ascii", errors="replace")
    records, complete = decompress(body[start:], compression)
    if complete and len(records) == size:
        return (b"", False) if crc and zlib.crc32(records) != crc else (records, True)
    return records, False
