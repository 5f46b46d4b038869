"""Which job is handed to the workers when: long ones first, those in want of memory last.

What happens is told as it happens: `worked_off` yields it. It holds nothing that its death would
lose, since each result lies in the output before it is told here.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from specmap_cli.batch.records import Job, JobResult
from specmap_cli.batch.running import may_retry


@dataclass(frozen=True, slots=True)
class Turn:
    """One attempt at a job; `alone`: nothing else runs, and it may use what all workers may."""

    job: Job
    attempt: int = 1
    alone: bool = False


@dataclass(frozen=True, slots=True)
class Started:
    """A job was handed to a worker."""

    turn: Turn


@dataclass(frozen=True, slots=True)
class Retried:
    """A job failed and will be tried again, now or at the end."""

    turn: Turn
    result: JobResult


@dataclass(frozen=True, slots=True)
class Finished:
    """What came of a job in the end."""

    result: JobResult


@dataclass(frozen=True, slots=True)
class Quiet:
    """Nothing happened for a while; `slots` workers are there."""

    slots: int


Happening = Started | Retried | Finished | Quiet


class Crew(Protocol):
    """The workers, as the order of the jobs needs to know them."""

    def slots(self) -> int:
        """How many jobs the workers can do at once, now."""

    def alone_mb(self) -> float | None:
        """The megabytes that a job may use when it is alone; None: any."""

    def submit(self, turn: Turn) -> None:
        """Hand a job to a worker."""

    def next_result(self) -> tuple[Turn, JobResult | None] | None:
        """The next result; None instead of it for a job that was forgotten; None after a while."""


def longest_first(jobs: Sequence[Job], sizes: Mapping[str, int]) -> list[Job]:
    """The jobs by the bytes of their logs, so that no long one is left when all others are done."""
    return sorted(jobs, key=lambda job: (-sizes[job.name], job.name))


def worked_off(jobs: Sequence[Job], crew: Crew, retries: int) -> Iterator[Happening]:
    """Do the jobs in their order, each tried `retries` times more where that may help."""
    hungry: list[Turn] = []
    yield from _round(deque(Turn(job) for job in jobs), crew, retries, hungry)
    for turn in hungry:
        yield from _round(deque([turn]), crew, retries, [])


def _round(
    waiting: deque[Turn], crew: Crew, retries: int, hungry: list[Turn]
) -> Iterator[Happening]:
    """All that waits, never more at once than there are workers: nothing queues up elsewhere."""
    running = 0
    while waiting or running:
        for turn in _next(waiting, crew.slots() - running):
            crew.submit(turn)
            running += 1
            yield Started(turn)
        ended = crew.next_result()
        if ended is None:
            yield Quiet(crew.slots())
            continue
        running -= 1
        yield from _judged(*ended, crew, retries, waiting, hungry)


def _next(waiting: deque[Turn], free: int) -> Iterator[Turn]:
    for _ in range(min(len(waiting), free)):
        yield waiting.popleft()


def _judged(
    turn: Turn,
    result: JobResult | None,
    crew: Crew,
    retries: int,
    waiting: deque[Turn],
    hungry: list[Turn],
) -> Iterator[Happening]:
    """What is to be done about a result."""
    if result is None:  # the scheduler began anew: the job is handed out again
        waiting.appendleft(turn)
        return
    if result.kind == "memory":
        if not turn.alone and _gains(result, crew.alone_mb()):
            hungry.append(Turn(turn.job, turn.attempt + 1, alone=True))
            yield Retried(turn, result)
            return
    elif may_retry(result, retries + 1):
        waiting.append(Turn(turn.job, turn.attempt + 1, turn.alone))
        yield Retried(turn, result)
        return
    yield Finished(result)


def _gains(result: JobResult, alone_mb: float | None) -> bool:
    """Whether a job that wanted memory may have more when it is alone."""
    had = result.limits.memory_mb
    return had is not None and (alone_mb is None or alone_mb > had)
