"""By what a job is known: a digest of all that decides its result.

It is SHA-256 over the version of specmap, the steps with their options, the contents of the files
and maps that options name (wherever they lie), and the names and identities of the logs. What it
is not: a proof. A log on this machine that is changed in its middle, keeping its size and its time
of change, stays unnoticed; one that is copied, or only touched, counts as another. Limits, folders
and the machine are no part of it.
"""

from __future__ import annotations

import functools
import hashlib
import json
from collections.abc import Iterable
from pathlib import Path

from specmap_cli.batch.records import InputRecord, Job, Step
from specmap_cli.batch.sources import Source, sources_of
from specmap_cli.core.errors import SpecmapError, UsageError, reason

_FORMAT = 1  # of what is hashed


def digest_of(job: Job, version: str, inputs: Iterable[InputRecord]) -> str:
    """The digest of a job and its `inputs_of`, hexadecimal.

    Raises UsageError for a file of an option that cannot be read.
    """
    steps = [[step.command, *_options(step)] for step in job.steps]
    told = [_FORMAT, version, steps, [each.identity for each in inputs]]
    return _hash(json.dumps(told).encode())


def inputs_of(job: Job) -> tuple[InputRecord, ...]:
    """The logs of a job as they are now.

    Raises LogError or PlaceError for a log that cannot be reached.
    """
    return tuple(_input(log, sources_of(log)) for log in job.logs)


def bytes_of(job: Job) -> int:
    """The bytes of a job's logs; those that cannot be told count nothing."""
    total = 0
    for log in job.logs:
        try:
            total += sum(source.bytes or 0 for source in sources_of(log))
        except SpecmapError:  # the job itself will tell
            continue
    return total


def _input(log: str, sources: tuple[Source, ...]) -> InputRecord:
    sizes = [source.bytes for source in sources]
    known = [size for size in sizes if size is not None]
    told = [[source.name, source.identity] for source in sources]
    return InputRecord(
        log=log,
        bytes=sum(known) if len(known) == len(sizes) else None,
        identity=_hash(json.dumps(told).encode()),
    )


def _options(step: Step) -> list[str]:
    """The options of a step, with the contents of files in the place of their paths."""
    written = []
    for option in step.options:
        name, _, path = option.partition("=")
        written.append(f"{name}={_contents(Path(path))}" if option in step.inputs else option)
    return written


def _contents(path: Path) -> str:
    """A hash of a file, or of all files in a directory with their names."""
    try:
        if not path.is_dir():
            return _file(path)
        files = sorted(file for file in path.rglob("*") if file.is_file())
        told = [[str(file.relative_to(path)), _file(file)] for file in files]
        return _hash(json.dumps(told).encode())
    except OSError as error:
        raise UsageError(f"{path}: cannot read: {reason(error)}") from None


def _file(path: Path) -> str:
    status = path.stat()
    return _contents_of_file(path, status.st_size, status.st_mtime_ns)


@functools.lru_cache(maxsize=4096)  # a golden map is of every job of a fleet
def _contents_of_file(path: Path, _size: int, _mtime_ns: int) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _hash(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
