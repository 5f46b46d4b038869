"""The records of ROS 1 bags, taken apart and put together by no code of specmap's."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

FIRST_LINE = b"#ROSBAG V2.0\n"
CHUNK, INDEX = 5, 4
_U32 = struct.Struct("<I")


@dataclass(frozen=True, slots=True)
class BagRecord:
    """A header of fields, and data; `stated` is its length where it is to be told wrongly."""

    header: bytes
    data: bytes
    stated: int | None = None

    @property
    def opcode(self) -> int:
        """The kind of record, -1 when the header does not say."""
        place = self.header.find(b"op=")
        return self.header[place + 3] if 0 <= place < len(self.header) - 3 else -1

    def encoded(self) -> bytes:
        """The bytes of the record."""
        length = len(self.data) if self.stated is None else self.stated
        return b"".join(
            [_U32.pack(len(self.header)), self.header, _U32.pack(length & 0xFFFFFFFF), self.data]
        )


def split(data: bytes) -> list[BagRecord]:
    """The records in `data`, which are whole."""
    records, position = [], 0
    while position < len(data):
        start = position + 4 + _U32.unpack_from(data, position)[0]
        end = start + 4 + _U32.unpack_from(data, start)[0]
        records.append(BagRecord(data[position + 4 : start], data[start + 4 : end]))
        position = end
    return records


def join(records: Sequence[BagRecord]) -> bytes:
    """The bytes of the records, one after the other."""
    return b"".join(record.encoded() for record in records)


def closed_to_active(data: bytes) -> bytes:
    """A closed bag as its recorder left it before closing: no list of connections and chunks."""
    records = split(data[len(FIRST_LINE) :])
    kept = max(i for i, record in enumerate(records) if record.opcode in (CHUNK, INDEX)) + 1
    head = records[0].header
    for name, width in ((b"index_pos=", 8), (b"chunk_count=", 4), (b"conn_count=", 4)):
        start = head.index(name) + len(name)
        head = head[:start] + bytes(width) + head[start + width :]
    return FIRST_LINE + join([BagRecord(head, records[0].data), *records[1:kept]])
