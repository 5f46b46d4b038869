"""A check in words: lines for a person, JUnit XML and Markdown for the pages of a CI."""

from __future__ import annotations

import re
from collections.abc import Callable
from xml.etree import ElementTree

from specmap_cli.checking.record import CheckRecord, OutcomeRecord
from specmap_cli.core.legible import legible
from specmap_cli.core.text import counted

_SIGNS = {"most": "<=", "least": ">="}
_NOT_IN_XML = re.compile(r"[^\t\n\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def lines_of(record: CheckRecord) -> list[str]:
    """A line a rule, broken ones with what breaks them; then whether all are kept."""
    width = max(len(outcome.rule) for outcome in record.rules)
    rows = [
        f"  {'ok    ' if outcome.passed else 'BROKEN'}  {outcome.rule:<{width}}  "
        f"{_value(outcome.value):>8}  {_bound(outcome)}"
        + (f"  {legible(outcome.detail)}" if outcome.detail else "")
        for outcome in record.rules
    ]
    return [*rows, summary(record)]


def summary(record: CheckRecord) -> str:
    """Whether the map keeps the rules, in a line."""
    broken = [outcome.rule for outcome in record.rules if not outcome.passed]
    against = "" if record.against is None else f" against {record.against}"
    if not broken:
        return f"{record.map}{against}: keeps {counted(len(record.rules), 'rule')}"
    return (
        f"{record.map}{against}: breaks {len(broken)} of "
        f"{counted(len(record.rules), 'rule')}: {', '.join(broken)}"
    )


def junit(record: CheckRecord) -> bytes:
    """A test suite with a test case a rule, as CI servers read it."""
    broken = sum(not outcome.passed for outcome in record.rules)
    suite = ElementTree.Element(
        "testsuite",
        name=f"specmap check {xml_text(record.map)}",
        tests=str(len(record.rules)),
        failures=str(broken),
        errors="0",
        skipped="0",
    )
    for outcome in record.rules:
        case = ElementTree.SubElement(
            suite,
            "testcase",
            classname=xml_text(record.map),
            name=f"{outcome.rule} {_bound(outcome)}",
        )
        if not outcome.passed:
            told = f"{outcome.rule} is {_value(outcome.value)}, allowed is {_bound(outcome)}"
            failure = ElementTree.SubElement(case, "failure", message=told, type="BrokenRule")
            failure.text = xml_text(outcome.detail)
    root = ElementTree.Element("testsuites")
    root.append(suite)
    ElementTree.indent(root)
    return bytes(ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)) + b"\n"


def markdown(record: CheckRecord) -> str:
    """A section with a table for the summary page of a CI: broken rules first."""
    ordered = sorted(record.rules, key=lambda outcome: outcome.passed)
    rows = [
        f"| {'ok' if one.passed else '**broken**'} | {cell(one.rule)} | {_value(one.value)} "
        f"| {cell(_bound(one))} | {cell(one.detail)} |"
        for one in ordered
    ]
    return "\n".join(
        [
            f"### {cell(summary(record))}",
            "",
            "| | rule | value | bound | |",
            "|---|---|---:|---|---|",
            *rows,
            "",
        ]
    )


def _bound(outcome: OutcomeRecord) -> str:
    return f"{_SIGNS[outcome.bound]} {_value(outcome.limit)}"


def _value(value: float | str | None) -> str:
    """A figure, short: four digits tell enough."""
    if value is None:
        return "unknown"
    if isinstance(value, str):
        return value
    return f"{value:.0f}" if value == round(value) or abs(value) >= 1e4 else f"{value:.4g}"


def cell(text: str) -> str:
    """Text as it stands in a cell of a table: names are a person's."""
    plain = legible(text).replace("\n", " ")
    for sign in "\\`*_[]|<>":
        plain = plain.replace(sign, f"\\{sign}")
    return plain


def xml_text(text: str) -> str:
    """Text without the signs that XML cannot hold."""
    return _NOT_IN_XML.sub("", legible(text))


FORMATS: dict[str, Callable[[CheckRecord], bytes]] = {
    "junit": junit,
    "markdown": lambda record: markdown(record).encode(),
}
