"""What a check found: every rule and every figure of the map, for a machine, a person and a CI.

The models are the format of `specmap check --json`. `check.schema.json` beside this file is the
same as JSON Schema, for other tools.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Literal

from pydantic import Field

from specmap_cli.core import tables
from specmap_cli.core.json_values import Record
from specmap_cli.core.schemas import ModelSchema
from specmap_cli.core.tables import Case, markdown_table, markdown_text
from specmap_cli.core.text import counted, legible

SCHEMA_VERSION = 1
_SIGNS = {"most": "<=", "least": ">="}


class OutcomeRecord(Record):
    """One rule, and whether the map keeps it."""

    rule: str = Field(description="name of the figure that has a bound")
    bound: Literal["most", "least"] = Field(description="on which side it is bounded")
    limit: float | str = Field(description="the bound; a word for the verdict")
    value: float | str | None = Field(description="of the map; null where it is not known")
    passed: bool = Field(description="what is not known does not pass")
    detail: str = Field(description="which findings or submaps break it; empty where none does")


class CheckRecord(Record):
    """The whole object."""

    schema_version: Literal[1] = Field(description="the version of this format")
    map: str = Field(description="as it was named on the command line")
    against: str | None = Field(description="the golden map, as named; null without one")
    passed: bool = Field(description="whether every rule is kept")
    rules: list[OutcomeRecord] = Field(description="the verdict, upper bounds, lower bounds")
    figures: dict[str, float | None] = Field(
        description="every figure that a rule could bound; null where it is not known"
    )


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
    cases = []
    for one in record.rules:
        case = Case(name=f"{one.rule} {_bound(one)}")
        if not one.passed:
            told = f"{one.rule} is {_value(one.value)}, allowed is {_bound(one)}"
            case = replace(case, failure=told, kind="BrokenRule", detail=one.detail)
        cases.append(case)
    return tables.junit(f"specmap check {record.map}", record.map, cases)


def markdown(record: CheckRecord) -> str:
    """A section with a table for the summary page of a CI: broken rules first."""
    rows = [
        (
            "ok" if one.passed else "**broken**",
            markdown_text(one.rule),
            _value(one.value),
            markdown_text(_bound(one)),
            markdown_text(one.detail),
        )
        for one in sorted(record.rules, key=lambda outcome: outcome.passed)
    ]
    table = markdown_table(("", "rule", "value", "bound", ""), rows, {"value"})
    return "\n".join([f"### {markdown_text(summary(record))}", "", *table, ""])


def _bound(outcome: OutcomeRecord) -> str:
    return f"{_SIGNS[outcome.bound]} {_value(outcome.limit)}"


def _value(value: float | str | None) -> str:
    """A figure, short: four digits tell enough."""
    if value is None:
        return "unknown"
    if isinstance(value, str):
        return value
    return f"{value:.0f}" if value == round(value) or abs(value) >= 1e4 else f"{value:.4g}"


FORMATS: dict[str, Callable[[CheckRecord], bytes]] = {
    "junit": junit,
    "markdown": lambda record: markdown(record).encode(),
}

SCHEMA = ModelSchema(CheckRecord, "check", SCHEMA_VERSION, "specmap check --json")
