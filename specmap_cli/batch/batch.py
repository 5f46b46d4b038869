"""A whole batch: which job is done when, what is told and written meanwhile, and the summaries.

Long jobs are handed out first, those in want of memory last. A batch holds nothing that its death
would lose, since each result lies in the output before it is told here.
"""

from __future__ import annotations

import json
import math
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any, Literal

from pydantic import Field

from specmap_cli.batch.places import path_at, taken, write_files
from specmap_cli.batch.records import Job, JobRecord, JobResult, Kind, Terms, Turn
from specmap_cli.batch.running import may_retry
from specmap_cli.batch.sources import bytes_of
from specmap_cli.batch.summaries import summaries_of
from specmap_cli.batch.workers import Cluster, Workers, opened, require_dask, share_of_memory_mb
from specmap_cli.core.errors import UsageError
from specmap_cli.core.json_values import Record
from specmap_cli.core.schemas import ModelSchema
from specmap_cli.core.text import counted
from specmap_cli.report.html import lasting

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
        # no long one is left when all others are done
        self.jobs = sorted(jobs, key=lambda job: (-sizes[job.name], job.name))
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

    def finished(self, result: JobResult) -> EventRecord:
        """A job has come to its end."""
        record = result.record
        self.results[record.name] = record
        self._states[record.state] += 1
        if result.resumed:
            self.resumed += 1
            return self.ended("resumed", record)
        self._bytes += self._sizes[record.name]
        self._scans += _scans(record) or 0
        return self.ended(record.state, record)

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

    def ended(self, event: Event, record: JobRecord) -> EventRecord:
        """An event of an attempt that has ended, which may be tried again."""
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


SCHEMA = ModelSchema(EventRecord, "batch", 1, "specmap batch --json: one line")


_SUMMARY_EVERY_S = 60.0  # while the batch runs; each costs about a second for 10,000 jobs
_ASKERS = 16  # threads that ask for the sizes of logs: a store answers each after a while


def run_batch(
    jobs: Sequence[Job],
    terms: Terms,
    cluster: Cluster = Cluster(),
    retries: int = 1,
    tell: Callable[[EventRecord], None] = lambda _: None,
    show: Callable[[Ledger], None] = lambda _: None,
) -> Ledger:
    """Do all jobs; one that fails stops none of the others. Returns what came of each.

    Results that are there already stay. Events are told to `tell`, and how far it is to `show`.
    Raises UsageError for an output that cannot be written or that another batch has, and for
    workers that cannot be used.
    """
    if not jobs:
        raise UsageError("no logs", "name a recording, a directory, a pattern or a file of jobs")
    require_dask()
    path, limits = path_at(terms.output), terms.limits
    if path is not None:  # workers may be in another directory
        terms = replace(terms, output=str(path.absolute()))
    if limits.memory_mb is None and cluster.scheduler is None:
        limits = replace(limits, memory_mb=share_of_memory_mb(cluster))
        terms = replace(terms, limits=limits)
    with ThreadPoolExecutor(_ASKERS) as askers:
        sizes = dict(zip((job.name for job in jobs), askers.map(bytes_of, jobs), strict=True))
    ledger = Ledger(jobs, sizes)
    with taken(terms.output) as write:

        def note(event: EventRecord | None) -> None:
            if event is not None:
                write(event.line())
                tell(event)

        def summarise() -> None:
            names = [job.name for job in jobs]
            write_files(terms.output, summaries_of(names, ledger.results))

        note(ledger.event("began"))
        with ExitStack() as stack:
            workers = stack.enter_context(opened(cluster, terms))
            stack.callback(summarise)  # however it ends, once there are workers
            written = time.monotonic()
            for event in work_off(workers, retries, ledger):
                note(event)
                show(ledger)
                if time.monotonic() - written > _SUMMARY_EVERY_S:
                    summarise()
                    written = time.monotonic()
        note(ledger.event("ended"))
    return ledger


def work_off(workers: Workers, retries: int, ledger: Ledger) -> Iterator[EventRecord | None]:
    """Do the jobs of a ledger in its order, each tried `retries` times more where that may help.

    Yields what happens as it happens, and None while nothing does. Never more jobs are handed out
    than there are workers: nothing queues up elsewhere.
    """
    waiting, alone = deque(Turn(job) for job in ledger.jobs), deque[Turn]()
    running = 0
    while waiting or running or alone:
        if not waiting and not running:
            waiting.append(alone.popleft())
        for _ in range(min(len(waiting), workers.slots() - running)):
            turn = waiting.popleft()
            workers.submit(turn)
            running += 1
            yield ledger.event("started", turn.job.name, attempt=turn.attempt)
        ended = workers.next_result()
        if ended is None:
            yield ledger.waits(workers.slots())
            continue
        running -= 1
        turn, result = ended
        if result is None:  # the scheduler began anew: the job is handed out again
            waiting.appendleft(turn)
            continue
        record, again = result.record, replace(turn, attempt=turn.attempt + 1)
        had = record.limits.memory_mb
        if record.kind != "memory" and may_retry(record, retries + 1):
            waiting.append(again)
        elif (  # once more, if it can have more memory when it is alone
            record.kind == "memory"
            and not turn.alone
            and had is not None
            and (workers.alone_mb() or math.inf) > had
        ):
            alone.append(replace(again, alone=True))
        else:
            yield ledger.finished(result)
            continue
        yield ledger.ended("retried", record)
