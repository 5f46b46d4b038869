"""Chunks of MCAP files: what the index says of them, and the records inside."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Collection, Iterable, Sequence
from functools import partial

from mcap.records import ChunkIndex, Statistics

from specmap_cli.logs.readers.chunks import ChunkRef, Listing
from specmap_cli.logs.readers.compression import Unpacked, decompress
from specmap_cli.logs.readers.mcap_records import (
    CHUNK_HEAD,
    INDEX_ENTRY,
    INDEX_HEAD,
    MESSAGE_INDEX,
)

# Up to so many bytes from an offset on: offset, length.
ReadAt = Callable[[int, int], bytes]


def chunk_refs(chunks: Iterable[ChunkIndex]) -> tuple[ChunkRef, ...]:
    """What the index says of the chunks, by start."""
    return tuple(
        ChunkRef(
            offset=chunk.chunk_start_offset,
            length=chunk.chunk_length,
            size=chunk.uncompressed_size,
            start_ns=chunk.message_start_time,
            end_ns=chunk.message_end_time,
            channels=frozenset(chunk.message_index_offsets) or None,
        )
        for chunk in sorted(chunks, key=lambda c: (c.message_start_time, c.chunk_start_offset))
    )


def agree(statistics: Statistics, chunks: Sequence[ChunkIndex], channels: Collection[int]) -> bool:
    """Whether the parts of a summary fit one another."""
    counts = statistics.channel_message_counts
    return (
        bool(chunks)
        and len({chunk.chunk_start_offset for chunk in chunks}) == statistics.chunk_count
        and sum(counts.values()) == statistics.message_count
        and set(counts) <= set(channels)
    )


def listing_at(position: int, read_at: ReadAt, limit: int) -> Listing:
    """What the message indexes say that stand from `position` on, behind a chunk."""
    counts: dict[int, int] = {}
    places: list[tuple[int, int]] = []  # of the entries: offset and length
    while len(head := read_at(position, INDEX_HEAD.size)) == INDEX_HEAD.size:
        opcode, length, channel, size = INDEX_HEAD.unpack(head)
        if opcode != MESSAGE_INDEX or size != length - 6 or size % INDEX_ENTRY.size:
            break
        counts[channel] = counts.get(channel, 0) + size // INDEX_ENTRY.size
        places.append((position + INDEX_HEAD.size, size))
        position += INDEX_HEAD.size + size
    return Listing(counts, partial(_entries, places, read_at, limit))


def _entries(
    places: Sequence[tuple[int, int]], read_at: ReadAt, limit: int
) -> list[tuple[int, int]]:
    entries: list[tuple[int, int]] = []
    for offset, length in places:
        data = read_at(offset, min(length, limit))
        whole = data[: len(data) // INDEX_ENTRY.size * INDEX_ENTRY.size]
        entries += INDEX_ENTRY.iter_unpack(whole)
    return sorted(entries)


def records_of(body: bytes, limit: int) -> Unpacked:
    """The records inside the body of a chunk, possibly cut off."""
    if len(body) < CHUNK_HEAD.size:
        return Unpacked(b"", complete=False)
    _, _, size, crc, name_length = CHUNK_HEAD.unpack_from(body)
    start = CHUNK_HEAD.size + name_length + 8
    compression = body[CHUNK_HEAD.size : start - 8].decode("ascii", errors="replace")
    found = decompress(body[start:], compression, limit, size)
    if crc and found.complete and len(found.data) == size and zlib.crc32(found.data) != crc:
        return Unpacked(b"", complete=False)
    return found._replace(complete=found.complete and len(found.data) == size)
