"""The workers: a cluster of Dask on this machine, or that of any scheduler.

Nothing of a job lives in the cluster. A worker that dies, a client that dies and a scheduler that
dies lose what they were doing; results lie in the output.
"""

from __future__ import annotations

import logging
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any

from specmap_cli import __version__
from specmap_cli.core.errors import PACKAGE, NoResultError, UsageError

if TYPE_CHECKING:
    from distributed import Client, LocalCluster

EXTRA = "pip install 'specmap-cli[batch]'"
_STARTS = 2  # how often workers are started before it is given up
_ANSWER_S = 10.0  # a scheduler that does not answer within this time is not there
_MB = 1_000_000
_SHARE = 0.9  # of the machine's memory: the rest is for the system and the client
# One worker's death fails the one job it had: how often to try again is decided here, not there.
# Workers do next to nothing themselves; profiling and spilling would only cost.
_DASK = {
    "distributed.scheduler.allowed-failures": 0,
    "distributed.scheduler.worker-ttl": "5 minutes",
    "distributed.worker.preload": ["specmap_cli.batch.preload"],
    "distributed.worker.profile.enabled": False,
    "distributed.admin.system-monitor.gil.enabled": False,
}


@dataclass(frozen=True, slots=True)
class Place:
    """Where workers are: `workers` processes of this machine (None: one a processor), or those of
    a scheduler, for the first of which to wait `patience_s`."""

    workers: int | None = None
    scheduler: str | None = None
    patience_s: float = 60.0


@contextmanager
def opened(place: Place) -> Iterator[Client]:
    """A client of the workers; those of this machine end with the block.

    Raises UsageError where there is no scheduler, no worker, or another version of specmap.
    """
    opening = _local(place) if place.scheduler is None else _remote(place.scheduler)
    with _hushed(), opening as client:
        _wait_for_worker(client, place)
        _check_versions(client)
        yield client


def processors() -> int:
    """How many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def share_of_memory_mb(workers: int) -> int:
    """The memory that each of some workers of this machine may use."""
    from distributed.system import MEMORY_LIMIT

    return max(1, int(_SHARE * MEMORY_LIMIT / _MB / workers))


def require_dask() -> None:
    """UsageError unless Dask is installed."""
    try:
        import_module("distributed")
    except ImportError as error:
        raise UsageError(f"workers need Dask ({error}): {EXTRA}", code=PACKAGE) from None


@contextmanager
def _local(place: Place) -> Iterator[Client]:
    import dask
    from distributed import Client

    with dask.config.set(_DASK), _started(place) as cluster, Client(cluster) as client:
        yield client


def _started(place: Place) -> LocalCluster:
    """The workers of this machine. A worker may die while it starts: then all start once more."""
    from distributed import LocalCluster

    cluster_of_dask: Any = LocalCluster
    for _ in range(_STARTS):
        try:
            started: LocalCluster = cluster_of_dask(
                n_workers=place.workers or processors(),
                threads_per_worker=1,
                processes=True,
                scheduler_kwargs={"dashboard": False, "dashboard_address": "127.0.0.1:0"},
                memory_limit=0,  # the steps of jobs have limits of their own
                silence_logs=logging.CRITICAL,
            )
            return started
        except (RuntimeError, OSError) as error:
            why = str(error.__cause__ or error)
    raise NoResultError(
        f"the workers of this machine could not be started ({why}): run the same command again, "
        "which goes on where this one stopped"
    )


@contextmanager
def _remote(address: str) -> Iterator[Client]:
    from distributed import Client

    try:
        client = Client(address, timeout=_ANSWER_S, set_as_default=False)
    except (OSError, ValueError) as error:
        said = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise UsageError(
            f"{address}: no Dask scheduler answers ({said}): start one with `dask scheduler`, and "
            "workers with `dask worker`"
        ) from None
    with client:
        yield client


def _wait_for_worker(client: Client, place: Place) -> None:
    try:
        client.wait_for_workers(1, timeout=place.patience_s)
    except TimeoutError:
        where = place.scheduler or "this machine"
        raise UsageError(
            f"{where}: no worker has come in {place.patience_s:.0f} s: start one with `dask worker`"
        ) from None


def _check_versions(client: Client) -> None:
    """The same version everywhere: another one makes other maps. UsageError otherwise."""
    for address, found in sorted(client.run(_version, on_error="return").items()):
        if found != __version__:
            what = found if isinstance(found, str) else f"none that works ({found})"
            raise UsageError(
                f"{address}: the worker has specmap {what}, this is {__version__}: "
                "install the same version on both sides"
            )


def _version() -> str:
    return __version__


@contextmanager
def _hushed() -> Iterator[None]:
    """Dask tells its own log what we tell in a line: nothing of it on stderr."""
    from distributed.versions import VersionMismatchWarning

    loggers = [logging.getLogger(name) for name in ("distributed", "tornado", "asyncio")]
    levels = [logger.level for logger in loggers]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", VersionMismatchWarning)
        try:
            for logger in loggers:
                logger.setLevel(logging.CRITICAL)
            yield
        finally:
            for logger, level in zip(loggers, levels, strict=True):
                logger.setLevel(level)
