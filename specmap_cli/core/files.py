"""Single files: read within bounds, and written complete or not at all."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import IO

from specmap_cli.core.errors import UsageError

# A pipe does not keep the opening waiting for a writer. Not every system has such pipes.
_AT_ONCE = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)


def read_bytes(path: Path | str, most: int) -> bytes:
    """The bytes of a regular file of `most` bytes or fewer.

    Raises OSError for a file that is larger, and for a pipe or a device, which may never end.
    """
    with os.fdopen(os.open(path, _AT_ONCE), "rb") as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise OSError(errno.EINVAL, "not a regular file", str(path))
        data = file.read(most + 1)
    if len(data) > most:
        raise OSError(errno.EFBIG, f"larger than {most / 1e6:g} MB", str(path))
    return data


def write_text(path: Path | str, text: str) -> None:
    """Write a file, replacing one of that name. UsageError when it cannot be written."""
    write_bytes(path, text.encode("utf-8"))


def write_bytes(path: Path | str, data: bytes) -> None:
    """Write a file, replacing one of that name. UsageError when it cannot be written."""
    with complete_file(path) as file:
        file.write(data)


def write_together(contents: Mapping[Path, bytes]) -> None:
    """Write several files, replacing those of their names: all of them, or none.

    UsageError when one cannot be written.
    """
    with ExitStack() as files:  # each takes its name only when all have been written
        for path, data in contents.items():
            files.enter_context(complete_file(path)).write(data)


@contextmanager
def complete_file(path: Path | str) -> Iterator[IO[bytes]]:
    """An open file that takes its name when the block ends well, and vanishes otherwise.

    It replaces one of that name. Raises UsageError when it cannot be written, and for a name that
    is that of something else than a file: a device or a pipe would be lost.
    """
    target = Path(path)
    if os.path.lexists(target) and not target.is_file():
        raise UsageError(f"{target}: is no regular file: choose another place")
    partial = target.with_name(f".{target.name}.partial-{os.getpid()}")
    try:
        with partial.open("wb") as file:
            yield file
        os.replace(partial, target)
    except OSError as error:
        raise UsageError(
            f"{target}: cannot be written: {error.strerror}; choose another place"
        ) from None
    finally:
        with suppress(OSError):
            partial.unlink(missing_ok=True)
