"""A whole batch: which job is done when, what is told and written meanwhile, and the summaries.

Long jobs are handed out first, those in want of memory last. A batch holds nothing that its death
would lose, since each result lies in the output before it is told here.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace

from specmap_cli.batch.ledger import EventRecord, Ledger
from specmap_cli.batch.outputs import taken, write_files
from specmap_cli.batch.places import path_at
from specmap_cli.batch.records import Job, Terms, Turn
from specmap_cli.batch.running import may_retry
from specmap_cli.batch.sources import bytes_of
from specmap_cli.batch.summaries import summaries_of
from specmap_cli.batch.workers import Cluster, Workers, opened, require_dask, share_of_memory_mb
from specmap_cli.core.errors import UsageError

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
            for event in work_off(longest_first(jobs, sizes), workers, retries, ledger):
                note(event)
                show(ledger)
                if time.monotonic() - written > _SUMMARY_EVERY_S:
                    summarise()
                    written = time.monotonic()
        note(ledger.event("ended"))
    return ledger


def longest_first(jobs: Sequence[Job], sizes: Mapping[str, int]) -> list[Job]:
    """The jobs by the bytes of their logs, so that no long one is left when all others are done."""
    return sorted(jobs, key=lambda job: (-sizes[job.name], job.name))


def work_off(
    jobs: Sequence[Job], workers: Workers, retries: int, ledger: Ledger
) -> Iterator[EventRecord | None]:
    """Do the jobs in their order, each tried `retries` times more where that may help.

    Yields what happens as it happens, and None while nothing does. Never more jobs are handed out
    than there are workers: nothing queues up elsewhere.
    """
    waiting, alone = deque(Turn(job) for job in jobs), deque[Turn]()
    running = 0
    while waiting or running or alone:
        if not waiting and not running:
            waiting.append(alone.popleft())
        for _ in range(min(len(waiting), workers.slots() - running)):
            turn = waiting.popleft()
            workers.submit(turn)
            running += 1
            yield ledger.started(turn)
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
        yield ledger.retried(record)
