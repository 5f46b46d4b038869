"""What runs that were killed left beside an output directory: found, and put right.

A run writes into a hidden sibling of its target and holds a lock on it. The system lets go of the
lock when the run ends, however it ends: a sibling without a lock belongs to nobody any more.
"""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from specmap_cli.core.files import is_nobody_s, lock
from specmap_cli.maps.filenames import TOPOLOGY

_TOKEN = "[0-9a-f]{8}"  # of the names that OutputDirectory gives


def sibling(target: Path, role: str, token: str) -> Path:
    """A hidden neighbour of the target: same file system, so that a rename is atomic."""
    return target.parent / f".{target.name}.{role}-{token}"


def put_right(target: Path, marker: str = TOPOLOGY) -> list[str]:
    """Restore the map that a killed run had moved away, remove what it had written; one line each.

    A run that was killed between its two renames leaves the old map as `.replaced` and no map in
    its place. Directories of other names, those without the file `marker`, and those that a living
    run holds, stay untouched.
    """
    done = []
    for old in _ours(target, "replaced"):
        if not (old / marker).is_file():
            continue  # no map: not ours
        if target.exists():
            os.rename(old, _as_partial(old, target))  # by that name it may go piece by piece
            done.append(f"removed {old.name}, the map that it had replaced")
        else:
            os.rename(old, target)
            done.append(f"restored the map that it had moved away as {old.name}")
    for partial in _ours(target, "partial"):
        if is_nobody_s(partial):
            shutil.rmtree(partial, ignore_errors=True)
            done.append(f"removed {partial.name}, which it had begun to write")
    return [f"{target}: an earlier run was killed: {what}" for what in done]


@contextmanager
def held(directory: Path) -> Iterator[None]:
    """Hold a lock on a directory, where the system has such locks, while the block runs."""
    descriptor = os.open(directory, os.O_RDONLY)
    try:
        lock(descriptor)
        yield
    finally:
        os.close(descriptor)


def _ours(target: Path, role: str) -> list[Path]:
    """The siblings of the target whose names only OutputDirectory gives, in order."""
    name = re.compile(re.escape(f".{target.name}.{role}-") + _TOKEN)
    with suppress(OSError):
        return [
            path
            for path in sorted(target.parent.iterdir())
            if name.fullmatch(path.name) and path.is_dir() and not path.is_symlink()
        ]
    return []


def _as_partial(old: Path, target: Path) -> Path:
    """The name of a replaced directory as one that was not finished."""
    return sibling(target, "partial", old.name[-8:])
