"""Places of files: paths of this machine, stores that fsspec knows, and temporary directories."""

from __future__ import annotations

import errno
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from specmap_cli.core.errors import MACHINE, PACKAGE, SpecmapError, UsageError
from specmap_cli.core.files import lock

_SCHEME = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+)(://|::)")
_LOCAL = ("file://", "local://")
_SCRATCH = "specmap-job-"
_OURS = re.compile(_SCRATCH + "[0-9a-f]{8}")
_TRIES = 5  # to have a temporary directory that nobody sweeps away


class PlaceError(SpecmapError):
    """A disk or a store cannot be used: full, out of reach, or closed to us."""

    exit_code = 2
    code = MACHINE


def path_at(place: str) -> Path | None:
    """The path of a place on this machine; None for a URL of a store."""
    for scheme in _LOCAL:
        if place.startswith(scheme):
            return Path(place.removeprefix(scheme))
    return None if _SCHEME.match(place) else Path(place)


def store_at(url: str) -> tuple[Any, str]:
    """The file system of a URL and the path in it. Raises UsageError for one that is not known."""
    try:
        import fsspec
    except ImportError:
        raise UsageError(
            "needs an extra", "pip install 'specmap-cli[batch]'", where=url, code=PACKAGE
        ) from None
    try:
        with reaching(url):
            system, path = fsspec.core.url_to_fs(url)
            return system, str(path)
    except PlaceError as error:
        cause = error.__cause__
        if isinstance(cause, ImportError | ValueError):
            raise UsageError(cause, where=url, code=PACKAGE) from None
        raise


@contextmanager
def reaching(url: str) -> Iterator[None]:
    """A block that speaks with a store: whatever it raises is a PlaceError.

    Raises FileNotFoundError and errors of our own as they are.
    """
    try:
        yield
    except (FileNotFoundError, SpecmapError):
        raise
    except Exception as error:  # any of any store's library: they have no class in common
        said = " ".join(str(error).split()) or type(error).__name__
        raise PlaceError(f"cannot be reached or used: {said:.300}", where=url) from error


@contextmanager
def scratch_directory(root: str | None) -> Iterator[Path]:
    """A directory of its own below `root` (None: that of the system), removed after the block.

    Those that killed runs left there are removed before: no living run holds a lock on them.
    Raises PlaceError when there can be none.
    """
    parent = Path(root or tempfile.gettempdir())
    try:
        parent.mkdir(parents=True, exist_ok=True)
        for left in list(parent.iterdir()):
            if _OURS.fullmatch(left.name) and not left.is_symlink():
                with suppress(OSError):
                    descriptor = os.open(left, os.O_RDONLY | os.O_DIRECTORY)
                    try:
                        if lock(descriptor):
                            shutil.rmtree(left, ignore_errors=True)
                    finally:
                        os.close(descriptor)
        directory, descriptor = _locked(parent)
    except OSError as error:
        found, advice = "no temporary files can be made there", "choose another scratch directory"
        raise PlaceError.of_system(error, found, advice, where=parent) from None
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
        directory = parent / f"{_SCRATCH}{os.urandom(4).hex()}"
        directory.mkdir(mode=0o700)
        with suppress(FileNotFoundError):
            descriptor = os.open(directory, os.O_RDONLY)
            if (lock(descriptor) or not left) and os.path.lexists(directory):
                return directory, descriptor
            os.close(descriptor)
        with suppress(OSError):
            directory.rmdir()
    raise OSError(errno.EAGAIN, os.strerror(errno.EAGAIN), str(parent))
