"""Tables as files: what a spreadsheet, a CI server and a person read of them."""

from __future__ import annotations

import csv
import io
import re
from xml.etree import ElementTree

import pytest
from hypothesis import given
from hypothesis import strategies as st

from specmap_cli.core.tables import Case, csv_text, junit, markdown_table, markdown_text

FORMULAS = ["=cmd|' /C calc'!A0", "+1+1", "-2+3", "@SUM(A1)", "\t=1", "\r=1", "'=1", "''@x"]
PLAIN = ["Kitchen", "'quoted'", "a=b", "3-4", "", "' =", "'"]
NUMBERS = ["-5", "+3.25", "-1e-05", "-inf", "-0.000000"]


def read(text: str) -> list[list[str]]:
    return list(csv.reader(io.StringIO(text, newline="")))


def meant(cell: str) -> str:
    """The text of a cell, as docs/export.md says."""
    return cell[1:] if re.match(r"'+[=+\-@\t\r]", cell) else cell


@pytest.mark.parametrize("name", FORMULAS + PLAIN + NUMBERS)
def test_a_spreadsheet_runs_no_name_and_other_texts_and_numbers_stand_as_they_are(
    name: str,
) -> None:
    said = f"'{name}" if name in FORMULAS else name
    assert read(csv_text(["name", name], [[1, name]])) == [["name", said], ["1", said]]


@given(st.lists(st.text(st.sampled_from("'=+-@\t\r\n,\" ab1")), min_size=2, max_size=2))
def test_every_text_is_read_back_and_values_are_as_python_has_them(texts: list[str]) -> None:
    rows = read(csv_text(["a", "b"], [texts]))
    assert [[meant(cell) for cell in row] for row in rows] == [["a", "b"], texts]
    text = csv_text(["a", "b", "c", "d"], [[None, -1.5, True, 7]], "\r\n")
    assert text == "a,b,c,d\r\n,-1.5,True,7\r\n"


def test_markdown_keeps_its_columns() -> None:
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
