"""Decompression of bounded size that keeps what a damaged or cut-off block still yields.

A few kilobytes can claim to be gigabytes. So no decompressor is ever asked for output without a
bound: a block of a known size is unpacked at once, all others piece by piece.
"""

from __future__ import annotations

import bz2
import zlib
from collections.abc import Callable, Iterable, Iterator
from io import BytesIO
from typing import Any, NamedTuple

import lz4.frame
import zstandard

_SLICE_BYTES = 1 << 16  # compressed bytes taken at once
_PIECE_BYTES = 1 << 20  # unpacked bytes asked for at once
# Of zstd, which takes no bound: 4 bytes can stand for a block of 128 kB, so these for 32 MB.
_ZSTD_SLICE_BYTES = 1 << 10
_GZIP_HEADER = 16 + zlib.MAX_WBITS  # zlib's way to say that a gzip header comes first

_FAILURES = (zstandard.ZstdError, zlib.error, RuntimeError, OSError, ValueError, EOFError)

# The first bytes of compressed data, by the definition of each format.
MAGIC = {
    "zstd": b"\x28\xb5\x2f\xfd",
    "lz4": b"\x04\x22\x4d\x18",
    "bz2": b"BZh",
    "gzip": b"\x1f\x8b",
}


class Unpacked(NamedTuple):
    """The bytes behind a block; `beyond` says that they would be more than was allowed."""

    data: bytes
    complete: bool
    beyond: bool = False


def decompress(data: bytes, compression: str, limit: int, size: int | None = None) -> Unpacked:
    """The bytes behind `data`, none of them when they are more than `limit`.

    `compression` is "" or "none", "zstd", "lz4", "bz2" or "gzip"; data of an unknown one yields
    nothing. `size` is what they should amount to, where that is known: then an intact block is
    unpacked at once. Never raises: a damaged block yields what precedes the damage.
    """
    if compression in ("", "none"):
        beyond = len(data) > limit
        return Unpacked(b"" if beyond else data, complete=not beyond, beyond=beyond)
    if compression not in MAGIC:
        return Unpacked(b"", complete=False)
    known = size is not None and size <= limit
    whole = _at_once(data, compression, size or 0) if known else None
    if whole is not None:
        return Unpacked(whole, complete=True)
    return _by_pieces(data, compression, limit)


def _at_once(data: bytes, compression: str, size: int) -> bytes | None:
    """An intact block of `size` bytes, None when it is anything else."""
    try:
        if compression == "zstd":
            if zstandard.frame_content_size(data) not in (size, -1):  # -1: the frame does not say
                return None
            unpacker = zstandard.ZstdDecompressor()
            whole = unpacker.decompress(data, max_output_size=size, allow_extra_data=False)
            return whole if len(whole) == size else None
        block = _BLOCKS[compression]()
        whole = block.decompress(data, size + 1)  # one more, so that the end is met
    except _FAILURES:
        return None
    return whole if len(whole) == size and block.eof and not block.unused_data else None


def _by_pieces(data: bytes, compression: str, limit: int) -> Unpacked:
    slices = (data[i : i + _SLICE_BYTES] for i in range(0, len(data), _SLICE_BYTES))
    found = BytesIO()
    complete = False
    for part, complete in stream(slices, compression):  # noqa: B007 (the last one counts)
        found.write(part)
        if found.tell() > limit:
            return Unpacked(b"", complete=False, beyond=True)
    return Unpacked(found.getvalue(), complete)


def stream(slices: Iterable[bytes], compression: str) -> Iterator[tuple[bytes, bool]]:
    """Decompress slice by slice: (bytes, whether all compressed data was whole and read so far).

    Several compressed blocks may follow one another, as parallel tools and `cat` write them, and
    zeros may stand between and behind them. Anything else behind a block is damage. A piece has
    32 MB at the most, mostly 1 MB.
    """
    pending = iter(slices)
    block = _BLOCKS[compression]()
    data = next(pending, b"")
    while data:
        try:
            for part in _FEEDS[compression](block, data):
                yield part, False
        except _FAILURES:
            yield b"", False
            return
        if block.eof:
            yield b"", True
            data = _next_block(block.unused_data or b"", pending, len(MAGIC[compression]))
            block = _BLOCKS[compression]()
        else:
            data = next(pending, b"")


class _ZstdBlock:
    """One frame of zstd, fed in small slices, as its decompressor takes no bound."""

    def __init__(self) -> None:
        self._frame = zstandard.ZstdDecompressor().decompressobj()
        self.unused_data = b""

    @property
    def eof(self) -> bool:
        """Whether the end of the frame has been met."""
        return bool(self._frame.eof)

    def feed(self, data: bytes) -> Iterator[bytes]:
        """What `data` adds, in pieces of bounded size."""
        for start in range(0, len(data), _ZSTD_SLICE_BYTES):
            end = start + _ZSTD_SLICE_BYTES
            yield self._frame.decompress(data[start:end])
            if self._frame.eof:
                self.unused_data = self._frame.unused_data + data[end:]
                return


def _feed_gzip(block: Any, data: bytes) -> Iterator[bytes]:
    part = b""
    while data or len(part) == _PIECE_BYTES:  # a full piece may leave more behind it
        part = block.decompress(data, _PIECE_BYTES)
        yield part
        if block.eof:
            return
        data = block.unconsumed_tail


def _feed_bounded(block: Any, data: bytes) -> Iterator[bytes]:
    part = block.decompress(data, _PIECE_BYTES)
    yield part
    while part and not (block.eof or block.needs_input):
        part = block.decompress(b"", _PIECE_BYTES)
        yield part


_BLOCKS: dict[str, Callable[[], Any]] = {
    "zstd": _ZstdBlock,
    "lz4": lz4.frame.LZ4FrameDecompressor,
    "bz2": bz2.BZ2Decompressor,
    "gzip": lambda: zlib.decompressobj(_GZIP_HEADER),
}
_FEEDS: dict[str, Callable[[Any, bytes], Iterator[bytes]]] = {
    "zstd": _ZstdBlock.feed,
    "lz4": _feed_bounded,
    "bz2": _feed_bounded,
    "gzip": _feed_gzip,
}


def _next_block(rest: bytes, pending: Iterator[bytes], length: int) -> bytes:
    """What follows the end of a block and its padding: `length` bytes or more, fewer at the end."""
    rest = rest.lstrip(b"\x00")
    while len(rest) < length and (piece := next(pending, b"")):
        rest = (rest + piece).lstrip(b"\x00")
    return rest


def compression_of(head: bytes) -> str | None:
    """The compression of a file by its first bytes, None when it is not compressed."""
    return next((name for name, magic in MAGIC.items() if head.startswith(magic)), None)
