"""Tables as files: CSV for spreadsheets, Markdown for people, JUnit XML for CI servers."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from specmap_cli.core.text import legible

# What a spreadsheet takes for a formula, and a text that would be read back as one defused.
_FORMULA = re.compile(r"'*[=+\-@\t\r]")
_NOT_IN_XML = r"[^\t\n\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]"  # slow to compile


def csv_text(head: Sequence[str], rows: Iterable[Sequence[Any]], line_end: str = "\n") -> str:
    """A line of headings and a line a row; None is an empty cell.

    A name is a person's, and a spreadsheet would run one that begins as a formula does: such a text
    gets a single quote before it (OWASP, "CSV Injection"). A text of several quotes and such a sign
    gets one more, so that whoever takes one quote away has the text again. Numbers stay.
    """
    lines = []
    text = io.StringIO()
    # with these ends all line ends in cells are in quotes, whichever end the rows get
    writer = csv.writer(text, lineterminator="\r\n")
    for row in [head, *rows]:
        writer.writerow(map(_defused, row))
        lines.append(text.getvalue().removesuffix("\r\n") + line_end)
        text.seek(0)
        text.truncate()
    return "".join(lines)


def _defused(cell: Any) -> Any:
    """A cell that is no formula."""
    if not isinstance(cell, str) or _FORMULA.match(cell) is None:
        return cell
    try:
        float(cell)
    except ValueError:
        return f"'{cell}"
    return cell


def markdown_table(
    head: Sequence[str], rows: Iterable[Sequence[str]], numbers: Collection[str] = ()
) -> list[str]:
    """The lines of a table; columns of the headings `numbers` stand to the right.

    Cells are Markdown already: see `markdown_text`.
    """
    return [
        "|" + "".join(f" {name} |" if name else " |" for name in head),
        "|" + "".join("---:|" if name in numbers else "---|" for name in head),
        *(f"| {' | '.join(row)} |" for row in rows),
    ]


def markdown_text(text: str) -> str:
    """Text as it stands in Markdown, also in a cell of a table: names are a person's."""
    plain = legible(text)
    for sign in "\\`*_[]|<>":
        plain = plain.replace(sign, f"\\{sign}")
    return plain.replace("@", "@\N{ZERO WIDTH SPACE}")  # else a forge tells the user of that name


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """A test case of JUnit XML: it passed, was skipped, or failed for a reason of some kind.

    `detail` is a longer text beside the reason; `seconds` is None where nobody measured it.
    """

    name: str
    seconds: float | None = None
    skipped: bool = False
    failure: str | None = None
    kind: str = ""
    detail: str = ""


def junit(suite: str, group: str, cases: Sequence[Case]) -> bytes:
    """A test suite as CI servers read it; `group` is the class that they show its cases under."""
    from xml.etree import ElementTree  # seldom wanted

    root = ElementTree.Element("testsuites")
    counts = {
        "name": _xml_text(suite),
        "tests": str(len(cases)),
        "failures": str(sum(case.failure is not None for case in cases)),
        "errors": "0",
        "skipped": str(sum(case.skipped for case in cases)),
    }
    times = [case.seconds for case in cases if case.seconds is not None]
    counts |= _time(sum(times) if times else None)
    element = ElementTree.SubElement(root, "testsuite", counts)
    for case in cases:
        names = {"classname": _xml_text(group), "name": _xml_text(case.name)}
        own = ElementTree.SubElement(element, "testcase", names | _time(case.seconds))
        if case.failure is not None:
            told = {"message": _xml_text(case.failure), "type": case.kind}
            ElementTree.SubElement(own, "failure", told).text = _xml_text(case.detail)
        elif case.skipped:
            ElementTree.SubElement(own, "skipped")
    ElementTree.indent(root)
    return bytes(ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)) + b"\n"


def _time(seconds: float | None) -> dict[str, str]:
    return {} if seconds is None else {"time": f"{seconds:.3f}"}


def _xml_text(text: str) -> str:
    """Text without the signs that XML cannot hold."""
    return re.sub(_NOT_IN_XML, "", legible(text))
