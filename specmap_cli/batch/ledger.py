"""How far a batch has come: what is known of each job, and the events that it makes."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

from specmap_cli.batch.dispatch import Finished, Happening, Quiet, Retried, Started
from specmap_cli.batch.events import Event, EventRecord
from specmap_cli.batch.records import Job, JobResult
from specmap_cli.batch.tables import Row, row_of
from specmap_cli.core.text import counted
from specmap_cli.report.words import lasting


class Ledger:
    """The results of a batch so far. It is told what happens, in order."""

    def __init__(self, jobs: Sequence[Job], sizes: Mapping[str, int]) -> None:
        self.results: dict[str, JobResult] = {}
        self.jobs = tuple(jobs)
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

    def rows(self) -> list[Row]:
        """A row of the summary for each job, in order of names."""
        names = sorted(job.name for job in self.jobs)
        return [row_of(name, self.results.get(name)) for name in names]

    def began(self) -> EventRecord:
        """The event that the batch began."""
        return self._event("began")

    def ended(self) -> EventRecord:
        """The event that the batch ended."""
        return self._event("ended")

    def heard(self, happening: Happening) -> EventRecord | None:
        """Take down what happened; returns the event that it makes, if it makes one."""
        if isinstance(happening, Quiet):
            return self._still(happening)
        self._stranded = False
        if isinstance(happening, Started):
            turn = happening.turn
            return self._event("started", turn.job.name, attempt=turn.attempt)
        if isinstance(happening, Retried):
            return self._told("retried", happening.result)
        return self._finished(happening)

    def _still(self, quiet: Quiet) -> EventRecord | None:
        """Nothing happened: an event when that is for want of workers, one for each time."""
        before, self._stranded = self._stranded, quiet.slots == 0
        if before or not self._stranded:
            return None
        return self._event("stranded", reason="no worker is left: the batch waits for one")

    def headline(self) -> str:
        """How far it is, for a person: jobs, failures, scans in a second, time left."""
        said = [f"{len(self.results):,} of {counted(len(self.jobs), 'job')}"]
        if self.failed:
            said.append(f"{self.failed:,} failed")
        elapsed = time.monotonic() - self._began
        if self._scans:
            said.append(f"{self._scans / elapsed:,.0f} scans/s")
        if left := self._left(elapsed):
            said.append(f"{lasting(left)} left")
        return ", ".join(said)

    def _left(self, elapsed: float) -> float | None:
        """Seconds until the end, by the bytes of the logs: long ones come first."""
        open_ = sum(self._sizes[job.name] for job in self.jobs if job.name not in self.results)
        return elapsed * open_ / self._bytes if self._bytes else None

    def _finished(self, happening: Finished) -> EventRecord:
        result = happening.result
        self.results[result.name] = result
        self._states[result.state] += 1
        if result.resumed:
            return self._told("resumed", result)
        self._bytes += self._sizes[result.name]
        self._scans += int(_scans(result) or 0)
        return self._told("done" if result.state == "done" else "failed", result)

    def _told(self, event: Event, result: JobResult) -> EventRecord:
        verdict = result.figures.get("verdict")
        return self._event(
            event,
            result.name,
            attempt=result.attempts,
            state=result.state,
            kind=result.kind,
            reason=result.reason,
            verdict=None if verdict is None else str(verdict),
            scans=_scans(result),
            wall_s=round(result.wall_s, 3),
        )

    def _event(self, event: Event, job: str | None = None, **more: Any) -> EventRecord:
        return EventRecord(
            event=event,
            time_utc=datetime.now(tz=UTC).isoformat(timespec="milliseconds"),
            job=job,
            jobs=len(self.jobs),
            done=self.done,
            failed=self.failed,
            **more,
        )


def _scans(result: JobResult) -> int | None:
    scans = result.figures.get("scans")
    return int(scans) if isinstance(scans, int | float) else None
