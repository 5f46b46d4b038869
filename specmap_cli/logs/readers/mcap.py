"""MCAP files: with their index, without one, and cut off.

The layout is that of the MCAP specification, version 0: records of an opcode, a length and a body,
messages either among them or inside chunk records, a summary at the end.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from io import BytesIO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.records import Channel as ChannelRecord
from mcap.records import ChunkIndex, Footer, Schema, Statistics

from specmap_cli.logs.readers import chunked
from specmap_cli.logs.readers.compression import Unpacked, decompress
from specmap_cli.logs.readers.encoding import normalized_type

MAGIC = b"\x89MCAP0\r\n"

HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(0x01, 0x09)
ATTACHMENT, STATISTICS, METADATA, DATA_END = 0x09, 0x0B, 0x0C, 0x0F
FIRST_PRIVATE = 0x80  # records from here on are to be passed over

RECORD_HEAD = struct.Struct("<BQ")  # opcode, length of the body
MESSAGE_HEAD = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
CHUNK_HEAD = struct.Struct("<QQQII")  # start, end, size, crc, length of the compression's name
INDEX_HEAD = struct.Struct("<BQHI")  # of a message index: opcode, length, channel, bytes of entries
INDEX_ENTRY = struct.Struct("<QQ")  # log time, place in the chunk
BAD_BODY = (struct.error, ValueError, McapError)

_U32, _U64 = struct.Struct("<I"), struct.Struct("<Q")
_ATTACHMENT_TIMES, _CRC_BYTES = 16, 4
_DATA_END_BYTES = 4
_BODY_MAX_SEEN = 1 << 16  # of an attachment or a metadata record, enough for its names
_FOOTER_BODY = 20  # by the format: two offsets and a checksum
_FOOTER_BYTES = RECORD_HEAD.size + _FOOTER_BODY + len(MAGIC)


class McapFile(chunked.ChunkedFile):
    """One MCAP file of ROS 2 or ROS 1 messages."""

    format = "MCAP"
    magic = MAGIC

    def _read_index(self) -> chunked.Index | None:
        self._schemas: dict[int, str] = {}
        self._told: dict[int, int] = {}  # messages by channel, as a statistics record has them
        footer = self._footer()
        if footer is None:
            return None
        summary = self.read_at(
            footer.summary_start, self.size - footer.summary_start - _FOOTER_BYTES
        )
        chunks: list[ChunkIndex] = []
        statistics: Statistics | None = None
        try:
            position = 0
            while position < len(summary):
                opcode, length = RECORD_HEAD.unpack_from(summary, position)
                position += RECORD_HEAD.size + length
                body = summary[position - length : position]
                if opcode == CHUNK_INDEX:
                    chunks.append(ChunkIndex.read(ReadDataStream(BytesIO(body))))
                elif opcode == STATISTICS:
                    statistics = Statistics.read(ReadDataStream(BytesIO(body)))
                else:
                    self._define(opcode, body)
        except BAD_BODY:
            return None
        counts = statistics.channel_message_counts if statistics is not None else {}
        if (
            statistics is None
            or not chunks
            or len({chunk.chunk_start_offset for chunk in chunks}) != statistics.chunk_count
            or sum(counts.values()) != statistics.message_count
            or not counts.keys() <= self.channels.keys()
        ):
            return None
        times = statistics.message_start_time, statistics.message_end_time
        chunks.sort(key=lambda chunk: (chunk.message_start_time, chunk.chunk_start_offset))
        refs = tuple(
            chunked.ChunkRef(
                offset=chunk.chunk_start_offset,
                length=chunk.chunk_length,
                size=chunk.uncompressed_size,
                start_ns=chunk.message_start_time,
                end_ns=chunk.message_end_time,
                channels=frozenset(chunk.message_index_offsets) or None,
            )
            for chunk in chunks
        )
        return chunked.Index(
            self.contents_of(counts, *times), refs, checked=bool(footer.summary_crc)
        )

    def _footer(self) -> Footer | None:
        """The footer when the file ends in one that names a sound summary."""
        tail = self.read_at(max(self.size - _FOOTER_BYTES, 0), _FOOTER_BYTES)
        if len(tail) < _FOOTER_BYTES or not tail.endswith(MAGIC) or tail[0] != FOOTER:
            return None
        footer: Footer = Footer.read(ReadDataStream(BytesIO(tail[RECORD_HEAD.size :])))
        length = self.size - _FOOTER_BYTES - footer.summary_start
        if footer.summary_start < len(MAGIC) or not 0 < length <= self.chunk_max:
            return None
        if footer.summary_crc:
            checked = self.read_at(footer.summary_start, length) + tail[: RECORD_HEAD.size + 16]
            if zlib.crc32(checked) != footer.summary_crc:
                return None
        return footer

    def _open_chunk(self, ref: chunked.ChunkRef) -> Unpacked:
        if ref.length > self.chunk_max + CHUNK_HEAD.size + RECORD_HEAD.size:
            return Unpacked(b"", complete=False, beyond=True)
        record = self.read_at(ref.offset, ref.length)
        if len(record) < RECORD_HEAD.size + CHUNK_HEAD.size:
            return Unpacked(b"", complete=False)
        _, _, size, crc, name_length = CHUNK_HEAD.unpack_from(record, RECORD_HEAD.size)
        name = RECORD_HEAD.size + CHUNK_HEAD.size
        start = name + name_length + _U64.size
        compression = record[name : start - _U64.size].decode("ascii", errors="replace")
        found = decompress(record[start:], compression, self.chunk_max, size)
        sized = found.complete and len(found.data) == size
        if crc and sized and zlib.crc32(found.data) != crc:
            return Unpacked(b"", complete=False)
        head = RECORD_HEAD.pack(CHUNK, ref.length - RECORD_HEAD.size)
        return found._replace(complete=sized and record.startswith(head))

    def _listing(self, ref: chunked.ChunkRef) -> chunked.Listing:
        counts: Counter[int] = Counter()
        places: list[tuple[int, int]] = []
        position = ref.offset + ref.length
        while len(head := self.read_at(position, INDEX_HEAD.size)) == INDEX_HEAD.size:
            opcode, length, channel, size = INDEX_HEAD.unpack(head)
            if opcode != MESSAGE_INDEX or size != length - 6 or size % INDEX_ENTRY.size:
                break
            counts[channel] += size // INDEX_ENTRY.size
            places.append((position + INDEX_HEAD.size, size))
            position += INDEX_HEAD.size + size
        return chunked.Listing(counts, lambda: sorted(self.rows_at(places, INDEX_ENTRY)))

    def _salvaged(self) -> Iterator[chunked.Entry]:
        found: Counter[int] = Counter()
        for entry in self._data():
            found[entry.channel] += 1
            yield entry
        listed = chunked.by_topic(self._told, self.channels)
        self.compare(listed, chunked.by_topic(found, self.channels))

    def _data(self) -> Iterator[chunked.Entry]:
        """The messages of all records, and those that stand behind the end of the data."""
        offset, last = len(MAGIC), 0
        while offset + RECORD_HEAD.size <= self.size:
            opcode, length = RECORD_HEAD.unpack(self.read_at(offset, RECORD_HEAD.size))
            end = offset + RECORD_HEAD.size + length
            if self._ends_data(opcode, length, end):
                yield from self._behind(offset)
                return
            ref = chunked.ChunkRef(offset=offset, length=RECORD_HEAD.size + length)
            if self._is_of_data(opcode, ref):
                for entry in self._held(opcode, ref):
                    last = entry.time_ns
                    yield entry
            elif not self._passes_over(opcode, ref):
                self.report_end(offset, last)
                return
            offset = end
        self.report_end(self.size, last)

    def _behind(self, start: int) -> Iterator[chunked.Entry]:
        """What stands behind the end of the data: counts, and messages, which are read and told."""
        cut = self.read_at(self.size - len(MAGIC), len(MAGIC)) != MAGIC
        offset = start
        while offset + (0 if cut else len(MAGIC)) < self.size:
            head = self.read_at(offset, RECORD_HEAD.size).ljust(RECORD_HEAD.size, b"\xff")
            opcode, length = RECORD_HEAD.unpack(head)
            ref = chunked.ChunkRef(offset=offset, length=RECORD_HEAD.size + length)
            offset += ref.length
            if offset > self.size:
                sure = cut and opcode not in (CHUNK, MESSAGE)
                lost = "no message should stand there, any that does is lost"
                self.report(
                    f"{'cut off' if cut else 'damaged'} in the index at byte {ref.offset}: "
                    f"{'no message is lost' if sure else lost}"
                )
                return
            if opcode == STATISTICS:
                body = self.read_at(ref.offset + RECORD_HEAD.size, min(length, self.chunk_max))
                self._told = {}
                with suppress(*BAD_BODY):
                    told = Statistics.read(ReadDataStream(BytesIO(body)))
                    counts: dict[int, int] = told.channel_message_counts
                    self._told = counts if sum(counts.values()) == told.message_count else {}
            elif opcode in (CHUNK, MESSAGE) and self._is_of_data(opcode, ref):
                self.report(
                    f"the record at byte {ref.offset} stands behind the end of the data at byte "
                    f"{start}: it is read all the same"
                )
                yield from self._held(opcode, ref)
            elif opcode == FOOTER and offset + len(MAGIC) < self.size:
                more = self.size - offset - len(MAGIC)
                self.report(
                    f"{more:,} bytes follow the end of the file at byte {offset + len(MAGIC)}: "
                    "what they hold is lost"
                )
                return
        if cut:
            self.report(f"cut off in the index at byte {offset}: no message is lost")

    def _ends_data(self, opcode: int, length: int, end: int) -> bool:
        """Whether a record is the end of the data, or the footer of a file without such an end."""
        if opcode == FOOTER:
            return length == _FOOTER_BODY and end + len(MAGIC) >= self.size
        return opcode == DATA_END and length == _DATA_END_BYTES

    def _is_of_data(self, opcode: int, ref: chunked.ChunkRef) -> bool:
        """Whether a record is built like those of its opcode; two kinds are judged when parsed."""
        length = ref.length - RECORD_HEAD.size
        if opcode == HEADER:
            return ref.offset == len(MAGIC)
        if opcode == DATA_END:
            return length == _DATA_END_BYTES
        if opcode in (MESSAGE, CHUNK):
            return length >= (MESSAGE_HEAD if opcode == MESSAGE else CHUNK_HEAD).size
        if opcode not in (MESSAGE_INDEX, ATTACHMENT, METADATA):
            return opcode in (SCHEMA, CHANNEL)
        seen = INDEX_HEAD.size if opcode == MESSAGE_INDEX else _BODY_MAX_SEEN
        body = self.read_at(ref.offset + RECORD_HEAD.size, seen)
        try:
            if opcode == MESSAGE_INDEX:
                return bool(_U32.unpack_from(body, 2)[0] == length - 2 - _U32.size)
            position = _ATTACHMENT_TIMES if opcode == ATTACHMENT else 0
            for _ in range(2):  # the name and the media type, or the name and the map
                position += _U32.size + _U32.unpack_from(body, position)[0]
            if opcode == ATTACHMENT:
                position += _U64.size + _U64.unpack_from(body, position)[0] + _CRC_BYTES
        except struct.error:
            return False
        return position == length

    def _passes_over(self, opcode: int, ref: chunked.ChunkRef) -> bool:
        """Whether reading can go on behind a record of another kind; it is said what it may be."""
        end = ref.offset + ref.length
        head = self.read_at(end, RECORD_HEAD.size)
        if end > self.size or len(head) < RECORD_HEAD.size:
            return False
        following, length = RECORD_HEAD.unpack(head)
        then = chunked.ChunkRef(offset=end, length=RECORD_HEAD.size + length)
        ended = self._ends_data(following, length, end + then.length)
        if opcode < FIRST_PRIVATE and not ended and not self._is_of_data(following, then):
            return False
        body = self.read_at(ref.offset + RECORD_HEAD.size, CHUNK_HEAD.size)
        may_hold = opcode < FIRST_PRIVATE
        if not may_hold and len(body) >= MESSAGE_HEAD.size:
            # a private record: built like a message of a known channel, or like a chunk
            name = CHUNK_HEAD.unpack(body)[-1] if len(body) == CHUNK_HEAD.size else self.size
            start = RECORD_HEAD.size + CHUNK_HEAD.size + name + _U64.size
            size = self.read_at(ref.offset + start - _U64.size, _U64.size)
            is_chunk = ref.length == start + int.from_bytes(size, "little")
            may_hold = MESSAGE_HEAD.unpack_from(body)[0] in self.channels or is_chunk
        if may_hold:
            fault = "damaged" if opcode <= DATA_END else "of no known kind"
            self.report(
                f"the record at byte {ref.offset} is {fault} (opcode {opcode}): what it "
                f"holds in its {ref.length:,} bytes is lost"
            )
        return True

    def _held(self, opcode: int, ref: chunked.ChunkRef) -> Iterator[chunked.Entry]:
        """The messages of a record met on the walk: one, a chunk's, or none of a definition."""
        if opcode == CHUNK:
            head = self.read_at(ref.offset + RECORD_HEAD.size, CHUNK_HEAD.size)
            start_ns, end_ns = CHUNK_HEAD.unpack(head.ljust(CHUNK_HEAD.size))[:2]
            ref = replace(ref, start_ns=start_ns, end_ns=end_ns)
            yield from chunked.entries_at(*self._read_spots(ref))
        elif opcode in (SCHEMA, CHANNEL, MESSAGE) and ref.offset + ref.length <= self.size:
            if ref.length > self.chunk_max:
                place = f"the record at byte {ref.offset}"
                self.report(f"{place} is beyond log.chunk_max_mb: it is lost")
                return
            record = self.read_at(ref.offset, ref.length)
            spots, whole = self._spots(record, chunked.NOTHING_LISTED)
            yield from chunked.entries_at(record, spots)
            if not whole:  # or of an unknown channel
                self.report(f"the record at byte {ref.offset} is damaged: what it holds is lost")

    def _spots(self, records: bytes, listing: chunked.Listing) -> tuple[list[chunked.Spot], bool]:
        spots: list[chunked.Spot] = []
        position: int | None = 0
        whole, size, known = True, len(records), self.channels
        last = size - RECORD_HEAD.size
        while position is not None and position <= last and len(spots) < chunked.MAX_SPOTS:
            opcode, length = RECORD_HEAD.unpack_from(records, position)
            start = position + RECORD_HEAD.size
            end = start + length
            sound = end <= size
            if sound and opcode == MESSAGE and length >= MESSAGE_HEAD.size:
                channel, _, time_ns, _ = MESSAGE_HEAD.unpack_from(records, start)
                if channel in known:
                    spots.append((time_ns, channel, start + MESSAGE_HEAD.size, end))
                else:
                    whole = False
            else:
                defines = sound and opcode in (SCHEMA, CHANNEL)
                whole = whole and defines and self._define(opcode, records[start:end])
                if not defines:
                    end = listing.next_start(position)
            position = end
        return spots, whole and position == size

    def _define(self, opcode: int, body: bytes) -> bool:
        """Take in a schema or a channel; False when it cannot be parsed and defines nothing."""
        try:
            if opcode == SCHEMA:
                schema = Schema.read(ReadDataStream(BytesIO(body)))
                self._schemas[schema.id] = normalized_type(schema.name)
            elif opcode == CHANNEL:
                channel = ChannelRecord.read(ReadDataStream(BytesIO(body)))
                name = self._schemas.get(channel.schema_id, "unknown")
                encoding = channel.message_encoding
                if encoding not in ("cdr", "ros1"):
                    name = f"{name} ({encoding or 'no encoding'})"
                self.define(channel.id, chunked.Channel(channel.topic, name, encoding == "ros1"))
        except BAD_BODY:
            return False
        return True
