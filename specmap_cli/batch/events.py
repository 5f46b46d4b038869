"""What a batch tells while it runs: a line of JSON an event.

These models are the format. `batch.schema.json` beside this file is the same as JSON Schema, for
other tools. After a change of the models, `python -m specmap_cli.batch.events` prints the new one.
"""

from __future__ import annotations

import json
import sys
from typing import Literal

from pydantic import Field

from specmap_cli.batch.records import Kind
from specmap_cli.core.json_values import Record
from specmap_cli.core.schemas import ModelSchema

SCHEMA_VERSION = 1

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


class EventRecord(Record):
    """One line."""

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


SCHEMA = ModelSchema(EventRecord, "batch", SCHEMA_VERSION, "specmap batch --json: one line")

if __name__ == "__main__":
    sys.stdout.write(SCHEMA.text())
