"""Worker processes that run many cases each, within limits; one that dies is replaced."""

from __future__ import annotations

import multiprocessing
import os
import resource
import shutil
import signal
import tempfile
import time
import warnings
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path

import cv2

from fuzz.cases import case_of
from fuzz.judging import Failure, judge
from fuzz.running import preload, prepare
from fuzz.seeds import Seeds, settings, write_intact

_FILE_BYTES = 2 << 30  # the largest file a case may write
_POLL_S = 0.2


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """What a case may take: seconds of time, and memory beyond what a worker has at its start."""

    time_s: float = 20.0
    memory_bytes: int = 1 << 30


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What came of a case, and the seconds of processor time it took."""

    number: int
    name: str
    notes: tuple[str, ...]
    failures: tuple[Failure, ...]
    cpu_s: float


@dataclass(slots=True)
class _Worker:
    """A process, the pipe to it, and which case it is at.

    `since_s` is when the case began by the clock, `before_s` the processor time used before it.
    """

    process: BaseProcess
    pipe: Connection
    number: int = -1
    since_s: float = 0.0
    before_s: float = 0.0

    def give(self, number: int) -> None:
        """Let it run a case."""
        self.number, self.since_s, self.before_s = number, time.monotonic(), self._queued_s()
        with suppress(BrokenPipeError):  # it died: seen when its answer is waited for
            self.pipe.send(number)

    def hangs(self, limit_s: float) -> bool:
        """Whether its case takes too long: it computes on, or waits for what never comes.

        The time in which others had its processor does not count.
        """
        queued_s = self._queued_s() - self.before_s
        return time.monotonic() - self.since_s - queued_s > limit_s

    def _queued_s(self) -> float:
        """Seconds that the process waited for a processor so far; 0 where the system keeps none."""
        try:
            return int(Path(f"/proc/{self.process.pid}/schedstat").read_text().split()[1]) / 1e9
        except (OSError, IndexError):
            return 0.0

    def end(self) -> None:
        """End the process, whatever it does."""
        if self.process.is_alive():
            os.kill(self.process.pid or 0, signal.SIGKILL)
        self.process.join()
        self.pipe.close()


class Pool:
    """Worker processes for the cases of one seed."""

    def __init__(self, seeds: Seeds, seed: int, limits: Limits, jobs: int) -> None:
        self.seeds = seeds
        self.seed = seed
        self.limits = limits
        self.jobs = jobs
        self._workers: list[_Worker] = []

    def run(self, numbers: Iterable[int]) -> Iterator[Outcome]:
        """The outcomes of the cases with these numbers, as they come in."""
        pending = iter(numbers)
        with tempfile.TemporaryDirectory(prefix="fuzz-") as place:
            folder = Path(place)
            write_intact(self.seeds, folder)
            try:
                for number in islice(pending, self.jobs):
                    self._workers.append(self._started(folder))
                    self._workers[-1].give(number)
                while self._workers:
                    yield from self._settled(pending, folder)
            finally:
                for worker in self._workers:
                    worker.end()
                self._workers.clear()

    def _settled(self, pending: Iterator[int], folder: Path) -> Iterator[Outcome]:
        """The outcomes that are there by now; each worker that gave one gets its next case."""
        wait([worker.pipe for worker in self._workers], timeout=_POLL_S)
        for worker in list(self._workers):
            outcome = self._outcome(worker)
            if outcome is None:
                continue
            yield outcome
            number = next(pending, None)
            worn = not worker.process.is_alive() or _is_worn(outcome)
            if worn or number is None:
                self._workers.remove(worker)
                worker.end()
            if number is not None:
                if worn:
                    worker = self._started(folder)
                    self._workers.append(worker)
                worker.give(number)

    def _outcome(self, worker: _Worker) -> Outcome | None:
        """What a worker answers; what its death or its silence means; None while it may work."""
        if worker.pipe.poll():
            try:
                outcome: Outcome = worker.pipe.recv()
                return outcome
            except (EOFError, OSError):
                worker.process.join()
                code = worker.process.exitcode or 0
                how = signal.Signals(-code).name if code < 0 else f"exit code {code}"
                return self._failed(worker, Failure("died", f"the process ended by {how}"))
        if worker.hangs(self.limits.time_s):
            worker.end()
            return self._failed(worker, Failure("hang", f"more than {self.limits.time_s:g} s"))
        return None

    def _failed(self, worker: _Worker, failure: Failure) -> Outcome:
        case = case_of(self.seeds, self.seed, worker.number)
        return Outcome(
            number=worker.number,
            name=case.name,
            notes=case.notes,
            failures=(failure,),
            cpu_s=time.monotonic() - worker.since_s,
        )

    def _started(self, folder: Path) -> _Worker:
        context = multiprocessing.get_context("fork")
        here, there = context.Pipe()
        others = [worker.pipe for worker in self._workers]
        arguments = (there, [here, *others], self.seeds, self.seed, self.limits, folder)
        process = context.Process(target=_work, args=arguments, daemon=True)
        preload()
        cv2.setNumThreads(1)  # a child would wait for the threads of a pool that it does not have
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of a fork beside threads
            process.start()
        there.close()
        return _Worker(process, here)


def _is_worn(outcome: Outcome) -> bool:
    """Whether the worker has run out of memory: what it holds now is not what it held."""
    return any(failure.kind == "memory" for failure in outcome.failures)


def _work(
    pipe: Connection,
    inherited: Iterable[Connection],
    seeds: Seeds,
    seed: int,
    limits: Limits,
    place: Path,
) -> None:
    """A worker's life: cases in, outcomes out, until the pipe is closed."""
    for other in inherited:
        other.close()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all: the parent decides
    prepare()
    _limit(limits)
    while True:
        try:
            number = pipe.recv()
        except EOFError:
            return
        pipe.send(run_case(seeds, seed, number, place))


def run_case(seeds: Seeds, seed: int, number: int, place: Path) -> Outcome:
    """Run one case here, in a folder of its own inside `place` that is removed afterwards."""
    case, started = case_of(seeds, seed, number), time.process_time()
    folder = place / f"case-{number}"
    folder.mkdir()
    try:
        failures = judge(case, folder, settings(), place)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return Outcome(
        number=number,
        name=case.name,
        notes=case.notes,
        failures=tuple(failures),
        cpu_s=time.process_time() - started,
    )


def _limit(limits: Limits) -> None:
    """Bound what this process may take from now on."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    bound = pages * resource.getpagesize() + limits.memory_bytes
    resource.setrlimit(resource.RLIMIT_AS, (bound, bound))
    resource.setrlimit(resource.RLIMIT_FSIZE, (_FILE_BYTES, _FILE_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
