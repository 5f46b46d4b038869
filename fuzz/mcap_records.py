"""The records of MCAP files, taken apart and put together by no code of specmap's."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import lz4.frame
import zstandard

MAGIC = b"\x89MCAP0\r\n"
CHUNK, MESSAGE = 0x06, 0x05
_HEAD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQII")


@dataclass(frozen=True, slots=True)
class McapRecord:
    """An opcode and a body; `stated` is its length where it is to be told wrongly."""

    opcode: int
    body: bytes
    stated: int | None = None

    def encoded(self) -> bytes:
        """The bytes of the record."""
        length = len(self.body) if self.stated is None else self.stated
        return _HEAD.pack(self.opcode, length & 0xFFFFFFFFFFFFFFFF) + self.body


@dataclass(frozen=True, slots=True)
class Chunk:
    """What is in a chunk's body: `records` uncompressed, `crc` as stored."""

    start_ns: int
    end_ns: int
    crc: int
    compression: bytes
    records: bytes

    def body(self, size: int | None = None) -> bytes:
        """The body of the chunk's record; `size` is told instead of the true one."""
        told = len(self.records) if size is None else size
        packed = self.records
        if self.compression == b"lz4":
            packed = lz4.frame.compress(packed)
        elif self.compression == b"zstd":
            packed = zstandard.ZstdCompressor().compress(packed)
        head = _CHUNK.pack(self.start_ns, self.end_ns, told, self.crc, len(self.compression))
        return b"".join([head, self.compression, struct.pack("<Q", len(packed)), packed])


def split(data: bytes) -> list[McapRecord]:
    """The records in `data`, which are whole."""
    records, position = [], 0
    while position < len(data):
        opcode, length = _HEAD.unpack_from(data, position)
        start = position + _HEAD.size
        records.append(McapRecord(opcode, data[start : start + length]))
        position = start + length
    return records


def join(records: Sequence[McapRecord]) -> bytes:
    """The bytes of the records, one after the other."""
    return b"".join(record.encoded() for record in records)


def opened(body: bytes) -> Chunk:
    """The chunk in the body of an intact chunk record."""
    start_ns, end_ns, _, crc, length = _CHUNK.unpack_from(body)
    start = _CHUNK.size + length
    compression, packed = body[_CHUNK.size : start], body[start + 8 :]
    if compression == b"lz4":
        packed = lz4.frame.decompress(packed)
    elif compression == b"zstd":
        packed = zstandard.ZstdDecompressor().decompressobj().decompress(packed)
    return Chunk(start_ns, end_ns, crc, compression, packed)


def with_crc(chunk: Chunk, records: bytes, policy: str) -> Chunk:
    """The chunk with other records; `policy`: stale keeps the checksum, none says 0, or right."""
    crc = {"stale": chunk.crc, "none": 0, "right": zlib.crc32(records)}[policy]
    return Chunk(chunk.start_ns, chunk.end_ns, crc, chunk.compression, records)
