"""The first bytes of a file, and whether they are text."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.errors import LogError
from specmap_cli.logs.opening import HEAD_BYTES, head_of
from specmap_cli.logs.readers.recording import is_text


@pytest.mark.parametrize("size", [0, 1, HEAD_BYTES, HEAD_BYTES + 1])
def test_a_head_is_as_long_as_the_file_or_a_page(tmp_path: Path, size: int) -> None:
    path = tmp_path / "log"
    path.write_bytes(bytes(size))
    assert head_of(path) == bytes(min(size, 4096))


def test_a_file_that_is_not_there_has_no_head(tmp_path: Path) -> None:
    with pytest.raises(LogError) as caught:
        head_of(tmp_path / "log")
    assert str(caught.value) == f"{tmp_path / 'log'}: no such file or directory"
    with pytest.raises(LogError, match="cannot read: Is a directory"):
        head_of(tmp_path)


@given(st.text("aß€😀", min_size=1), st.integers(1, 40))
def test_text_is_text_wherever_its_head_ends(text: str, length: int) -> None:
    assert is_text(text.encode()[:length])


@pytest.mark.parametrize("head", [b"\xff\xfe plain", b"plain \x80 and plain", b"\xc3 (cut) again"])
def test_other_bytes_are_no_text(head: bytes) -> None:
    assert not is_text(head)
