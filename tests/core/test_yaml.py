"""YAML as it is read: text, lists and mappings, and one line for all that is refused."""

from __future__ import annotations

import re

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.text import to_json
from specmap_cli.core.yaml import read_yaml, yaml_text
from tests.strategies import few

_NO_YAML = [b"a: [1", b"a: b: c", b"a\n---\nb", b"{a, b: ]", b"? [1]\n: 2"]
_KEYS = st.from_regex("[a-z_]{3,9}x", fullmatch=True)
_PLAIN = st.text(st.characters(codec="utf-8"), max_size=12)
_LEAVES = st.one_of(_PLAIN, st.booleans(), st.integers(), st.floats(-1e6, 1e6))
_VALUES = st.recursive(
    _LEAVES,
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(_KEYS, inner)),
    max_leaves=8,
)


def test_words_stay_words() -> None:
    text = "a: 010\nb: [on, 1:30, 1_0, 2001-01-01]\nc: ~\nd: !!python/name:os.system ''\n"
    found = read_yaml(text.encode())
    assert found == {"a": "010", "b": ["on", "1:30", "1_0", "2001-01-01"], "c": "~", "d": ""}
    assert read_yaml(b"") is None
    assert read_yaml("a: \u00fc".encode("utf-16")) == {"a": "\u00fc"}


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"a: &x [1]\nb: *x\n", "line 2: aliases (`*`) are not read"),
        (b"a: &x [*x]\n", "line 1: aliases (`*`) are not read"),
        (b"a: 1\nb: 2\na: 3\n", "line 1: a key comes twice in what begins here"),
        (b"[" * 100_000, "line 1: nested too deeply"),
        (b"- " * 100_000, "line 1: nested too deeply"),
        (b"\xff\xfe\x00", "not a text file"),
        (b"a: \x00", "not a text file"),
        *((data, None) for data in _NO_YAML),
    ],
)
def test_what_is_refused_or_no_yaml_is_told_in_one_line(data: bytes, said: str | None) -> None:
    told = rf"^{re.escape(said)}$" if said else r"^line \d+: [^\n]+$"
    with pytest.raises(ValueError, match=told):
        read_yaml(data)


@given(st.dictionaries(_KEYS, _VALUES))
@few(40)
def test_what_is_written_is_read_back(value: dict[str, object]) -> None:
    text = yaml_text(value)
    assert to_json(yaml.safe_load(text)) == to_json(value)  # which has six decimals, too
    assert read_yaml(text.encode()) is not None
