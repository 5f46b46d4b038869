"""Logs that lie in a store, brought to this machine for the time of a job."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

from specmap_cli.batch.places import PlaceError, path_at, reaching, store_at
from specmap_cli.batch.sources import Source, sources_of
from specmap_cli.core.errors import LogError

_BYTES_PER_MB = 1e6


def fetched(logs: Sequence[str], directory: Path) -> dict[str, str]:
    """The path on this machine of each log, in order; those in stores are copied to `directory`.

    Raises PlaceError when they do not fit there, and for a store that cannot be reached; LogError
    for a log that is not there.
    """
    remote = {log: sources_of(log) for log in logs if path_at(log) is None}
    _check_space([source for sources in remote.values() for source in sources], directory)
    return {
        log: _fetched(log, sources, directory / str(number)) if sources else str(path_at(log))
        for number, log in enumerate(logs)
        for sources in [remote.get(log)]
    }


def _check_space(sources: Sequence[Source], directory: Path) -> None:
    needed = sum(source.bytes or 0 for source in sources)
    free = shutil.disk_usage(directory).free
    if needed > free:
        raise PlaceError(
            f"{directory.parent}: the logs need {needed / _BYTES_PER_MB:,.0f} MB, "
            f"{free / _BYTES_PER_MB:,.0f} MB are free: choose another scratch directory"
        )


def _fetched(log: str, sources: Sequence[Source], directory: Path) -> str:
    """Copy the files of one log; where it lies then: a file, or a directory of its name."""
    system, root = store_at(log)
    name = root.rstrip("/").rsplit("/", 1)[-1]
    single = len(sources) == 1 and sources[0].name == name
    target = directory if single else directory / name
    for source in sources:
        copy = target / source.name
        copy.parent.mkdir(parents=True, exist_ok=True)
        _copy(system, source, copy)
    return str(directory / name)


def _copy(system: object, source: Source, copy: Path) -> None:
    _, path = store_at(source.place)
    try:
        with reaching(source.place):
            system.get_file(path, str(copy))  # type: ignore[attr-defined]
    except FileNotFoundError:
        raise LogError(f"{source.place}: no such file or directory") from None
    got = copy.stat().st_size
    if source.bytes is not None and got != source.bytes:
        raise PlaceError(
            f"{source.place}: {got:,} of {source.bytes:,} bytes arrived: it changed, or the "
            "connection broke: run the job again"
        )
