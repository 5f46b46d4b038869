"""What `specmap check --json` prints: every rule, and every figure of the map.

These models are the format. `check.schema.json` beside this file is the same as JSON Schema, for
other tools. After a change of the models, `python -m specmap_cli.checking.record` prints the new
one.
"""

from __future__ import annotations

import sys
from typing import Literal

from pydantic import Field

from specmap_cli.core.json_values import Record
from specmap_cli.core.schemas import ModelSchema

SCHEMA_VERSION = 1

RuleName = str


class OutcomeRecord(Record):
    """One rule, and whether the map keeps it."""

    rule: RuleName = Field(description="name of the figure that has a bound")
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


SCHEMA = ModelSchema(CheckRecord, "check", SCHEMA_VERSION, "specmap check --json")

if __name__ == "__main__":
    sys.stdout.write(SCHEMA.text())
