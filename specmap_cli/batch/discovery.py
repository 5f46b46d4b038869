"""Recordings in directories and behind patterns, on this machine and in stores.

Here a recording is known by what is in it, as `specmap build` knows it, or by its suffix: one whose
beginning is damaged must not be passed over. In a store only the suffix counts.
"""

from __future__ import annotations

import glob
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from specmap_cli.batch.places import path_at, reaching, store_at
from specmap_cli.batch.steps import JOB
from specmap_cli.core.errors import LogError, UsageError
from specmap_cli.core.shortage import reason
from specmap_cli.logs.opening import known_readers, looks_like_a_log
from specmap_cli.logs.readers.recording import Recording
from specmap_cli.maps.filenames import TOPOLOGY

_SUFFIXES = {".mcap", ".bag", ".db3"}
_ONLY_IN_STORES = {".log"}  # here, text must look like a recording
_COMPRESSED = {".zst", ".gz", ".bz2", ".lz4", ".xz"}
_ROSBAG2 = "metadata.yaml"  # lies in the directory of one recording
_RESULTS = {TOPOLOGY, JOB}  # lie in directories of results, whose recordings are no logs
_MAGIC = frozenset("*?[")


@dataclass(frozen=True, slots=True)
class Found:
    """A recording: its path or URL, and its name within what was searched."""

    log: str
    name: str


def logs_at(place: str) -> list[Found]:
    """The recordings that a file, a directory or a pattern stands for, by name.

    Raises UsageError when there is none.
    """
    path = path_at(place)
    found = list(_in_store(place) if path is None else _here(path))
    if not found:
        raise UsageError(f"{place}: no recording there")
    return found


def plain_name(log: str) -> str:
    """The name of a file without the suffixes of recordings: `monday.bag.zst` is `monday`."""
    name = PurePosixPath(log.rstrip("/"))
    if name.suffix.lower() in _COMPRESSED:
        name = name.with_suffix("")
    known = name.suffix.lower() in _SUFFIXES | _ONLY_IN_STORES
    return str(name.with_suffix("") if known else name)


def _here(path: Path) -> Iterator[Found]:
    path = Path(os.path.abspath(path))
    if path.exists() or not _MAGIC & set(str(path)):
        yield from _at_path(path, path.parent)
        return
    fixed = next(part for part in path.parents if not _MAGIC & set(str(part)))
    for match in sorted(glob.glob(str(path), recursive=True)):
        yield from _at_path(Path(match), fixed)


def _at_path(path: Path, root: Path) -> Iterator[Found]:
    """A file, or all recordings below a directory, by their names below `root`."""
    if not path.is_dir():
        if not os.path.lexists(path):
            raise UsageError(f"{path}: no such file or directory")
        yield Found(str(path), plain_name(path.relative_to(root).as_posix()))
        return
    root = path if root == path.parent else root
    for log in _below(path, known_readers()):
        inside = log.relative_to(root).as_posix() if log != root else path.name
        yield Found(str(log), plain_name(inside))


def _below(directory: Path, readers: Mapping[str, type[Recording]]) -> Iterator[Path]:
    """The recordings below a directory: files, and directories of rosbag2."""

    def refuse(error: OSError) -> None:
        raise UsageError(f"{error.filename}: cannot read: {reason(error)}")

    for where, inner, files in os.walk(directory, onerror=refuse):
        inner[:] = sorted(name for name in inner if not name.startswith("."))
        if _RESULTS & set(files):
            inner.clear()
        elif _ROSBAG2 in files:
            inner.clear()
            yield Path(where)
        else:
            visible = sorted(name for name in files if not name.startswith("."))
            yield from (
                Path(where) / name for name in visible if _is_log(Path(where) / name, readers)
            )


def _is_log(file: Path, readers: Mapping[str, type[Recording]]) -> bool:
    if _has_suffix(file.name, _SUFFIXES):
        return True
    try:
        return file.is_file() and looks_like_a_log(file, readers)
    except LogError:  # it cannot be read, and nothing says that it is a recording
        return False


def _has_suffix(name: str, suffixes: set[str]) -> bool:
    stem = PurePosixPath(name)
    if stem.suffix.lower() in _COMPRESSED:
        stem = stem.with_suffix("")
    return stem.suffix.lower() in suffixes


def _in_store(url: str) -> Iterator[Found]:
    system, root = store_at(url)
    with reaching(url):
        try:
            if _MAGIC & set(root):
                fixed = root[: min(root.index(sign) for sign in _MAGIC if sign in root)]
                matches = sorted(system.glob(root))
                yield from _matched(system, matches, fixed.rsplit("/", 1)[0])
            elif system.isdir(root):
                yield from _named(system, system.find(root), root, root)
            elif system.exists(root):
                yield Found(url, plain_name(root.rsplit("/", 1)[-1]))
        except FileNotFoundError:
            raise UsageError(f"{url}: no such file or directory") from None


def _matched(system: Any, matches: Sequence[str], root: str) -> Iterator[Found]:
    """The recordings that a pattern matches: files, and those below directories."""
    for match in matches:
        if system.isdir(match):
            yield from _named(system, system.find(match), match, root)
        else:
            yield Found(system.unstrip_protocol(match), plain_name(_inside(match, root)))


def _named(system: Any, files: Sequence[str], top: str, root: str) -> Iterator[Found]:
    """The recordings among the files below `top`, by their names below `root`."""
    by_folder: dict[str, list[str]] = {}
    for file in sorted(files):
        by_folder.setdefault(file.rsplit("/", 1)[0], []).append(file)
    closed = tuple(
        f"{folder}/"
        for folder, inside in by_folder.items()
        if {file.rsplit("/", 1)[-1] for file in inside} & {*_RESULTS, _ROSBAG2}
    )
    for folder, inside in by_folder.items():
        names = {file.rsplit("/", 1)[-1] for file in inside}
        hidden = any(part.startswith(".") for part in _inside(folder, top).split("/"))
        if hidden or _RESULTS & names or any(folder.startswith(each) for each in closed):
            continue
        logs = [folder] if _ROSBAG2 in names else [file for file in inside if _is_named(file)]
        for log in logs:
            yield Found(
                system.unstrip_protocol(log),
                plain_name(_inside(log, root) or log.rsplit("/", 1)[-1]),
            )


def _is_named(file: str) -> bool:
    name = file.rsplit("/", 1)[-1]
    return not name.startswith(".") and _has_suffix(name, _SUFFIXES | _ONLY_IN_STORES)


def _inside(path: str, root: str) -> str:
    return path.removeprefix(root).strip("/")
