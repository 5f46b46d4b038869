"""The first bytes of a file, from which a reader is chosen."""

from __future__ import annotations

import stat
from pathlib import Path

from specmap_cli.core.errors import LOG_MISSING, LogError
from specmap_cli.logs.readers.recording import unreadable

HEAD_BYTES = 4096  # one page: longer than the magic of any format, short enough to read of any file
_LONGEST_CHARACTER_BYTES = 4  # of UTF-8
_KINDS = (
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


def is_directory(path: Path) -> bool:
    """Whether a path is a directory; raises LogError when it is neither that nor a regular file.

    A pipe, a socket or a device would keep a reader waiting, perhaps for ever.
    """
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        raise LogError(f"{path}: no such file or directory", code=LOG_MISSING) from None
    except OSError as error:
        raise unreadable(path, error) from None
    if not (stat.S_ISDIR(mode) or stat.S_ISREG(mode)):
        kind = next((name for is_kind, name in _KINDS if is_kind(mode)), "no file")
        raise LogError(f"{path}: is {kind}; a log must be a file or a directory: copy it to one")
    return stat.S_ISDIR(mode)


def head_of(path: Path) -> bytes:
    """The first bytes of a file; raises LogError when there is none or it cannot be read."""
    try:
        with path.open("rb") as file:
            return file.read(HEAD_BYTES)
    except FileNotFoundError:
        raise LogError(f"{path}: no such file or directory", code=LOG_MISSING) from None
    except OSError as error:
        raise unreadable(path, error) from None


def is_text(head: bytes) -> bool:
    """Whether the first bytes of a file are text in UTF-8."""
    try:
        head.decode("utf-8")
    except UnicodeDecodeError as error:
        # the end of the piece may cut a character in two
        return error.start > len(head) - _LONGEST_CHARACTER_BYTES
    return True
