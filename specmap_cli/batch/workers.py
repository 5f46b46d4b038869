"""The workers of a batch: threads of this process, or those of Dask behind any scheduler.

Workers of this machine listen on no port: no other user of it could tell them what to do. Nothing
of a job lives in the workers. One that dies, a client that dies and a scheduler that dies lose what
they were doing; results lie in the output.
"""

from __future__ import annotations

import ctypes
import logging
import multiprocessing
import signal
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future as LocalFuture
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, TypeVar
from uuid import uuid4

from specmap_cli import __version__
from specmap_cli.batch.records import EXTRA, JobResult, Terms, Turn
from specmap_cli.batch.running import run_job, worker_lost
from specmap_cli.core.errors import NoResultError, UsageError
from specmap_cli.core.plugins import extra
from specmap_cli.core.process import processors

if TYPE_CHECKING:
    from distributed import Client, Future

Item = TypeVar("Item")
Result = TypeVar("Result")

_ANSWER_S = 10.0  # a scheduler that does not answer within this time is not there
_MB = 1_000_000
_POLL_S = 1.0  # how long to wait for a result before looking at the workers again
_SHARE = 0.9  # of the machine's memory: the rest is for the system and the client


@dataclass(frozen=True, slots=True)
class Cluster:
    """Where workers are: `workers` of this machine (None: one a processor), or those of a
    scheduler, for the first of which to wait `patience_s`."""

    workers: int | None = None
    scheduler: str | None = None
    patience_s: float = 60.0


@contextmanager
def opened(cluster: Cluster, terms: Terms) -> Iterator[Workers]:
    """The workers, which give up what they do when the block ends.

    Raises UsageError where there is no scheduler, no worker, or another version of specmap.
    """
    if cluster.scheduler is None:
        with LocalWorkers(cluster.workers or processors(), terms) as local:
            yield local
        return
    connected = _connected(cluster.scheduler, cluster.patience_s)
    with connected as client, Workers(client, terms) as workers:
        yield workers


@contextmanager
def _connected(address: str, patience_s: float) -> Iterator[Client]:
    """A client of a scheduler that has workers of this version."""
    from distributed import Client
    from distributed.versions import VersionMismatchWarning

    with ExitStack() as stack:
        for name in ("distributed", "tornado", "asyncio"):  # what they log, we tell in a line
            logger = logging.getLogger(name)
            stack.callback(logger.setLevel, logger.level)
            logger.setLevel(logging.CRITICAL)
        stack.enter_context(warnings.catch_warnings())
        warnings.simplefilter("ignore", VersionMismatchWarning)
        try:
            client = Client(address, timeout=_ANSWER_S, set_as_default=False)
        except (OSError, ValueError) as error:
            said = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise UsageError(
                f"no Dask scheduler answers ({said})",
                "start one with `dask scheduler`, and workers with `dask worker`",
                where=address,
            ) from None
        stack.enter_context(client)
        try:
            client.wait_for_workers(1, timeout=patience_s)
        except TimeoutError:
            found = f"no worker has come in {patience_s:.0f} s"
            raise UsageError(found, "start one with `dask worker`", where=address) from None
        # another version makes other maps
        for worker, version in sorted(client.run(_version, on_error="return").items()):
            if version != __version__:
                what = version if isinstance(version, str) else f"none that works ({version})"
                raise UsageError(
                    f"the worker has specmap {what}, this is {__version__}",
                    "install the same version on both sides",
                    where=worker,
                )
        yield client


def share_of_memory_mb(cluster: Cluster) -> int:
    """The memory that each worker of this machine may use."""
    from distributed.system import MEMORY_LIMIT

    return max(1, int(_SHARE * MEMORY_LIMIT / _MB / (cluster.workers or processors())))


def require_dask() -> None:
    """UsageError unless Dask is installed."""
    extra("distributed", EXTRA, "workers need Dask ({error})")


def _version() -> str:
    return __version__


class Workers:
    """The workers behind a client: jobs are handed to them, and their results are taken."""

    def __init__(self, client: Client, terms: Terms) -> None:
        self._client = client
        self._terms = terms
        # a future that nobody holds is given up by Dask
        self._running: dict[str, tuple[Turn, Future]] = {}
        self._ended: SimpleQueue[Future] = SimpleQueue()

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *_: object) -> None:
        """Jobs that still run are given up: the workers end their steps."""
        if self._running and self._client.status == "running":
            self._client.cancel([future for _, future in self._running.values()], force=True)

    def slots(self) -> int:
        """How many jobs the workers can do at once, now. NoResultError without a scheduler."""
        if self._client.status not in ("running", "connecting"):
            raise NoResultError(
                "the scheduler is gone",
                "start it and run the same command again, which goes on where this one stopped",
            )
        try:
            return sum(self._client.nthreads().values())
        except OSError:  # the scheduler is away, and may come back
            return 0

    def alone_mb(self) -> int | None:
        """The megabytes that a job may use when it is alone; None: any."""
        return self._roomiest_host()[1]

    def submit(self, turn: Turn) -> None:
        """Hand a job to a worker; one that is alone goes to the host with the most memory."""
        terms, workers = self._terms, None
        if turn.alone:
            addresses, memory_mb = self._roomiest_host()
            terms = replace(terms, limits=replace(terms.limits, memory_mb=memory_mb))
            workers = addresses or None
        key = f"specmap-{uuid4().hex}"
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
        self._running[key] = turn, future
        future.add_done_callback(self._ended.put)

    def next_result(self) -> tuple[Turn, JobResult | None] | None:
        """The next result; None instead of it for a job that was forgotten; None after a while."""
        try:
            future = self._ended.get(timeout=_POLL_S)
        except Empty:
            return None
        turn, _ = self._running.pop(future.key)
        if future.status == "finished":
            return turn, future.result()
        if future.status != "error":
            return turn, None
        error = future.exception()
        if type(error).__name__ == "KilledWorker":
            killed = getattr(getattr(error, "last_worker", None), "address", "unknown")
            told = f"the worker died with the job ({killed})"
        else:
            told = f"the worker failed: {type(error).__name__}: {error}"
        return turn, worker_lost(turn, told, self._terms.limits)

    def _roomiest_host(self) -> tuple[list[str], int | None]:
        """The workers of the host with the most memory together, and the megabytes (None: any)."""
        told = self._client.scheduler_info(n_workers=-1)["workers"]
        limit = self._terms.limits.memory_mb
        hosts: dict[str, tuple[list[str], int]] = {}
        for address in sorted(told):  # tcp://host:port
            host, worker = address.rpartition(":")[0], told[address]
            addresses, memory_mb = hosts.get(host, ([], 0))
            more = int((worker["memory_limit"] or 0) / _MB)  # 0 where it does not say
            if limit is not None:
                more = limit * int(worker["nthreads"])
            hosts[host] = [*addresses, address], memory_mb + more
        addresses, memory_mb = max(hosts.values(), key=lambda host: host[1], default=([], 0))
        return addresses, memory_mb or None


class LocalWorkers(Workers):
    """The same on this machine: each is a thread, which runs the steps of a job as processes."""

    def __init__(self, count: int, terms: Terms) -> None:
        self._count = count
        self._terms = terms
        self._threads = ThreadPoolExecutor(count)
        self._results: SimpleQueue[tuple[Turn, LocalFuture[JobResult]]] = SimpleQueue()
        self._are_wanted = True

    def __exit__(self, *_: object) -> None:
        self._are_wanted = False
        self._threads.shutdown(cancel_futures=True)

    def slots(self) -> int:
        """How many workers there are."""
        return self._count

    def alone_mb(self) -> int | None:
        """The megabytes that a job may use when it is alone; None: any."""
        limit = self._terms.limits.memory_mb
        return None if limit is None else limit * self._count

    def submit(self, turn: Turn) -> None:
        """Have a job done."""
        limits = self._terms.limits
        limits = replace(limits, memory_mb=self.alone_mb()) if turn.alone else limits
        terms = replace(self._terms, limits=limits)
        job = self._threads.submit(run_job, turn, terms, lambda: self._are_wanted)
        job.add_done_callback(lambda ended: self._results.put((turn, ended)))

    def next_result(self) -> tuple[Turn, JobResult | None] | None:
        """The next result; None after a while."""
        try:
            turn, job = self._results.get(timeout=_POLL_S)
        except Empty:
            return None
        error = job.exception()
        if error is None:
            return turn, job.result()
        told = f"the worker failed: {type(error).__name__}: {error}"
        return turn, worker_lost(turn, told, self._terms.limits)


def on_worker(turn: Turn, terms: Terms, version: str) -> JobResult:
    """What a worker of Dask does with a job."""
    if version != __version__:
        told = f"the worker has specmap {__version__}, the client {version}: install the same"
        return worker_lost(turn, told, terms.limits)
    from distributed import get_worker

    worker = get_worker()
    most = worker.memory_manager.memory_limit
    if terms.limits.memory_mb is None and most:  # the share that the worker was started with
        share = max(1, int(most / _MB / worker.state.nthreads))
        terms = replace(terms, limits=replace(terms.limits, memory_mb=share))
    key = worker.get_current_task()

    def wanted() -> bool:
        """Whether the scheduler still wants this task: not after its client has gone."""
        task = worker.state.tasks.get(key)
        return task is not None and task.state != "cancelled"

    return run_job(turn, terms, wanted)


def spread(
    cluster: Cluster, function: Callable[[Item], Result], items: Sequence[Item]
) -> list[Result]:
    """What a function says of each item, in their order; both can be pickled.

    What the function raises is raised here. Raises UsageError where there are no workers,
    NoResultError where they are lost on the way.
    """
    lost = "start them and run the same command again, or leave out --workers and --scheduler"
    if cluster.scheduler is None:
        count, context = cluster.workers or processors(), multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(count, context, initializer=_tied_to_parent) as pool:
            try:
                return list(pool.map(function, items))
            except BrokenProcessPool:
                raise NoResultError("a worker was killed", lost) from None
            except BaseException:  # what did not begin need not
                pool.shutdown(wait=False, cancel_futures=True)
                raise
    require_dask()
    from distributed import KilledWorker
    from distributed.comm.core import CommClosedError

    with _connected(cluster.scheduler, cluster.patience_s) as client:
        try:
            found: list[Result] = client.gather(client.map(function, items, pure=False))
            return found
        except (KilledWorker, CommClosedError) as error:
            raise NoResultError(f"the workers were lost ({type(error).__name__})", lost) from None


def _tied_to_parent() -> None:
    """Turn a process deaf to Ctrl-C, which its parent heeds; on Linux it dies with that."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG
