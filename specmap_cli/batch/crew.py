"""The workers of Dask as the order of jobs needs them, and what each does with a job."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any
from uuid import uuid4

from specmap_cli import __version__
from specmap_cli.batch.dispatch import Turn
from specmap_cli.batch.records import JobResult, Limits
from specmap_cli.batch.running import failure, run_job
from specmap_cli.core.errors import NoResultError

if TYPE_CHECKING:
    from distributed import Client, Future

_POLL_S = 1.0  # how long to wait for a result before looking at the workers again
_MB = 1_000_000


@dataclass(frozen=True, slots=True)
class Terms:
    """What is the same for all jobs; `redo`: whether results that are there are made again."""

    output: str
    limits: Limits = field(default_factory=Limits)
    scratch: str | None = None
    redo: bool = False


@dataclass(frozen=True, slots=True)
class _Host:
    """The workers of a machine, and the megabytes of them together; None: any."""

    workers: tuple[str, ...]
    memory_mb: int | None


class DaskCrew:
    """The workers behind a client, as `dispatch` needs them."""

    def __init__(self, client: Client, terms: Terms) -> None:
        self._client = client
        self._terms = terms
        self._turns: dict[str, Turn] = {}
        self._futures: dict[str, Future] = {}  # a future that nobody holds is given up by Dask
        self._ended: SimpleQueue[Future] = SimpleQueue()

    def __enter__(self) -> DaskCrew:
        return self

    def __exit__(self, *_: object) -> None:
        """Jobs that still run are given up: the workers end their steps."""
        if self._futures and self._client.status == "running":
            self._client.cancel(list(self._futures.values()), force=True)

    def slots(self) -> int:
        """How many jobs the workers can do at once. NoResultError when the scheduler is gone."""
        return sum(self._threads().values())

    def alone_mb(self) -> float | None:
        """The megabytes that a job may use when it is alone; None: any."""
        return self._roomiest().memory_mb

    def submit(self, turn: Turn) -> None:
        """Hand a job to a worker; one that is alone goes to the host with the most memory."""
        terms, workers = self._terms, None
        if turn.alone:
            host = self._roomiest()
            terms = replace(terms, limits=replace(terms.limits, memory_mb=host.memory_mb))
            workers = list(host.workers) or None
        key = f"specmap-{uuid4().hex}"
        self._turns[key] = turn
        future = self._client.submit(
            on_worker,
            turn,
            terms,
            __version__,
            key=key,
            pure=False,
            workers=workers,
            allow_other_workers=workers is not None,  # where these have gone meanwhile
        )
        self._futures[key] = future
        future.add_done_callback(self._ended.put)

    def next_result(self) -> tuple[Turn, JobResult | None] | None:
        """The next result; see `dispatch.Crew`."""
        try:
            future = self._ended.get(timeout=_POLL_S)
        except Empty:
            return None
        turn = self._turns.pop(future.key)
        del self._futures[future.key]
        if future.status == "finished":
            return turn, future.result()
        if future.status != "error":
            return turn, None
        return turn, _failed(turn, self._terms.limits, future.exception())

    def _threads(self) -> dict[str, int]:
        if self._client.status not in ("running", "connecting"):
            raise NoResultError(
                "the scheduler is gone: start it and run the same command again, which goes on "
                "where this one stopped"
            )
        try:
            found: dict[str, int] = self._client.nthreads()
        except OSError:  # the scheduler is away, and may come back
            return {}
        return found

    def _roomiest(self) -> _Host:
        """The host whose workers have the most memory together."""
        told = self._client.scheduler_info(n_workers=-1)["workers"]
        hosts: dict[str, list[str]] = {}
        for address in sorted(told):
            hosts.setdefault(_host(address), []).append(address)
        found = [
            _Host(tuple(workers), sum(self._memory_mb(told[one]) for one in workers) or None)
            for workers in hosts.values()
        ]
        return max(found, key=lambda host: host.memory_mb or 0, default=_Host((), None))

    def _memory_mb(self, worker: Mapping[str, Any]) -> int:
        """What the jobs of a worker may use together; 0 where it does not say."""
        limit = self._terms.limits.memory_mb
        if limit is not None:
            return limit * int(worker["nthreads"])
        return int((worker["memory_limit"] or 0) / _MB)


def on_worker(turn: Turn, terms: Terms, version: str) -> JobResult:
    """What a worker of Dask does with a job."""
    if version != __version__:
        told = f"the worker has specmap {__version__}, the client {version}: install the same"
        return failure(turn.job, "worker", told, turn.attempt, terms.limits)
    return run_job(
        turn.job,
        terms.output,
        _own_limits(terms.limits),
        terms.scratch,
        turn.attempt,
        _wanted(),
        redo=terms.redo,
    )


def _wanted() -> Callable[[], bool]:
    """Whether the scheduler still wants this task: not after its client has gone."""
    from distributed import get_worker

    worker = get_worker()
    key = worker.get_current_task()

    def wanted() -> bool:
        task = worker.state.tasks.get(key)
        return task is not None and task.state != "cancelled"

    return wanted


def _own_limits(limits: Limits) -> Limits:
    """The limits of a job: without one of memory, the share that the worker was started with."""
    from distributed import get_worker

    worker = get_worker()
    most = worker.memory_manager.memory_limit
    if limits.memory_mb is not None or not most:
        return limits
    return replace(limits, memory_mb=max(1, int(most / _MB / worker.state.nthreads)))


def _failed(turn: Turn, limits: Limits, error: BaseException | None) -> JobResult:
    """The result of a job that gave none."""
    if type(error).__name__ == "KilledWorker":
        told = f"the worker died with the job ({_killed(error)})"
    else:
        told = f"the worker failed: {type(error).__name__}: {error}"
    return failure(turn.job, "worker", told, turn.attempt, limits)


def _killed(error: BaseException | None) -> str:
    return str(getattr(getattr(error, "last_worker", None), "address", "unknown"))


def _host(address: str) -> str:
    """The host of `tcp://host:port`."""
    return address.rpartition(":")[0]
