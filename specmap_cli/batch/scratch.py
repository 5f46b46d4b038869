"""Temporary directories that no run leaves behind, not even one that is killed."""

from __future__ import annotations

import errno
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from specmap_cli.batch.places import PlaceError
from specmap_cli.core.errors import reason
from specmap_cli.core.files import lock

_NAME = "specmap-job-"
_TRIES = 5  # to have a directory that nobody sweeps away
_OURS = re.compile(_NAME + "[0-9a-f]{8}")


@contextmanager
def scratch_directory(root: str | None) -> Iterator[Path]:
    """A directory of its own below `root` (None: that of the system), removed after the block.

    Those that killed runs left there are removed before: no living run holds a lock on them.
    Raises PlaceError when there can be none.
    """
    parent = Path(root or tempfile.gettempdir())
    try:
        parent.mkdir(parents=True, exist_ok=True)
        _sweep(parent)
        directory, descriptor = _locked(parent)
    except OSError as error:
        why = reason(error, "choose another scratch directory")
        raise PlaceError(f"{parent}: no temporary files can be made there: {why}") from None
    try:
        yield directory
    finally:
        shutil.rmtree(directory, ignore_errors=True)
        os.close(descriptor)


def _locked(parent: Path) -> tuple[Path, int]:
    """A new directory and the descriptor that holds its lock.

    Between the two, another run may have taken the directory for one that nobody has: it holds the
    lock until the directory is gone. Where no lock can be had at all, nobody sweeps either.
    """
    for left in reversed(range(_TRIES)):
        directory = parent / f"{_NAME}{os.urandom(4).hex()}"
        directory.mkdir(mode=0o700)
        with suppress(FileNotFoundError):
            descriptor = os.open(directory, os.O_RDONLY)
            if (lock(descriptor) or not left) and os.path.lexists(directory):
                return directory, descriptor
            os.close(descriptor)
        with suppress(OSError):
            directory.rmdir()
    raise OSError(errno.EAGAIN, os.strerror(errno.EAGAIN), str(parent))


def _sweep(parent: Path) -> None:
    """Remove what killed runs left."""
    for path in list(parent.iterdir()):
        if not _OURS.fullmatch(path.name) or path.is_symlink():
            continue
        with suppress(OSError):
            descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
            try:
                if lock(descriptor):
                    shutil.rmtree(path, ignore_errors=True)
            finally:
                os.close(descriptor)
