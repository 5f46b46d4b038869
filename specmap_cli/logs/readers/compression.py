"""Decompression that keeps what a damaged or cut-off block still yields."""

from __future__ import annotations

import bz2
import zlib
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import lz4.frame
import zstandard

MAX_BLOCK_BYTES = 1 << 30  # a chunk that swells beyond this is damaged
_SLICE_BYTES = 1 << 16

_DECOMPRESSORS: dict[str, Callable[[], Any]] = {
    "zstd": lambda: zstandard.ZstdDecompressor().decompressobj(),
    "lz4": lz4.frame.LZ4FrameDecompressor,
    "bz2": bz2.BZ2Decompressor,
    "gzip": lambda: zlib.decompressobj(31),
}
_FAILURES = (zstandard.ZstdError, zlib.error, RuntimeError, OSError, ValueError, EOFError)

# The first bytes of a compressed file.
MAGIC = {b"\x28\xb5\x2f\xfd": "zstd", b"\x1f\x8b": "gzip", b"BZh": "bz2"}


def decompress(data: bytes, compression: str) -> tuple[bytes, bool]:
    """The bytes behind `data` and whether they are complete.

    `compression` is "" or "none", "zstd", "lz4", "bz2" or "gzip"; data of an unknown one yields
    nothing. Never raises: a damaged block yields what precedes the damage.
    """
    if compression in ("", "none"):
        return data, True
    if compression not in _DECOMPRESSORS:
        return b"", False
    slices = (data[i : i + _SLICE_BYTES] for i in range(0, len(data), _SLICE_BYTES))
    parts: list[bytes] = []
    total = 0
    complete = False
    for part, complete in stream(slices, compression):  # noqa: B007 (the last one counts)
        parts.append(part)
        total += len(part)
        if total > MAX_BLOCK_BYTES:
            return b"".join(parts), False
    return b"".join(parts), complete


def stream(slices: Iterable[bytes], compression: str) -> Iterator[tuple[bytes, bool]]:
    """Decompress slice by slice: (bytes, whether the end of the data was reached)."""
    decompressor = _DECOMPRESSORS[compression]()
    for piece in slices:
        try:
            part = decompressor.decompress(piece)
        except _FAILURES:
            yield b"", False
            return
        yield part, bool(decompressor.eof)
        if decompressor.eof:
            return


def compression_of(head: bytes) -> str | None:
    """The compression of a file by its first bytes, None when it is not compressed."""
    return next((name for magic, name in MAGIC.items() if head.startswith(magic)), None)
