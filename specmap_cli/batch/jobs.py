"""Which jobs there are: from logs, directories, patterns and TOML files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from specmap_cli.batch.discovery import logs_at
from specmap_cli.batch.jobs_file import jobs_in
from specmap_cli.batch.naming import Names
from specmap_cli.batch.places import path_at
from specmap_cli.batch.records import Job, Plan
from specmap_cli.batch.steps import steps_of
from specmap_cli.core.errors import UsageError


def jobs_of(inputs: Sequence[str], defaults: Plan | None = None) -> tuple[Job, ...]:
    """The jobs of LOG, DIR, GLOB and jobs.toml, paths or fsspec URLs, in order of the inputs.

    A log, and each recording below a directory or behind a pattern, is a job with the steps of
    `defaults`; a file whose name ends in .toml says itself which jobs there are, and `defaults`
    hold where it is silent. Jobs are called as their logs, those of TOML files as these say. Raises
    UsageError for what makes no jobs, and for a TOML file that says what cannot be.
    """
    plan = Plan() if defaults is None else defaults
    names = Names()
    files = [place for place in inputs if place.lower().endswith(".toml")]
    named = {place: list(jobs_in(_local(place), plan, names)) for place in dict.fromkeys(files)}
    jobs: list[Job] = []
    seen: set[str] = set()
    for place in dict.fromkeys(inputs):
        jobs += named[place] if place in named else _plain(place, plan, names, seen)
    if not jobs:
        raise UsageError("no job given: name a log, a directory, a pattern or a TOML file of jobs")
    return tuple(jobs)


def _local(place: str) -> Path:
    path = path_at(place)
    if path is None:
        raise UsageError(f"{place}: a file of jobs must be on this machine: copy it here")
    return path


def _plain(place: str, plan: Plan, names: Names, seen: set[str]) -> Iterator[Job]:
    """A job for each recording that a place stands for; none for one that has a job already."""
    steps = steps_of(plan, Path())
    for found in logs_at(place):
        if found.log not in seen:
            seen.add(found.log)
            yield Job(names.of_log(found.name, found.log), (found.log,), steps)
