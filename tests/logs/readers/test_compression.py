"""Decompression: whole, cut off, damaged, several blocks one after another."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.logs.readers.compression import compression_of, decompress, stream
from tests.logs.recordings import PACK

TEXT = b"".join(b"scan %d of a log\n" % number for number in range(9000))

LIMIT = 1 << 24

every = pytest.mark.parametrize("name", sorted(PACK))


@every
@pytest.mark.parametrize("size", [None, 0, 5, len(TEXT), len(TEXT) + 1, 1 << 40])
def test_all_blocks_are_read_whatever_is_said_of_the_size(name: str, size: int | None) -> None:
    """Zeros may pad them; anything else behind them is damage."""
    pack = PACK[name]
    text, more = pack(TEXT), pack(b"more")
    assert compression_of(text) == name
    for packed, found in (
        (text, TEXT),
        (pack(b""), b""),
        (text + more + pack(b"and more"), TEXT + b"moreand more"),
        (text + bytes(512), TEXT),
        (text + bytes(9) + more + bytes(3), TEXT + b"more"),
    ):
        assert decompress(packed, name, LIMIT, size) == (found, True, False)
    for rest in (b"x", b"\n", b"notes of someone", bytes(70_000) + b"x"):
        assert decompress(text + rest, name, LIMIT, size) == (TEXT, False, False)
    assert not decompress(text[:-3], name, LIMIT, size).complete


@every
@pytest.mark.parametrize("slice_bytes", [1, 3, 1000])
def test_blocks_may_come_in_slices(name: str, slice_bytes: int) -> None:
    packed = PACK[name](TEXT) + PACK[name](b"more")
    slices = [packed[i : i + slice_bytes] for i in range(0, len(packed), slice_bytes)]
    parts = list(stream(slices, name))
    assert b"".join(part for part, _ in parts) == TEXT + b"more"
    assert parts[-1][1]


@every
def test_a_cut_yields_what_precedes_it(name: str) -> None:
    packed = PACK[name](TEXT)
    for tenth in range(10):
        found, complete, _ = decompress(packed[: len(packed) * tenth // 10], name, LIMIT)
        assert not complete
        assert TEXT.startswith(found)
    second = PACK[name](TEXT) + PACK[name](TEXT)[:-8]
    found, complete, _ = decompress(second, name, LIMIT)
    assert not complete
    assert (TEXT + TEXT).startswith(found)
    assert len(found) >= len(TEXT)


@every
@given(place=st.floats(0, 1, exclude_max=True), byte=st.integers(0, 255))
def test_damage_never_raises(name: str, place: float, byte: int) -> None:
    packed = bytearray(PACK[name](TEXT))
    packed[int(place * len(packed))] = byte
    found, complete, _ = decompress(bytes(packed), name, LIMIT)
    assert isinstance(found, bytes)
    assert isinstance(complete, bool)


def test_plain_data_is_as_it_is_and_an_unknown_compression_yields_nothing() -> None:
    for name in ("", "none"):
        assert decompress(b"plain", name, LIMIT) == (b"plain", True, False)
        assert decompress(b"plain", name, 4) == (b"", False, True)
    assert decompress(b"plain", "snappy", LIMIT) == (b"", False, False)
    assert compression_of(b"plain") is None
    assert compression_of(b"") is None


@every
def test_a_block_beyond_the_limit_yields_nothing(name: str) -> None:
    packed = PACK[name](TEXT)
    for size in (None, len(TEXT), 5):
        assert decompress(packed, name, len(TEXT) - 1, size) == (b"", False, True)
        assert decompress(packed, name, len(TEXT), size) == (TEXT, True, False)


@every
def test_no_piece_of_a_bomb_is_large(name: str) -> None:
    packed = PACK[name](bytes(40_000_000))
    assert len(packed) < 200_000
    sizes = [len(part) for part, _ in stream([packed], name)]
    assert sum(sizes) == 40_000_000
    assert max(sizes) <= 32 << 20
