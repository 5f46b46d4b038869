"""A file inside gzip, bzip2 or zstd: sound, in several members, with garbage, or swelling."""

from __future__ import annotations

import bz2
import gzip
import random
from functools import cache

import zstandard

from fuzz.byte_changes import change_bytes
from fuzz.changes import Change

FORMATS = ("gz", "bz2", "zst")
_BOMB_BYTES = 64 << 20  # of zeros: a thousandth of that, or less, when compressed
_MOST_BOMBS = {"gz": 4, "bz2": 1, "zst": 4}  # bzip2 takes two seconds for each


def packed(data: bytes, format_: str) -> bytes:
    """The data in one member or frame."""
    if format_ == "gz":
        return gzip.compress(data, 1, mtime=0)
    if format_ == "bz2":
        return bz2.compress(data, 1)
    return zstandard.ZstdCompressor().compress(data)


def change_compressed(rng: random.Random, data: bytes, format_: str) -> Change:
    """The data compressed, and the compression changed."""
    kind = rng.random()
    if kind < 0.25:
        return _members(rng, data, format_)
    if kind < 0.4:
        garbage = b"\x01" + rng.randbytes(rng.choice([0, 2, 19, 2999]))  # zeros are padding
        note = f"{format_} with {len(garbage)} bytes of garbage behind it"
        return Change(packed(data, format_) + garbage, note, foreign=True)
    if kind < 0.45:
        return Change(packed(packed(data, format_), rng.choice(FORMATS)), "compressed twice")
    if kind < 0.5:
        padding = rng.choice([1, 100, 100_000])
        return Change(packed(data, format_) + bytes(padding), f"{format_} and {padding} zeros")
    if kind < 0.53:
        return _bomb(rng, data, format_)
    if kind < 0.6:
        return Change(packed(data, format_), format_)
    change = change_bytes(rng, packed(data, format_))
    return Change(change.data, f"{format_}: {change.note}")


def _members(rng: random.Random, data: bytes, format_: str) -> Change:
    """Several members one after the other, as bgzip, pbzip2 and zstd -T write them."""
    cuts = sorted(rng.randrange(len(data) + 1) for _ in range(rng.choice([1, 1, 2, 5])))
    ends = [*cuts, len(data)]
    pieces = [data[start:end] for start, end in zip([0, *cuts], ends, strict=True)]
    joined = b"".join(packed(piece, format_) for piece in pieces)
    return Change(joined, f"{format_} in {len(pieces)} members")


def _bomb(rng: random.Random, data: bytes, format_: str) -> Change:
    """A small file that swells to some hundred megabytes."""
    count = rng.randrange(1, _MOST_BOMBS[format_] + 1)
    size = count * (_BOMB_BYTES >> 20)
    note = f"{format_} that swells by {size} MB"
    return Change(packed(data, format_) + _zeros(format_) * count, note)


@cache
def _zeros(format_: str) -> bytes:
    return packed(bytes(_BOMB_BYTES), format_)
