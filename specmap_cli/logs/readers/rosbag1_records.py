"""Records of ROS 1 bags, format 2.0: a header of named fields, then data."""

from __future__ import annotations

import struct
from typing import NamedTuple

from specmap_cli.logs.readers.typestore import NS_PER_S

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
