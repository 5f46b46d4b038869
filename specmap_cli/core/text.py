"""Numbers, names, JSON and tables as text, the same bytes for the same values; findings in words.

A topic, a frame and a file may be called by any bytes: they are shown `legible`.
"""

from __future__ import annotations

import io
import json
import math
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

_NS = 1_000_000_000
_DECIMALS = 6
_QUOTED = 60  # characters of a value in an error
# An innermost list of numbers over several lines; no string has a line break in JSON.
_NUMBERS = re.compile(r"\[\n([-+.\deE,\s]+)\]")


def to_json(value: Any) -> str:
    """JSON with sorted keys, six decimals at the most, null for NaN and infinity.

    Lists of numbers, such as points, stay on one line.
    """
    dumped = json.dumps(plain(value), indent=1, sort_keys=True, ensure_ascii=False) + "\n"
    # JSON's own escapes for what `legible` escapes: it is read back as it was
    text = _UNSHOWN.sub(lambda it: it[0] if it[0] == "\n" else f"\\u{ord(it[0]):04x}", dumped)
    return _NUMBERS.sub(lambda match: f"[{' '.join(match[1].split())}]", text)


def to_exact_json(value: Any, levels: int) -> str:
    """JSON with sorted keys and exact numbers: a line an entry in the outer `levels`, dense below.

    For plain types only: what is learned is read back to the last bit.
    """
    return _indented(value, levels, "") + "\n"


def _indented(value: Any, levels: int, margin: str) -> str:
    """`to_exact_json` of a part whose own line begins with `margin`."""
    if not levels or not value or not isinstance(value, dict | list):
        return json.dumps(value, sort_keys=True)
    inner = margin + " "
    if isinstance(value, dict):
        entries = [
            f"{json.dumps(key)}: {_indented(value[key], levels - 1, inner)}"
            for key in sorted(value)
        ]
    else:
        entries = [_indented(entry, levels - 1, inner) for entry in value]
    brackets = "{}" if isinstance(value, dict) else "[]"
    lines = f",\n{inner}".join(entries)
    return f"{brackets[0]}\n{inner}{lines}\n{margin}{brackets[1]}"


def plain(value: Any) -> Any:
    """`value` in plain types: rounded floats, null for what is not finite, lists for arrays."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if hasattr(value, "tolist"):  # an array of numpy, or one number of it
        items = value.tolist()
        return plain(float(items) if type(items) is type(value) else items)  # a long double
    if isinstance(value, float):
        return rounded(value)
    return value if value is None or isinstance(value, int) else encodable(str(value))


def rounded(value: float) -> float | None:
    """`value` to six decimals without a negative zero; None when it is not finite."""
    return round(value, _DECIMALS) + 0.0 if math.isfinite(value) else None


def counted(count: int, noun: str) -> str:
    """`1 scan`, `2,000 scans`."""
    return f"{count:,} {noun}" + ("" if count == 1 else "s")


def stamp_text(stamp_ns: int) -> str:
    """Seconds with nine decimals, exact."""
    sign = "-" if stamp_ns < 0 else ""
    return f"{sign}{abs(stamp_ns) // _NS}.{abs(stamp_ns) % _NS:09d}"


def stamp_ns(text: str) -> int:
    """Nanoseconds of seconds written in decimals, exact to the ninth; ValueError otherwise."""
    whole, _, fraction = text.strip().partition(".")
    digits = (fraction + "0" * 9)[:9]
    magnitude = abs(int(whole or "0")) * _NS + int(digits)
    return -magnitude if whole.startswith("-") else magnitude


def seconds(stamp_ns: int) -> float:
    """Seconds of a stamp as a float, exact to the microsecond."""
    return stamp_ns // 1000 / 1e6


def nanoseconds(seconds: float) -> int:
    """A stamp in nanoseconds, exact to the microsecond."""
    return round(seconds * 1e6) * 1000


def decimal(value: float, places: int = _DECIMALS) -> str:
    """Fixed decimals, without a negative zero."""
    text = f"{value:.{places}f}"
    return text[1:] if text.startswith("-") and float(text) == 0.0 else text


# Control characters (C0, DEL, C1), line and paragraph separators, marks and overrides of direction.
_UNSHOWN = re.compile(
    "[\x00-\x1f\x7f-\x9f\u2028\u2029\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069]"
)


def legible(text: str) -> str:
    """`text` in one line that shows what it holds.

    Escaped are line breaks and other control characters, which a terminal would obey, those that
    turn the direction of writing, and what is no Unicode.
    """
    return encodable(_UNSHOWN.sub(lambda match: ascii(match[0])[1:-1], text))


def one_line(text: str) -> str:
    """`text` as one line: spaces for white space, escapes for what no terminal can show.

    That is control characters, which it would obey, and bytes of a file name that are no text.
    """
    return legible(" ".join(text.split()))


def quoted(value: object) -> str:
    """`value` as Python writes it, at most 60 characters; of a long text the quotation is closed.

    >>> quoted("a" * 99)[-6:]
    "aa'..."
    """
    text = repr(value)
    if len(text) <= _QUOTED:
        return text
    end = text[-1] if isinstance(value, str) else ""
    return f"{text[: _QUOTED - 3 - len(end)]}{end}..."


def encodable(text: str) -> str:
    """`text` with escapes for what is no Unicode."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


if TYPE_CHECKING:
    from pydantic import ValidationError

# What pydantic found, by its type: its own words never reach a person. A name in braces is a bound
# that the finding has with it.
_WORDS = {
    "missing": "is missing",
    "extra_forbidden": "is unknown",
    "greater_than": "must be more than {gt:g}",
    "greater_than_equal": "must be {ge:g} or more",
    "less_than": "must be less than {lt:g}",
    "less_than_equal": "must be {le:g} or less",
    "finite_number": "must be a finite number",
    "literal_error": "must be {expected}",
    "string_pattern_mismatch": "must fit the pattern {pattern}",
    "too_short": "must have {min_length} entries or more",
    "too_long": "must have {max_length} entries or fewer",
    "model_type": "must be a table",
    "dict_type": "must be a table",
    "tuple_type": "must be a list",
    "list_type": "must be a list",
    "bool_type": "must be true or false",
    "bool_parsing": "must be true or false",
    "float_type": "must be a number",
    "float_parsing": "must be a number",
    "int_type": "must be a whole number",
    "int_parsing": "must be a whole number",
    "int_parsing_size": "must be a whole number of fewer digits",
    "int_from_float": "must be a whole number",
    "string_type": "must be text",
    "union_tag_invalid": "must be one of {expected_tags}",
}


def said(finding: Mapping[str, Any]) -> str:
    """What a finding of `ValidationError.errors()` says, without its place and what was found.

    >>> said({"type": "greater_than_equal", "ctx": {"ge": 8}, "msg": "Input should be ..."})
    'must be 8 or more'
    """
    about = finding.get("ctx", {})
    if finding["type"] in ("value_error", "assertion_error"):
        return str(about["error"])
    if finding["type"] in _WORDS:
        return _WORDS[finding["type"]].format(**about)
    return str(finding["msg"]).replace("Input should", "must")


def first_finding(error: ValidationError) -> str:
    """The first finding of a validation, as `KEY: what is wrong`; entries of lists by number."""
    finding = error.errors()[0]
    key = ".".join(f"{part!s:.60}" for part in finding["loc"])
    return f"{key}: {said(finding)}" if key else said(finding)


# What a spreadsheet takes for a formula, and a text that would be read back as one defused.
_FORMULA = re.compile(r"'*[=+\-@\t\r]")
_NOT_IN_XML = r"[^\t\n\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]"  # slow to compile


def csv_text(head: Sequence[str], rows: Iterable[Sequence[Any]], line_end: str = "\n") -> str:
    """A line of headings and a line a row; None is an empty cell.

    A name is a person's, and a spreadsheet would run one that begins as a formula does: such a text
    gets a single quote before it (OWASP, "CSV Injection"). A text of several quotes and such a sign
    gets one more, so that whoever takes one quote away has the text again. Numbers stay.
    """
    import csv  # seldom wanted

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
