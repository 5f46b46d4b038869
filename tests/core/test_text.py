"""Numbers, JSON, YAML and tables as text: the same bytes for the same values, and back."""

import csv
import io
import json
import math
import re
from dataclasses import dataclass
from typing import Annotated, Any
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field, TypeAdapter, ValidationError

from specmap_cli.core import json_values
from specmap_cli.core.geometry import Pose2
from specmap_cli.core.json_values import Count, Measured, Number, Value, runs_of
from specmap_cli.core.text import (
    Case,
    counted,
    csv_text,
    decimal,
    junit,
    legible,
    markdown_table,
    markdown_text,
    nanoseconds,
    plain,
    quoted,
    rounded,
    seconds,
    stamp_ns,
    stamp_text,
    to_exact_json,
    to_json,
)
from specmap_cli.core.yaml import read_yaml, yaml_text
from tests.strategies import few


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        ("short", "'short'"),
        ("x" * 58, f"'{'x' * 58}'"),
        ("x" * 59, f"'{'x' * 55}'..."),
        ("it's " * 20, '"' + ("it's " * 20)[:55] + '"...'),
        (list(range(99)), repr(list(range(99)))[:57] + "..."),
    ],
)
def test_a_quotation_that_is_cut_is_closed(value: object, shown: str) -> None:
    assert quoted(value) == shown


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**9), 10**9) | st.floats(-1e6, 1e6) | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
    max_leaves=12,
)


@given(st.integers(-(2**62), 2**62), st.integers(-(2**50), 2**50))
def test_a_stamp_stays_as_text_and_to_the_microsecond_as_seconds(stamp: int, micros: int) -> None:
    assert stamp_ns(stamp_text(stamp)) == stamp
    assert nanoseconds(seconds(micros * 1000)) == micros * 1000


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("0", 0),
        ("1", 10**9),
        (".5", 5 * 10**8),
        ("-0.25", -25 * 10**7),
        (" 12.000000001 ", 12 * 10**9 + 1),
        ("3.9999999999", 3_999_999_999),  # digits past the ninth are cut
    ],
)
def test_stamps_are_read_exactly(text: str, expected: int) -> None:
    assert stamp_ns(text) == expected


@pytest.mark.parametrize("text", ["x", "1.2.3", "1e9", "nan", "--1"])
def test_what_is_no_stamp_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"invalid literal|could not convert"):
        stamp_ns(text)


@given(VALUES)
def test_json_is_valid_and_stable(value: Any) -> None:
    text = to_json(value)
    assert text.endswith("\n")
    again = json.loads(text)
    assert to_json(again) == text
    assert plain(again) == again


def test_arrays_and_numpy_numbers_are_plain() -> None:
    found = plain({"a": np.array([[1.5, np.nan]]), 2: np.float32(0.5), "t": np.bool_(True)})
    assert found == {"a": [[1.5, None]], "2": 0.5, "t": True}
    assert type(plain(np.int64(7))) is int
    assert type(plain(np.bool_(False))) is bool
    assert [plain(np.longdouble(1) / 3), plain(np.ones(1, np.longdouble))] == [0.333333, [1.0]]


@given(st.floats())
def test_rounding_leaves_neither_negative_zero_nor_what_json_cannot_hold(value: float) -> None:
    found = rounded(value)
    if math.isfinite(value):
        assert found == pytest.approx(value, abs=5.1e-7)
        assert str(found) != "-0.0"
    else:
        assert found is None


@given(st.floats(-1e9, 1e9), st.integers(0, 9))
def test_decimals_are_fixed_and_zero_has_no_sign(value: float, places: int) -> None:
    text = decimal(value, places)
    assert float(text) == pytest.approx(value, abs=0.51 * 10.0**-places + math.ulp(value))
    assert len(text.partition(".")[2]) == places
    assert not (text.startswith("-") and float(text) == 0.0)


def test_things_are_counted_in_english() -> None:
    words = [counted(count, "scan") for count in (0, 1, 2, 12345)]
    assert words == ["0 scans", "1 scan", "2 scans", "12,345 scans"]


@given(VALUES, st.integers(0, 6))
def test_exact_json_is_read_to_the_last_bit_however_it_is_laid_out(value: Any, levels: int) -> None:
    assert json.loads(to_exact_json(value, levels)) == value


@pytest.mark.parametrize(
    ("levels", "text"),
    [
        (0, '{"a": [1, {"c": 0.1, "d": null}], "b": {}}\n'),
        (1, '{\n "a": [1, {"c": 0.1, "d": null}],\n "b": {}\n}\n'),
        (2, '{\n "a": [\n  1,\n  {"c": 0.1, "d": null}\n ],\n "b": {}\n}\n'),
    ],
)
def test_exact_json_has_a_line_an_entry_in_the_outer_levels(levels: int, text: str) -> None:
    assert to_exact_json({"b": {}, "a": [1, {"d": None, "c": 0.1}]}, levels) == text


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("/scan\x1b[31m\x07", "/scan\\x1b[31m\\x07"),
        ("a\nb\tc\r", "a\\nb\\tc\\r"),
        ("\x7f\x9b", "\\x7f\\x9b"),
        ("\u202egnp.\u2066x\u200f\u061c", "\\u202egnp.\\u2066x\\u200f\\u061c"),
        ("\u2028\u2029", "\\u2028\\u2029"),
        ("log\udcff.mcap", "log\\udcff.mcap"),
        ("Küche/\u5eca\u4e0b \\n", "Küche/\u5eca\u4e0b \\n"),
    ],
)
def test_what_a_terminal_would_obey_is_escaped(text: str, shown: str) -> None:
    assert legible(text) == shown
    assert legible(shown) == shown


def test_json_keeps_names_and_shows_a_terminal_nothing_that_it_would_obey() -> None:
    """And points stay on one line."""
    points = {"b": [[1.0, 2.0], [3.5, -4.0]], "a": []}
    assert to_json(points) == '{\n "a": [],\n "b": [\n  [1.0, 2.0],\n  [3.5, -4.0]\n ]\n}\n'
    name = "a\nb\x1b\x9b31m\x7f\u2028\u202ec\\ü"
    text = to_json({name: [name]})
    assert json.loads(text) == {name: [name]}
    assert legible(text.replace("\n", "")) == text.replace("\n", "")
    assert '"a\\nb\\u001b\\u009b31m\\u007f\\u2028\\u202ec\\\\ü"' in text


FORMULAS = ["=cmd|' /C calc'!A0", "+1+1", "-2+3", "@SUM(A1)", "\t=1", "\r=1", "'=1", "''@x"]
PLAIN = ["Kitchen", "'quoted'", "a=b", "3-4", "", "' =", "'"]
NUMBERS = ["-5", "+3.25", "-1e-05", "-inf", "-0.000000"]


def read(text: str) -> list[list[str]]:
    return list(csv.reader(io.StringIO(text, newline="")))


def meant(cell: str) -> str:
    """The text of a cell, as docs/export.md says."""
    return cell[1:] if re.match(r"'+[=+\-@\t\r]", cell) else cell


@pytest.mark.parametrize("name", FORMULAS + PLAIN + NUMBERS)
def test_a_spreadsheet_runs_no_name_and_other_texts_and_numbers_stay_as_they_are(name: str) -> None:
    said = f"'{name}" if name in FORMULAS else name
    assert read(csv_text(["name", name], [[1, name]])) == [["name", said], ["1", said]]


@given(st.lists(st.text(st.sampled_from("'=+-@\t\r\n,\" ab1")), min_size=2, max_size=2))
def test_every_text_is_read_back_and_values_are_as_python_has_them(texts: list[str]) -> None:
    rows = read(csv_text(["a", "b"], [texts]))
    assert [[meant(cell) for cell in row] for row in rows] == [["a", "b"], texts]
    text = csv_text(["a", "b", "c", "d"], [[None, -1.5, True, 7]], "\r\n")
    assert text == "a,b,c,d\r\n,-1.5,True,7\r\n"


def test_markdown_keeps_its_columns() -> None:
    assert "@some" not in markdown_text("@somebody")  # whom a forge would tell
    rows = [(markdown_text("a|b"), "1"), (markdown_text("*c*\n"), "")]
    assert markdown_table(("", "share of"), rows, {"share of"}) == [
        "| | share of |",
        "|---|---:|",
        "| a\\|b | 1 |",
        "| \\*c\\*\\\\n |  |",
    ]


def test_junit_counts_its_cases() -> None:
    cases = [
        Case(name="good", seconds=1.5),
        Case(name="bad", seconds=0.25, failure="no\x00thing", kind="Sad", detail="because"),
        Case(name="later", seconds=0.0, skipped=True),
    ]
    (suite,) = ElementTree.fromstring(junit("all", "group", cases))
    counts = {"tests": "3", "failures": "1", "errors": "0", "skipped": "1"}
    assert suite.attrib == {"name": "all", **counts, "time": "1.750"}
    assert [case.get("classname") for case in suite] == ["group"] * 3
    failure = suite.find("testcase[@name='bad']/failure")
    assert failure is not None
    assert failure.attrib == {"message": "no\\x00thing", "type": "Sad"}
    assert failure.text == "because"
    assert suite.find("testcase[@name='later']/skipped") is not None
    assert "time" not in ElementTree.fromstring(junit("all", "x", [Case(name="a")]))[0].attrib


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


@dataclass(frozen=True, slots=True)
class Leg(Value):
    """A piece of a way."""

    may_lack = frozenset({"note"})

    start_ns: Annotated[json_values.StampNs, Field(alias="start", description="seconds")]
    motion: json_values.Motion | None = None
    path: json_values.Corners | None = None
    doubt: json_values.MaybeNan = math.nan
    note: str | None = None


LEGS: TypeAdapter[Leg] = TypeAdapter(Leg)
FULL = {
    "start": 1.5,
    "motion": [1.0, 2.0, 0.5],
    "path": [[0.0, 0.0], [1.0, 2.0]],
    "doubt": 0.25,
    "note": "n",
}


def test_a_value_is_read_and_written_by_itself() -> None:
    leg = LEGS.validate_python(FULL)
    assert (leg.start_ns, leg.motion, leg.doubt) == (1_500_000_000, Pose2(1.0, 2.0, 0.5), 0.25)
    assert leg.path is not None
    np.testing.assert_array_equal(leg.path, [[0.0, 0.0], [1.0, 2.0]])
    assert leg.as_dict() == FULL
    bare = Leg(7_000_000_000)
    assert bare.as_dict() == dict.fromkeys(FULL) | {"start": 7.0}
    assert math.isnan(LEGS.validate_python(bare.as_dict()).doubt)


def test_what_is_read_is_whole_and_holds_nothing_else() -> None:
    for key in FULL:
        rest = {name: value for name, value in FULL.items() if name != key}
        if key == "note":
            assert LEGS.validate_python(rest).note is None
            continue
        with pytest.raises(ValidationError, match=key):
            LEGS.validate_python(rest)
    with pytest.raises(ValidationError, match="odd"):
        LEGS.validate_python(FULL | {"odd": 1})
    with pytest.raises(ValidationError, match="finite"):
        LEGS.validate_python(FULL | {"start": math.nan})
    with pytest.raises(ValidationError, match="no larger than"):
        LEGS.validate_python(FULL | {"path": [[0.0, 1e12]]})


def test_what_was_measured_has_six_decimals() -> None:
    class Found(Measured):
        """Two numbers."""

        metres: Number
        count: Count

    assert Found(metres=1.23456789, count=3).model_dump() == {"metres": 1.234568, "count": 3}


@given(st.sets(st.integers(0, 60)))
def test_numbers_are_kept_as_runs(numbers: set[int]) -> None:
    ascending = tuple(sorted(numbers))
    runs = runs_of(ascending)
    assert [n for first, last in runs for n in range(first, last + 1)] == list(ascending)
