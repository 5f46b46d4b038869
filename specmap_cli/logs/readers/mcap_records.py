"""Records of MCAP files, version 0: an opcode, the length of the body, and the body."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from io import BytesIO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.records import Statistics

MAGIC = b"\x89MCAP0\r\n"

HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(0x01, 0x09)
ATTACHMENT, STATISTICS, METADATA, DATA_END = 0x09, 0x0B, 0x0C, 0x0F
FIRST_PRIVATE = 0x80  # records from here on are to be passed over

# Before the end of the data no other records stand.
_OF_DATA = frozenset(
    {HEADER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, ATTACHMENT, METADATA, DATA_END}
)

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


def stream_of(body: bytes) -> ReadDataStream:
    """A body as the parsers of the `mcap` package want it."""
    return ReadDataStream(BytesIO(body))


def records_in(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Opcode and body of one record after the other; struct.error where none is whole."""
    position = 0
    while position < len(data):
        opcode, length = RECORD_HEAD.unpack_from(data, position)
        position += RECORD_HEAD.size
        yield opcode, data[position : position + length]
        position += length


def counts_in(statistics: bytes) -> dict[int, int]:
    """The messages of each channel by a statistics record; none when it contradicts itself."""
    try:
        told = Statistics.read(stream_of(statistics))
    except BAD_BODY:
        return {}
    counts: dict[int, int] = told.channel_message_counts
    return counts if sum(counts.values()) == told.message_count else {}


def seen_bytes(opcode: int) -> int:
    """How many bytes of the body `fits` has to see."""
    return _BODY_MAX_SEEN if opcode in (ATTACHMENT, METADATA) else CHUNK_HEAD.size


def fits(opcode: int, length: int, first: bool, body: bytes) -> bool:
    """Whether a body is built like the records of its opcode that stand among the data.

    `body` are the first bytes of it, `first` says that the record is the first one of the file.
    Schemas and channels are judged where they are parsed.
    """
    if opcode not in _OF_DATA:
        return False
    try:
        if opcode == MESSAGE_INDEX:
            return bool(_U32.unpack_from(body, 2)[0] == length - 2 - _U32.size)
        if opcode in (ATTACHMENT, METADATA):
            return _named_length(opcode, body) == length
    except struct.error:
        return False
    exact = {DATA_END: _DATA_END_BYTES, HEADER: length if first else -1}
    least = {MESSAGE: MESSAGE_HEAD.size, CHUNK: CHUNK_HEAD.size}
    return length == exact.get(opcode, length) and length >= least.get(opcode, 0)


def _named_length(opcode: int, body: bytes) -> int:
    """The length that the fields of an attachment or a metadata record add up to."""
    position = _ATTACHMENT_TIMES if opcode == ATTACHMENT else 0
    for _ in range(2):  # the name and the media type, or the name and the map
        position += _U32.size + _U32.unpack_from(body, position)[0]
    if opcode == METADATA:
        return position
    return int(position + _U64.size + _U64.unpack_from(body, position)[0] + _CRC_BYTES)
