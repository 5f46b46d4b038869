"""The files of a log, on this machine or in a store: their size, and what they are known by."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from specmap_cli.batch.places import path_at, reaching, store_at
from specmap_cli.core.errors import LogError, reason

ENDS_BYTES = 1 << 16  # of a file's beginning and of its end
_TAGS = ("ETag", "etag", "md5Hash", "content_md5", "md5", "checksum")  # of stores


@dataclass(frozen=True, slots=True)
class Source:
    """A file of a log: where it is, its name in the log, its bytes (None: unknown), its identity.

    The identity changes when the file does. Of a file here it is size, time of change in
    nanoseconds, and a hash of the first and the last 64 KiB; of one in a store, what the store
    says: its tag, or fsspec's key.
    """

    place: str
    name: str
    bytes: int | None
    identity: str


def sources_of(log: str) -> tuple[Source, ...]:
    """The files of a log: itself, or those in it when it is a directory.

    Raises LogError for a log that is missing or cannot be read, PlaceError for a store.
    """
    path = path_at(log)
    found = tuple(_in_store(log) if path is None else _here(path))
    if not found:
        raise LogError(f"{log}: no recording in this directory")
    return found


def _here(path: Path) -> Iterator[Source]:
    try:
        if not path.is_dir():
            yield _file(path)
            return
        for file in sorted(path.iterdir()):
            if file.is_file() and not file.name.startswith("."):
                yield _file(file)
    except FileNotFoundError:
        raise LogError(f"{path}: no such file or directory") from None
    except OSError as error:
        raise LogError(f"{path}: cannot read: {reason(error)}") from None


def _file(path: Path) -> Source:
    """A file of this machine; its reader refuses a pipe or a device, which are not opened here."""
    status = path.stat()
    ends = hashlib.sha256()
    if path.is_file():
        with path.open("rb") as file:
            ends.update(file.read(ENDS_BYTES))
            file.seek(-min(ENDS_BYTES, status.st_size), os.SEEK_END)
            ends.update(file.read(ENDS_BYTES))
    identity = f"{status.st_size} {status.st_mtime_ns} {ends.hexdigest()}"
    return Source(str(path), path.name, status.st_size, identity)


def _in_store(url: str) -> Iterator[Source]:
    system, root = store_at(url)
    with reaching(url):
        try:
            found = system.find(root, detail=True)
            if not found:
                system.invalidate_cache()
                found = {root: system.info(root)}
        except FileNotFoundError:
            raise LogError(f"{url}: no such file or directory") from None
        for path in sorted(found):
            name = path.removeprefix(root).lstrip("/") or path.rsplit("/", 1)[-1]
            if ".." in name.split("/") or "\0" in name:  # a store allows what no directory does
                raise LogError(f"{url}: {name!r:.60}: a name that leads out of the log: rename it")
            size = found[path].get("size")
            identity = _tag(system, path, found[path])
            yield Source(system.unstrip_protocol(path), name, size, f"{size} {identity}")


def _tag(system: Any, path: str, info: dict[str, Any]) -> str:
    """What a store says of a file's contents, or else fsspec's key of it."""
    for name in _TAGS:
        if info.get(name):
            return str(info[name])
    return str(system.ukey(path))
