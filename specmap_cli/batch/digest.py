"""By what a job is known: a digest of all that decides its result."""

from __future__ import annotations

from specmap_cli.batch.records import Job


def digest_of(job: Job, version: str) -> str:
    """SHA-256 of the version, the steps, the files that options name, and the logs."""
    raise NotImplementedError


def bytes_of(job: Job) -> int:
    """The bytes of a job's logs; 0 for those that cannot be told."""
    raise NotImplementedError
