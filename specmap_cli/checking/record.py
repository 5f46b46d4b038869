"""What `specmap check --json` prints: every rule, and every figure of the map.

These models are the format. `check.schema.json` beside this file is the same as JSON Schema, for
other tools. After a change of the models, `python -m specmap_cli.checking.record` prints the new
one.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

SCHEMA_VERSION = 1
SCHEMA_ID = f"urn:specmap:check:{SCHEMA_VERSION}"
SCHEMA_FILE = Path(__file__).with_name("check.schema.json")

RuleName = str


class _Record(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class OutcomeRecord(_Record):
    """One rule, and whether the map keeps it."""

    rule: RuleName = Field(description="name of the figure that has a bound")
    bound: Literal["most", "least"] = Field(description="on which side it is bounded")
    limit: float | str = Field(description="the bound; a word for the verdict")
    value: float | str | None = Field(description="of the map; null where it is not known")
    passed: bool = Field(description="what is not known does not pass")
    detail: str = Field(description="which findings or submaps break it; empty where none does")


class CheckRecord(_Record):
    """The whole object."""

    schema_version: Literal[1] = Field(description="the version of this format")
    map: str = Field(description="as it was named on the command line")
    against: str | None = Field(description="the golden map, as named; null without one")
    passed: bool = Field(description="whether every rule is kept")
    rules: list[OutcomeRecord] = Field(description="the verdict, upper bounds, lower bounds")
    figures: dict[str, float | None] = Field(
        description="every figure that a rule could bound; null where it is not known"
    )


def json_schema() -> dict[str, Any]:
    """The models as JSON Schema (draft 2020-12)."""
    schema = CheckRecord.model_json_schema()
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": SCHEMA_ID,
        **schema,
        "title": "specmap check --json",
    }


def schema_text() -> str:
    """The text of `check.schema.json`."""
    return json.dumps(json_schema(), indent=2, sort_keys=True) + "\n"


if __name__ == "__main__":
    sys.stdout.write(schema_text())
