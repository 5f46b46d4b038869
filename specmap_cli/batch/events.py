"""What a batch tells while it runs: a line of JSON an event.

These models are the format. `batch.schema.json` beside this file is the same as JSON Schema, for
other tools. After a change of the models, `python -m specmap_cli.batch.events` prints the new one.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from specmap_cli.batch.records import Kind

SCHEMA_VERSION = 1
SCHEMA_ID = f"urn:specmap:batch:{SCHEMA_VERSION}"
SCHEMA_FILE = Path(__file__).with_name("batch.schema.json")

# What happens:
#   began    the batch, with so many jobs
#   started  a job was handed to a worker
#   resumed  the result of a job was there already, and is as good as a new one
#   retried  an attempt failed; the job will be tried again
#   done     a job has a result
#   failed   a job has none, and will not be tried again
#   stranded no worker is left of a scheduler; the batch waits until one comes
#   ended    the batch: every job is done or failed
Event = Literal["began", "started", "resumed", "retried", "done", "failed", "stranded", "ended"]


class EventRecord(BaseModel):
    """One line."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    schema_version: Literal[1] = Field(default=1, description="the version of this format")
    event: Event = Field(description="what happened")
    time_utc: str = Field(description="when, ISO 8601")
    job: str | None = Field(default=None, description="name of the job; null: of the whole batch")
    attempt: int | None = Field(default=None, description="which attempt at the job, from 1")
    state: Literal["done", "failed"] | None = Field(
        default=None, description="how the attempt ended; null where it did not"
    )
    kind: Kind | None = Field(default=None, description="what kind of failure")
    reason: str | None = Field(default=None, description="why it failed or waits, in a line")
    verdict: str | None = Field(default=None, description="on the map: good, doubtful or poor")
    scans: int | None = Field(default=None, description="scans that were read")
    wall_s: float | None = Field(default=None, description="seconds that the attempt took")
    jobs: int = Field(description="jobs of the batch")
    done: int = Field(description="jobs that are done by now")
    failed: int = Field(description="jobs that failed by now")

    def line(self) -> str:
        """The event as one line of JSON, with its line break."""
        return json.dumps(self.model_dump(), sort_keys=True, ensure_ascii=True) + "\n"


def json_schema() -> dict[str, Any]:
    """The models as JSON Schema (draft 2020-12)."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": SCHEMA_ID,
        **EventRecord.model_json_schema(),
        "title": "specmap batch --json: one line",
    }


def schema_text() -> str:
    """The text of `batch.schema.json`."""
    return json.dumps(json_schema(), indent=2, sort_keys=True) + "\n"


if __name__ == "__main__":
    sys.stdout.write(schema_text())
