"""Which jobs there are: from logs, directories, patterns and TOML files."""

from __future__ import annotations

from collections.abc import Sequence

from specmap_cli.batch.records import Job, Plan


def jobs_of(inputs: Sequence[str], defaults: Plan | None = None) -> tuple[Job, ...]:
    """The jobs of LOG, DIR, GLOB and jobs.toml, paths or fsspec URLs, in order of the inputs.

    Raises UsageError for what makes no jobs.
    """
    raise NotImplementedError
