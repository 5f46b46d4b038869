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
def test_what_was_packed_is_there_again(name: str) -> None:
    packed = PACK[name](TEXT)
    assert compression_of(packed) == name
    assert decompress(packed, name, LIMIT) == (TEXT, True, False)
    assert decompress(PACK[name](b""), name, LIMIT) == (b"", True, False)


@every
def test_blocks_one_after_another_are_all_read(name: str) -> None:
    packed = PACK[name](TEXT) + PACK[name](b"more") + PACK[name](b"and more")
    assert decompress(packed, name, LIMIT) == (TEXT + b"moreand more", True, False)
    for size in (1, 3, 1000):
        slices = [packed[i : i + size] for i in range(0, len(packed), size)]
        parts = list(stream(slices, name))
        assert b"".join(part for part, _ in parts) == TEXT + b"moreand more"
        assert parts[-1][1]


@every
def test_zeros_may_pad_a_block_and_anything_else_is_damage(name: str) -> None:
    packed = PACK[name](TEXT)
    assert decompress(packed + bytes(512), name, LIMIT) == (TEXT, True, False)
    padded = packed + bytes(9) + PACK[name](b"more") + bytes(3)
    assert decompress(padded, name, LIMIT) == (TEXT + b"more", True, False)
    for rest in (b"\n", b"notes of someone", bytes(70_000) + b"x"):
        assert decompress(packed + rest, name, LIMIT) == (TEXT, False, False)


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
@pytest.mark.parametrize("size", [0, 5, len(TEXT) + 1, 1 << 40])
def test_a_wrong_word_on_the_size_is_not_believed(name: str, size: int) -> None:
    assert decompress(PACK[name](TEXT), name, LIMIT, size) == (TEXT, True, False)


@every
def test_a_block_of_known_size_is_checked_to_its_end(name: str) -> None:
    packed = PACK[name](TEXT)
    assert decompress(packed + packed, name, LIMIT, len(TEXT)) == (TEXT + TEXT, True, False)
    assert decompress(packed + b"x", name, LIMIT, len(TEXT)) == (TEXT, False, False)
    assert not decompress(packed[:-3], name, LIMIT, len(TEXT)).complete
    assert decompress(PACK[name](b""), name, LIMIT, 0) == (b"", True, False)


@every
def test_no_piece_of_a_bomb_is_large(name: str) -> None:
    packed = PACK[name](bytes(40_000_000))
    assert len(packed) < 200_000
    sizes = [len(part) for part, _ in stream([packed], name)]
    assert sum(sizes) == 40_000_000
    assert max(sizes) <= 32 << 20
