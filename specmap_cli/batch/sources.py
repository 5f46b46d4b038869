"""The logs of jobs: which recordings there are, by what they are known, and fetched from stores.

On this machine a recording is recognised by what is in it, as `specmap build` does, or by its
suffix: one whose beginning is damaged must not be passed over. In a store only the suffix counts.

A job is known by a digest of all that decides its result (docs/batch.md). It is no proof: a log
that is changed in its middle, keeping its size and its time of change, stays unnoticed; one that is
copied, or only touched, counts as another. Limits, folders and the machine are no part of it.
"""

from __future__ import annotations

import functools
import glob
import hashlib
import json
import os
import shutil
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

from specmap_cli.batch.places import PlaceError, path_at, reaching, store_at
from specmap_cli.batch.records import JOB, InputRecord, Job
from specmap_cli.core.errors import LOG_MISSING, LogError, SpecmapError, UsageError
from specmap_cli.core.text import quoted
from specmap_cli.maps.filenames import TOPOLOGY

_SUFFIXES = {".mcap", ".bag", ".db3"}
_IN_STORES = {*_SUFFIXES, ".log"}  # here, text must look like a recording
_COMPRESSED = {".zst", ".gz", ".bz2", ".lz4", ".xz"}
_ROSBAG2 = "metadata.yaml"  # lies in the directory of one recording
_RESULTS = {TOPOLOGY, JOB}  # lie in directories of results, whose recordings are no logs
_WILDCARDS = frozenset("*?[")
_ENDS_BYTES = 1 << 16  # of a file's beginning and of its end
_TAGS = ("ETag", "etag", "md5Hash", "content_md5", "md5", "checksum")  # of stores
_DIGEST_FORMAT = 1
_BYTES_PER_MB = 1e6


class Found(NamedTuple):
    """A recording: its path or URL, and its name within what was searched."""

    log: str
    name: str


class Source(NamedTuple):
    """A file of a log: where it is, its name in the log, its bytes (None: unknown), its identity.

    The identity changes when the file does. Of a file here it is size, time of change in
    nanoseconds, and a hash of the first and the last 64 KiB; of one in a store, what the store
    says: its tag, or fsspec's key.
    """

    place: str
    name: str
    bytes: int | None
    identity: str


def logs_at(place: str) -> list[Found]:
    """The recordings that a file, a directory or a pattern stands for, by name.

    Raises LogError when there is none.
    """
    path = path_at(place)
    if path is None:
        found = list(_found_in_store(place))
    else:
        path = Path(os.path.abspath(path))
        if path.exists() or not _WILDCARDS & set(str(path)):
            found = list(_at_path(path, path.parent))
        else:
            root = next(part for part in path.parents if not _WILDCARDS & set(str(part)))
            matches = sorted(glob.glob(str(path), recursive=True))
            found = [each for match in matches for each in _at_path(Path(match), root)]
    if not found:
        raise _missing(place, "no recording there")
    return found


def _missing(place: str | Path, found: str = "no such file or directory") -> LogError:
    return LogError(found, where=place, code=LOG_MISSING)


def sources_of(log: str) -> tuple[Source, ...]:
    """The files of a log: itself, or those in it when it is a directory.

    Raises LogError for a log that is missing or cannot be read, PlaceError for a store.
    """
    path = path_at(log)
    if path is None:
        found = tuple(_files_in_store(log))
    else:
        try:
            files = [path]
            if path.is_dir():
                inner = [file for file in path.iterdir() if not file.name.startswith(".")]
                files = sorted(filter(Path.is_file, inner))
            found = tuple(map(_file, files))
        except FileNotFoundError:
            raise _missing(path) from None
        except OSError as error:
            raise LogError.of_system(error, "cannot read", where=path) from None
    if not found:
        raise LogError("no recording in this directory", where=log)
    return found


def bytes_of(job: Job) -> int:
    """The bytes of a job's logs; those that cannot be told count nothing."""
    total = 0
    for log in job.logs:
        try:
            total += sum(source.bytes or 0 for source in sources_of(log))
        except SpecmapError:  # the job itself will tell
            continue
    return total


def inputs_of(job: Job) -> tuple[InputRecord, ...]:
    """The logs of a job as they are now.

    Raises LogError or PlaceError for a log that cannot be reached.
    """
    made = []
    for log in job.logs:
        sources = sources_of(log)
        known = [source.bytes for source in sources if source.bytes is not None]
        total = sum(known) if len(known) == len(sources) else None
        identity = _hash([[source.name, source.identity] for source in sources])
        made.append(InputRecord(log=log, bytes=total, identity=identity))
    return tuple(made)


def digest_of(job: Job, version: str, inputs: Iterable[InputRecord]) -> str:
    """The digest of a job and its `inputs_of`, hexadecimal.

    Raises UsageError for a file of an option that cannot be read.
    """
    steps: list[list[str]] = []
    for step in job.steps:
        steps.append([step.command])
        for option in step.options:  # with the contents of files in the place of their paths
            name, _, path = option.partition("=")
            of_file = option in step.inputs
            steps[-1].append(f"{name}={_contents(Path(path))}" if of_file else option)
    return _hash([_DIGEST_FORMAT, version, steps, [each.identity for each in inputs]])


def fetched(logs: Sequence[str], directory: Path) -> dict[str, str]:
    """The path on this machine of each log, in order; those in stores are copied to `directory`.

    Raises PlaceError when they do not fit there, and for a store that cannot be reached; LogError
    for a log that is not there.
    """
    remote = {log: sources_of(log) for log in logs if path_at(log) is None}
    needed = sum(source.bytes or 0 for sources in remote.values() for source in sources)
    free = shutil.disk_usage(directory).free
    if needed > free:
        raise PlaceError(
            f"the logs need {needed / _BYTES_PER_MB:,.0f} MB, "
            f"{free / _BYTES_PER_MB:,.0f} MB are free",
            "choose another scratch directory",
            where=directory.parent,
        )
    return {
        log: _fetched(log, remote[log], directory / str(number))
        if log in remote
        else str(path_at(log))
        for number, log in enumerate(logs)
    }


def _at_path(path: Path, root: Path) -> Iterator[Found]:
    """A file, or all recordings below a directory, by their names below `root`."""
    if not path.is_dir():
        if not os.path.lexists(path):
            raise _missing(path)
        yield Found(str(path), _plain_name(path.relative_to(root).as_posix()))
        return
    root = path if root == path.parent else root
    for log in _below(path):
        inside = log.relative_to(root).as_posix() if log != root else path.name
        yield Found(str(log), _plain_name(inside))


def _below(directory: Path) -> Iterator[Path]:
    """The recordings below a directory: files, and directories of rosbag2."""
    from specmap_cli.logs.opening import known_readers, looks_like_a_log  # no worker needs them

    readers = known_readers()

    def refuse(error: OSError) -> None:
        raise LogError.of_system(error, "cannot read", where=error.filename)

    def is_log(file: Path) -> bool:
        if _uncompressed(file.name).suffix.lower() in _SUFFIXES:
            return True
        try:
            return file.is_file() and looks_like_a_log(file, readers)
        except LogError:  # it cannot be read, and nothing says that it is a recording
            return False

    for where, inner, files in os.walk(directory, onerror=refuse):
        inner[:] = sorted(name for name in inner if not name.startswith("."))
        if _RESULTS & set(files):
            inner.clear()
        elif _ROSBAG2 in files:
            inner.clear()
            yield Path(where)
        else:
            visible = (Path(where) / name for name in sorted(files) if not name.startswith("."))
            yield from filter(is_log, visible)


def _plain_name(log: str) -> str:
    """The name of a file without the suffixes of recordings: `monday.bag.zst` is `monday`."""
    name = _uncompressed(log.rstrip("/"))
    return str(name.with_suffix("") if name.suffix.lower() in _IN_STORES else name)


def _uncompressed(name: str) -> PurePosixPath:
    """A name without the suffix of a compression."""
    path = PurePosixPath(name)
    return path.with_suffix("") if path.suffix.lower() in _COMPRESSED else path


def _found_in_store(url: str) -> Iterator[Found]:
    system, root = store_at(url)
    with reaching(url):
        try:
            if _WILDCARDS & set(root):
                fixed = root[: min(root.index(sign) for sign in _WILDCARDS if sign in root)]
                fixed = fixed.rsplit("/", 1)[0]
                for match in sorted(system.glob(root)):
                    if system.isdir(match):
                        yield from _below_in_store(system, match, fixed)
                    else:
                        name = _plain_name(_inside(match, fixed))
                        yield Found(system.unstrip_protocol(match), name)
            elif system.isdir(root):
                yield from _below_in_store(system, root, root)
            elif system.exists(root):
                yield Found(url, _plain_name(root.rsplit("/", 1)[-1]))
        except FileNotFoundError:
            raise _missing(url) from None


def _below_in_store(system: Any, top: str, root: str) -> Iterator[Found]:
    """The recordings among the files below `top`, by their names below `root`."""
    by_folder: dict[str, dict[str, str]] = {}  # the files of a folder by their names
    for file in sorted(system.find(top)):
        folder, name = file.rsplit("/", 1)[0], file.rsplit("/", 1)[-1]
        by_folder.setdefault(folder, {})[name] = file
    closed = tuple(
        f"{folder}/" for folder, files in by_folder.items() if files.keys() & {*_RESULTS, _ROSBAG2}
    )
    for folder, files in by_folder.items():
        hidden = any(part.startswith(".") for part in _inside(folder, top).split("/"))
        if hidden or _RESULTS & files.keys() or folder.startswith(closed):
            continue
        named = [
            file
            for name, file in files.items()
            if not name.startswith(".") and _uncompressed(name).suffix.lower() in _IN_STORES
        ]
        for log in [folder] if _ROSBAG2 in files else named:
            name = _inside(log, root) or log.rsplit("/", 1)[-1]
            yield Found(system.unstrip_protocol(log), _plain_name(name))


def _inside(path: str, root: str) -> str:
    return path.removeprefix(root).strip("/")


def _file(path: Path) -> Source:
    """A file of this machine; its reader refuses a pipe or a device, which are not opened here."""
    status = path.stat()
    ends = hashlib.sha256()
    if path.is_file():
        with path.open("rb") as file:
            ends.update(file.read(_ENDS_BYTES))
            file.seek(-min(_ENDS_BYTES, status.st_size), os.SEEK_END)
            ends.update(file.read(_ENDS_BYTES))
    identity = f"{status.st_size} {status.st_mtime_ns} {ends.hexdigest()}"
    return Source(str(path), path.name, status.st_size, identity)


def _files_in_store(url: str) -> Iterator[Source]:
    system, root = store_at(url)
    with reaching(url):
        try:
            found = system.find(root, detail=True)
            if not found:
                system.invalidate_cache()
                found = {root: system.info(root)}
        except FileNotFoundError:
            raise _missing(url) from None
        for path, info in sorted(found.items()):
            name = path.removeprefix(root).lstrip("/") or path.rsplit("/", 1)[-1]
            if ".." in name.split("/") or "\0" in name:  # a store allows what no directory does
                raise LogError(
                    f"{quoted(name)}: a name that leads out of the log", "rename it", where=url
                )
            tag = next((str(info[each]) for each in _TAGS if info.get(each)), None)
            identity = f"{info.get('size')} {tag or system.ukey(path)}"
            yield Source(system.unstrip_protocol(path), name, info.get("size"), identity)


def _fetched(log: str, sources: Sequence[Source], directory: Path) -> str:
    """Copy the files of one log; where it lies then: a file, or a directory of its name."""
    system, root = store_at(log)
    name = root.rstrip("/").rsplit("/", 1)[-1]
    single = len(sources) == 1 and sources[0].name == name
    target = directory if single else directory / name
    for source in sources:
        copy = target / source.name
        copy.parent.mkdir(parents=True, exist_ok=True)
        try:
            with reaching(source.place):
                system.get_file(store_at(source.place)[1], str(copy))
        except FileNotFoundError:
            raise _missing(source.place) from None
        got = copy.stat().st_size
        if source.bytes is not None and got != source.bytes:
            raise PlaceError(
                f"{got:,} of {source.bytes:,} bytes arrived: it changed, or the connection broke",
                "run the job again",
                where=source.place,
            )
    return str(directory / name)


def _contents(path: Path) -> str:
    """A hash of a file, or of all files in a directory with their names."""

    def of_file(file: Path) -> str:
        status = file.stat()
        return _hash_of_file(file, status.st_size, status.st_mtime_ns)

    try:
        if not path.is_dir():
            return of_file(path)
        files = sorted(file for file in path.rglob("*") if file.is_file())
        return _hash([[str(file.relative_to(path)), of_file(file)] for file in files])
    except OSError as error:
        raise UsageError.of_system(error, "cannot read", where=path) from None


@functools.lru_cache(maxsize=4096)  # a golden map is of every job of a fleet
def _hash_of_file(path: Path, _size: int, _mtime_ns: int) -> str:
    """As long as it has this size and this time of change."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _hash(value: Any) -> str:
    """The SHA-256 of a value as JSON, hexadecimal."""
    return hashlib.sha256(json.dumps(value).encode()).hexdigest()
