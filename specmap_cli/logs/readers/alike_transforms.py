"""TFMessages that tell of the same frames over and over: alike but for their stamps and numbers.

Made by the general serialiser once, then by writing the numbers into a copy of its bytes, which is
many times quicker. In CDR an integer begins at a multiple of four bytes behind the header of four
bytes, a double at a multiple of eight; a text has its length before it and a zero behind it.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from itertools import pairwise

from specmap_cli.logs.readers.encoding import Transform, clipped_stamp, transforms_cdr
from specmap_cli.logs.readers.typestore import NS_PER_S

_HEADER_BYTES, _COUNT_BYTES = 4, 4
_STAMP, _NUMBERS = struct.Struct("<iI"), struct.Struct("<7d")


class AlikeTransforms:
    """Messages with a transform parent_from_child for each of `frames`, (parent, child)."""

    def __init__(self, frames: Sequence[tuple[str, str]]) -> None:
        nought = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0)
        self._blank = transforms_cdr(0, [Transform(*link, *nought) for link in frames])
        self._offsets = _offsets(frames)
        gaps = [(0, 0), *(at for pair in self._offsets for at in pair), (len(self._blank),) * 2]
        self._constant = [
            (end, start, self._blank[end:start]) for (_, end), (start, _) in pairwise(gaps)
        ]

    def encoded(self, stamp_ns: int, numbers: Sequence[Sequence[float]]) -> bytes:
        """The message with x, y, z and a quaternion x, y, z, w for each transform, in order."""
        data, stamp = bytearray(self._blank), clipped_stamp(stamp_ns)
        for (when, where), values in zip(self._offsets, numbers, strict=True):
            _STAMP.pack_into(data, when[0], *stamp)
            _NUMBERS.pack_into(data, where[0], *values)
        return bytes(data)

    def decoded(self, data: bytes, place: int) -> tuple[int, tuple[float, ...]] | None:
        """Stamp (ns) and numbers of one of the transforms; None for a message of other frames."""
        if len(data) != len(self._blank):
            return None
        if any(data[start:end] != same for start, end, same in self._constant):
            return None
        when, where = self._offsets[place]
        seconds, nanoseconds = _STAMP.unpack_from(data, when[0])
        return seconds * NS_PER_S + nanoseconds, _NUMBERS.unpack_from(data, where[0])


def _offsets(
    frames: Sequence[tuple[str, str]],
) -> list[tuple[tuple[int, int], tuple[int, int]]]:
    """Of each transform the first byte and the end of its stamp, and of its seven numbers."""
    offsets, end = [], _HEADER_BYTES + _COUNT_BYTES
    for parent, child in frames:
        stamp = _aligned(end, 4)
        end = _after_text(_after_text(stamp + _STAMP.size, parent), child)
        numbers = _aligned(end, 8)
        end = numbers + _NUMBERS.size
        offsets.append(((stamp, stamp + _STAMP.size), (numbers, end)))
    return offsets


def _after_text(offset: int, text: str) -> int:
    return _aligned(offset, 4) + _COUNT_BYTES + len(text.encode()) + 1


def _aligned(offset: int, size: int) -> int:
    """The first offset from this one on where a value of this size may begin."""
    return offset + (_HEADER_BYTES - offset) % size
