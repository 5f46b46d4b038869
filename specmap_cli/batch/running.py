"""What a worker does with one job: run its steps, and leave a complete result or none."""

from __future__ import annotations

from specmap_cli.batch.records import Job, JobResult, Kind, Limits


def run_job(
    job: Job,
    output: str,
    limits: Limits = Limits(),
    scratch: str | None = None,
    attempt: int = 1,
) -> JobResult:
    """Run a job, its result going to `output`/NAME; a complete one that stands is not made again.

    Never raises for what a job may meet: that is a failed result. `scratch` is a directory for
    temporary files (None: that of the system).
    """
    raise NotImplementedError


def failure(
    job: Job, kind: Kind, reason: str, attempt: int = 1, limits: Limits = Limits()
) -> JobResult:
    """The result of a job of which nothing is left: its worker was lost. It is in no file."""
    raise NotImplementedError


def may_retry(result: JobResult) -> bool:
    """Whether a second attempt may succeed: kinds memory, worker and place, after the first."""
    raise NotImplementedError
