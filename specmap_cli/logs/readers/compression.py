"""Decompression of bounded size that keeps what a damaged or cut-off block still yields.

A few kilobytes can claim to be gigabytes. So no decompressor is ever asked for output without a
bound: a block of a known size is unpacked at once, all others piece by piece. Files that are
compressed as a whole become temporary copies.
"""

from __future__ import annotations

import bz2
import tempfile
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import lz4.frame
import zstandard

from specmap_cli.core.errors import TOO_LARGE, LogError
from specmap_cli.core.settings import LogConfig
from specmap_cli.logs.readers.recording import refused, unreadable

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

    @property
    def fault(self) -> str:
        """What is wrong with a block that is not complete."""
        return "beyond log.chunk_max_mb" if self.beyond else "damaged in its compression"


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
    slices = (data[i : i + _SLICE_BYTES] for i in range(0, len(data), _SLICE_BYTES))
    found = BytesIO()
    complete = False
    for part, complete in stream(slices, compression):  # noqa: B007 (the last one counts)
        found.write(part)
        if found.tell() > limit:
            return Unpacked(b"", complete=False, beyond=True)
    return Unpacked(found.getvalue(), complete)


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
            data = (block.unused_data or b"").lstrip(b"\x00")  # behind the padding
            while len(data) < len(MAGIC[compression]) and (piece := next(pending, b"")):
                data = (data + piece).lstrip(b"\x00")
            block = _BLOCKS[compression]()
        else:
            data = next(pending, b"")


class _ZstdBlock:
    """One frame of zstd, fed in small slices, as its decompressor takes no bound."""

    def __init__(self) -> None:
        self._frame = zstandard.ZstdDecompressor().decompressobj()
        self.eof, self.unused_data = False, b""  # whether the end of the frame has been met

    def feed(self, data: bytes) -> Iterator[bytes]:
        """What `data` adds, in pieces of bounded size."""
        for start in range(0, len(data), _ZSTD_SLICE_BYTES):
            end = start + _ZSTD_SLICE_BYTES
            yield self._frame.decompress(data[start:end])
            self.eof = bool(self._frame.eof)
            if self.eof:
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


def compression_of(head: bytes) -> str | None:
    """The compression of a file by its first bytes, None when it is not compressed."""
    return next((name for name, magic in MAGIC.items() if head.startswith(magic)), None)


_UNPACKED_RATIO_MAX = 500.0  # a file of 100 MB and more that swells by more is a bomb, no log
LOOKED_AT_BYTES = 1 << 23  # of the copy, before the rest: a CARMEN log is known by less than these

_COPY_BYTES = 1 << 20  # of a compressed file in memory at once
_BYTES_PER_GB = 1e9
_RATIO_FROM_BYTES = 100_000_000  # a small copy may swell as it likes


def unpacked(
    path: Path, compression: str, config: LogConfig, look: Callable[[Path], object], held: ExitStack
) -> tuple[Path, str | None]:
    """A copy of what is in a compressed file, which lasts as long as `held`, and what it lacks.

    So a reader may open it as often as it likes. `look` is shown the beginning of the copy and may
    raise to be spared the rest. Raises LogError for a file that swells beyond the settings and
    when there is no room.
    """
    try:
        temporary = tempfile.NamedTemporaryFile(prefix="specmap-")  # noqa: SIM115 (held closes it)
        copy = held.enter_context(temporary)
        looked = complete = ended = False
        for part, complete in stream(_slices(path), compression):
            copy.write(part)
            ended = complete or (ended and not part)
            _refuse_swelling(copy.tell(), path, config)
            if not looked and copy.tell() >= LOOKED_AT_BYTES:
                copy.flush()
                look(Path(copy.name))
                looked = True
        copy.flush()
    except OSError as error:
        found, advice = "cannot unpack into the temporary directory", "set TMPDIR to another one"
        raise LogError.of_system(error, found, advice, where=path) from None
    lost = None
    if ended and not complete:
        lost = f"what follows the {compression} compression is no part of it and was left out"
    elif not complete:
        lost = f"the {compression} compression is damaged or ends early: the rest is lost"
    return Path(copy.name), lost


def _refuse_swelling(copied: int, path: Path, config: LogConfig) -> None:
    if copied > config.unpacked_max_gb * _BYTES_PER_GB:
        bound = f"{config.unpacked_max_gb:g} GB, which log.unpacked_max_gb allows"
        hint = "if it is a log, raise the setting"
    elif copied > max(_UNPACKED_RATIO_MAX * path.stat().st_size, _RATIO_FROM_BYTES):
        bound = f"{_UNPACKED_RATIO_MAX:g} times its size, as no log does"
        hint = "if it is a log, unpack it first"
    else:
        return
    raise refused(path, f"unpacks to more than {bound}", hint, code=TOO_LARGE)


def _slices(path: Path) -> Iterator[bytes]:
    try:
        with path.open("rb") as file:
            while piece := file.read(_COPY_BYTES):
                yield piece
    except OSError as error:
        raise unreadable(path, error) from None
