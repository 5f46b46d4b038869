"""A whole batch: jobs, workers, what is told and written meanwhile, and the summaries."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace

from specmap_cli.batch.cluster import (
    Place,
    opened,
    processors,
    require_dask,
    share_of_memory_mb,
)
from specmap_cli.batch.crew import DaskCrew, Terms
from specmap_cli.batch.digest import bytes_of
from specmap_cli.batch.dispatch import longest_first, worked_off
from specmap_cli.batch.events import EventRecord
from specmap_cli.batch.ledger import Ledger
from specmap_cli.batch.outputs import Journal, taken, write_summaries
from specmap_cli.batch.places import absolute
from specmap_cli.batch.records import Job
from specmap_cli.core.errors import UsageError

_SUMMARY_EVERY_S = 60.0  # while the batch runs; each costs about a second for 10,000 jobs
_ASKERS = 16  # threads that ask for the sizes of logs: a store answers each after a while


@dataclass(frozen=True, slots=True)
class Listener:
    """Who is told of a batch: of its events, and how far it is after each."""

    tell: Callable[[EventRecord], None] = lambda _: None
    show: Callable[[Ledger], None] = lambda _: None


def run_batch(
    jobs: Sequence[Job],
    terms: Terms,
    place: Place = Place(),
    retries: int = 1,
    listener: Listener = Listener(),
) -> Ledger:
    """Do all jobs; one that fails stops none of the others. Returns what came of each.

    Results that are there already stay. Raises UsageError for an output that cannot be written or
    that another batch has, and for workers that cannot be used.
    """
    if not jobs:
        raise UsageError("no logs: name a recording, a directory, a pattern or a file of jobs")
    require_dask()
    terms = _with_memory(replace(terms, output=absolute(terms.output)), place)
    sizes = sizes_of(jobs)
    ledger = Ledger(jobs, sizes)
    with taken(terms.output) as journal:
        _work(longest_first(jobs, sizes), ledger, terms, place, retries, listener, journal)
    return ledger


def sizes_of(jobs: Sequence[Job]) -> Mapping[str, int]:
    """The bytes of the logs of each job, by its name."""
    with ThreadPoolExecutor(_ASKERS) as askers:
        return dict(zip((job.name for job in jobs), askers.map(bytes_of, jobs), strict=True))


def _work(
    jobs: Sequence[Job],
    ledger: Ledger,
    terms: Terms,
    place: Place,
    retries: int,
    listener: Listener,
    journal: Journal,
) -> None:
    """Do the jobs, told of as they go; summed up however it ends, once there are workers."""

    def note(event: EventRecord) -> None:
        journal.write(event)
        listener.tell(event)

    note(ledger.began())
    written = time.monotonic()
    with (
        opened(place) as client,
        _summed_up(terms.output, ledger),
        DaskCrew(client, terms) as crew,
    ):
        for happening in worked_off(jobs, crew, retries):
            if event := ledger.heard(happening):
                note(event)
            listener.show(ledger)
            if time.monotonic() - written > _SUMMARY_EVERY_S:
                write_summaries(terms.output, ledger)
                written = time.monotonic()
    note(ledger.ended())


@contextmanager
def _summed_up(output: str, ledger: Ledger) -> Iterator[None]:
    """The summaries are written when the block ends."""
    try:
        yield
    finally:
        write_summaries(output, ledger)


def _with_memory(terms: Terms, place: Place) -> Terms:
    """The work with a limit of memory: on this machine each worker has its share."""
    if terms.limits.memory_mb is not None or place.scheduler is not None:
        return terms
    share = share_of_memory_mb(place.workers or processors())
    return replace(terms, limits=replace(terms.limits, memory_mb=share))
