"""Mutations of bytes, which fit every file."""

from __future__ import annotations

import random
from collections.abc import Callable

from fuzz.changes import Change, spot

_LONGEST = 200  # bytes taken out, put in or written over at once
_TELLING = (0x00, 0x01, 0x7F, 0x80, 0xFF)


def _flip(rng: random.Random, data: bytes) -> Change:
    place, bit = spot(rng, len(data)), 1 << rng.randrange(8)
    changed = data[:place] + bytes([data[place] ^ bit]) + data[place + 1 :]
    return Change(changed, f"bit {bit:#04x} of byte {place} flipped")


def _set(rng: random.Random, data: bytes) -> Change:
    place = spot(rng, len(data))
    value = rng.choice([*_TELLING, rng.randrange(256)])
    changed = data[:place] + bytes([value]) + data[place + 1 :]
    return Change(changed, f"byte {place} set to {value:#04x}")


def _delete(rng: random.Random, data: bytes) -> Change:
    place, length = spot(rng, len(data)), rng.choice([1, 1, 4, rng.randrange(1, _LONGEST)])
    return Change(data[:place] + data[place + length :], f"{length} bytes cut out at {place}")


def _insert(rng: random.Random, data: bytes) -> Change:
    place, length = spot(rng, len(data)), rng.choice([1, 1, 4, rng.randrange(1, _LONGEST)])
    new = rng.choice([rng.randbytes(length), bytes(length), b"\xff" * length])
    return Change(data[:place] + new + data[place:], f"{length} bytes put in at {place}")


def _overwrite(rng: random.Random, data: bytes) -> Change:
    place, length = spot(rng, len(data)), rng.choice([2, 4, 8, rng.randrange(1, _LONGEST)])
    new = rng.choice([rng.randbytes(length), bytes(length), b"\xff" * length])
    changed = (data[:place] + new + data[place + length :])[: len(data)]
    return Change(changed, f"{length} bytes written over at {place}")


def _duplicate(rng: random.Random, data: bytes) -> Change:
    place, length = spot(rng, len(data)), rng.randrange(1, 10 * _LONGEST)
    piece = data[place : place + length]
    return Change(data[:place] + piece + data[place:], f"{len(piece)} bytes at {place} twice")


def _truncate(rng: random.Random, data: bytes) -> Change:
    place = spot(rng, len(data))
    return Change(data[:place], f"cut off at byte {place}")


_KINDS: tuple[Callable[[random.Random, bytes], Change], ...] = (
    _flip,
    _flip,
    _set,
    _delete,
    _insert,
    _overwrite,
    _duplicate,
    _truncate,
)


def change_bytes(rng: random.Random, data: bytes) -> Change:
    """Some bytes flipped, set, deleted, inserted, written over, repeated, or cut off."""
    return rng.choice(_KINDS)(rng, data) if data else Change(b"\x00", "a byte in an empty file")
