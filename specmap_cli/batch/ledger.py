"""How far a batch has come: what is known of each job, and the events that are told meanwhile.

An event is a line of JSON. `EventRecord` is its format; `batch.schema.json` beside this file is the
same as JSON Schema, for other tools.
"""

from __future__ import annotations

import json
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any, Literal

from pydantic import Field

from specmap_cli.batch.records import Job, JobRecord, JobResult, Kind, Turn
from specmap_cli.core.json_values import Record
from specmap_cli.core.schemas import ModelSchema
from specmap_cli.core.text import counted
from specmap_cli.report.html import lasting

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


class Ledger:
    """What came of the jobs of a batch so far. It is told what happens, in order."""

    def __init__(self, jobs: Sequence[Job], sizes: Mapping[str, int]) -> None:
        self.results: dict[str, JobRecord] = {}
        self.jobs = tuple(jobs)
        self.resumed = 0  # results that were there already
        self._sizes = sizes
        self._began = time.monotonic()
        self._bytes, self._scans = 0, 0
        self._states: Counter[str] = Counter()
        self._stranded = False

    @property
    def done(self) -> int:
        """How many jobs are done."""
        return self._states["done"]

    @property
    def failed(self) -> int:
        """How many jobs failed and will not be tried again."""
        return self._states["failed"]

    def started(self, turn: Turn) -> EventRecord:
        """A job was handed to a worker."""
        return self.event("started", turn.job.name, attempt=turn.attempt)

    def retried(self, record: JobRecord) -> EventRecord:
        """An attempt failed, and the job will be tried again."""
        return self._told("retried", record)

    def finished(self, result: JobResult) -> EventRecord:
        """A job has come to its end."""
        record = result.record
        self.results[record.name] = record
        self._states[record.state] += 1
        if result.resumed:
            self.resumed += 1
            return self._told("resumed", record)
        self._bytes += self._sizes[record.name]
        self._scans += _scans(record) or 0
        return self._told(record.state, record)

    def waits(self, slots: int) -> EventRecord | None:
        """Nothing happened for a while: an event, once, when that is for want of workers."""
        if slots or self._stranded:
            self._stranded = slots == 0
            return None
        return self.event("stranded", reason="no worker is left: the batch waits for one")

    def headline(self) -> str:
        """How far it is, for a person: jobs, failures, scans in a second, time left."""
        said = [f"{len(self.results):,} of {counted(len(self.jobs), 'job')}"]
        if self.failed:
            said.append(f"{self.failed:,} failed")
        elapsed = time.monotonic() - self._began
        if self._scans:
            said.append(f"{self._scans / elapsed:,.0f} scans/s")
        # by the bytes of the logs: long ones come first
        left = sum(self._sizes[job.name] for job in self.jobs if job.name not in self.results)
        if self._bytes and left:
            said.append(f"{lasting(elapsed * left / self._bytes)} left")
        return ", ".join(said)

    def _told(self, event: Event, record: JobRecord) -> EventRecord:
        verdict = record.figures.get("verdict")
        return self.event(
            event,
            record.name,
            attempt=record.attempts,
            state=record.state,
            kind=record.kind,
            reason=record.reason,
            verdict=None if verdict is None else str(verdict),
            scans=_scans(record),
            wall_s=round(record.wall_s, 3),
        )

    def event(self, event: Event, job: str | None = None, **more: Any) -> EventRecord:
        """An event that is no job's, such as the begin and the end of the batch."""
        self._stranded = event == "stranded"
        return EventRecord(
            event=event,
            time_utc=datetime.now(tz=UTC).isoformat(timespec="milliseconds"),
            job=job,
            jobs=len(self.jobs),
            done=self.done,
            failed=self.failed,
            **more,
        )


def _scans(record: JobRecord) -> int | None:
    scans = record.figures.get("scans")
    return int(scans) if isinstance(scans, int | float) else None


SCHEMA = ModelSchema(EventRecord, "batch", SCHEMA_VERSION, "specmap batch --json: one line")
