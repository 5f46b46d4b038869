"""What a worker does with one job: run its steps, and leave a complete result or none.

It needs no Dask and no client: all that is to be known of a job is in its arguments and in the
output. Killed at any instant, it leaves a complete result or none; what it had begun is removed by
the next run.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from specmap_cli import __version__
from specmap_cli.batch.digest import digest_of, inputs_of
from specmap_cli.batch.folders import Folder, files_in, folder_at, write_record
from specmap_cli.batch.outcomes import may_retry, stands
from specmap_cli.batch.places import PlaceError
from specmap_cli.batch.processes import always
from specmap_cli.batch.records import (
    InputRecord,
    Job,
    JobResult,
    Kind,
    Limits,
    LimitsRecord,
)
from specmap_cli.batch.scratch import scratch_directory
from specmap_cli.batch.work import Work, work_on
from specmap_cli.core.errors import LogError, SpecmapError, UsageError
from specmap_cli.core.text import legible

__all__ = ["failure", "may_retry", "run_job"]


@dataclass(frozen=True, slots=True)
class _Known:
    """What is known of a job before its steps are run; `refused` is why they cannot be."""

    inputs: tuple[InputRecord, ...] = ()
    digest: str = ""
    refused: Work | None = None


@dataclass(frozen=True, slots=True)
class _Attempt:
    """One attempt at a job."""

    job: Job
    limits: Limits
    number: int
    started_utc: str
    began: float


def run_job(
    job: Job,
    output: str,
    limits: Limits = Limits(),
    scratch: str | None = None,
    attempt: int = 1,
    wanted: Callable[[], bool] = always,
    *,
    redo: bool = False,
) -> JobResult:
    """Run a job, its result going to `output`/NAME; a complete one that stands is not made again.

    With `redo` it is made again all the same. `output` is a directory or a URL of fsspec, `scratch`
    a directory for temporary files (None: that of the system), `attempt` is 1 the first time. What
    a job may meet is no exception but a result with the state `failed`. Its record is in no file
    where the output cannot be used, and where the inputs cannot be read and an earlier result is
    complete: that one stays. Raises GivenUpError when the job is not `wanted` any more; nothing of
    it is left then.
    """
    this = _Attempt(job, limits, attempt, datetime.now(UTC).isoformat(), time.monotonic())
    try:
        folder = folder_at(output, job.name)
        known = _known(job)
        stored = folder.stored()
        if stored is not None and not redo and stands(stored, known.digest, limits, attempt):
            return JobResult(**stored.model_dump(), resumed=True)
        if stored is not None and stored.state == "done" and known.refused is not None:
            return _result(this, known, known.refused)
        _refuse_edited(folder)
        return _made(this, known, folder, scratch, wanted)
    except (SpecmapError, OSError) as error:
        return _result(this, _Known(), _refusal(error))


def failure(
    job: Job, kind: Kind, reason: str, attempt: int = 1, limits: Limits = Limits()
) -> JobResult:
    """The result of a job of which nothing is left: its worker was lost. It is in no file."""
    this = _Attempt(job, limits, attempt, datetime.now(UTC).isoformat(), time.monotonic())
    return _result(this, _Known(), Work(kind=kind, reason=reason))


def _made(
    this: _Attempt,
    known: _Known,
    folder: Folder,
    scratch: str | None,
    wanted: Callable[[], bool],
) -> JobResult:
    """A new result, complete in its folder."""
    with scratch_directory(scratch) as temporary, folder.fresh(temporary) as directory:
        work = known.refused or work_on(this.job, directory, temporary, this.limits, wanted)
        result = _result(this, known, work, directory)
        write_record(directory, result.record)
    return result


def _refuse_edited(folder: Folder) -> None:
    """Refuse to replace a map by one that knows nothing of what a person decided about it."""
    edits = folder.edited()
    if edits is not None:
        raise UsageError(
            f"{edits}: holds a person's decisions, which a new map would lose: move the map away, "
            "and name it as `like` of build to keep them"
        )


def _known(job: Job) -> _Known:
    try:
        inputs = inputs_of(job)
        return _Known(inputs, digest_of(job, __version__, inputs))
    except SpecmapError as error:
        return _Known(refused=_refusal(error))


def _refusal(error: SpecmapError | OSError) -> Work:
    """The work on a job that could not be begun."""
    kind: Kind = "settings"
    if isinstance(error, LogError):
        kind = "log"
    elif isinstance(error, PlaceError | OSError) or isinstance(error.__context__, OSError):
        kind = "place"  # the system refused to write, or a store did
    return Work(kind=kind, reason=str(error))


def _result(this: _Attempt, known: _Known, work: Work, directory: Path | None = None) -> JobResult:
    held = [step.memory_mb for step in work.steps if step.memory_mb is not None]
    return JobResult(
        schema_version=1,
        name=this.job.name,
        digest=known.digest,
        version=__version__,
        state="done" if work.kind is None else "failed",
        kind=work.kind,
        reason=None if work.reason is None else legible(" ".join(work.reason.split())),
        attempts=this.number,
        limits=LimitsRecord(memory_mb=this.limits.memory_mb, time_s=this.limits.time_s),
        started_utc=this.started_utc,
        wall_s=time.monotonic() - this.began,
        cpu_s=sum(step.cpu_s for step in work.steps),
        memory_mb=max(held, default=None),
        steps=work.steps,
        figures=dict(work.figures),
        inputs=known.inputs,
        files={} if directory is None else files_in(directory),
    )
