"""Single files: read within bounds, written complete or not at all, locked by the run that writes.

By a lock a run shows that it lives: the system lets go of it however the run ends.
"""

from __future__ import annotations

import errno
import fcntl
import hashlib
import os
import re
import stat
import tempfile
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import IO

from specmap_cli.core.errors import MACHINE, OUTPUT, OUTPUT_EXISTS, UsageError

_AT_ONCE = os.O_RDONLY | os.O_NONBLOCK  # a pipe does not keep the opening waiting for a writer

_BYTES_PER_MB = 1_000_000
_TOGETHER = 8  # files that are written to the disk at once


def read_bytes(path: Path | str, most_mb: float, setting: str | None = None) -> bytes:
    """The bytes of a regular file of `most_mb` megabytes or fewer; `setting` says how many.

    Raises OSError for a file that is larger, for a pipe or a device, which may never end, and for a
    path with a zero byte, as damaged text may hold one.
    """
    most = round(most_mb * _BYTES_PER_MB)
    if "\0" in str(path):
        raise OSError(errno.EINVAL, "no name that a file can have", str(path))
    with os.fdopen(os.open(path, _AT_ONCE), "rb") as file:
        about = os.fstat(file.fileno())
        if not stat.S_ISREG(about.st_mode):
            raise OSError(errno.EINVAL, "not a regular file", str(path))
        data = file.read(min(about.st_size, most) + 1)  # as much memory is taken as is asked for
        if len(data) > about.st_size:  # it grew, or its size is not known
            data += file.read(most + 1 - len(data))
    if len(data) > most:
        more = f"; if it is meant, raise {setting}" if setting is not None else ""
        raise OSError(errno.EFBIG, f"larger than {most_mb:g} MB{more}", str(path))
    return data


def refuse_existing(path: Path) -> None:
    """Refuse an output that is there already, and that nobody said to replace: UsageError."""
    if os.path.lexists(path):
        hint = "choose another name or say --overwrite"
        raise UsageError("exists already", hint, where=path, code=OUTPUT_EXISTS)


def sha256_of(path: Path) -> str:
    """The SHA-256 of a file in hexadecimal digits. Raises OSError."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


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
            file = files.enter_context(complete_file(path))
            file.write(data)
            file.flush()
            os.fsync(file.fileno())  # a full disk is told before any takes its name


_SAME_DAY = (1980, 1, 1, 0, 0, 0)  # the first a zip knows: the same files give the same bytes
_FOR_ALL = 0o644 << 16  # readable, once unpacked


def write_zip(target: IO[bytes], files: Mapping[str, bytes]) -> None:
    """Write files by their names into one zip."""
    with zipfile.ZipFile(target, "w") as archive:
        for name, data in files.items():
            entry = zipfile.ZipInfo(name, _SAME_DAY)
            entry.external_attr = _FOR_ALL
            archive.writestr(entry, data, zipfile.ZIP_DEFLATED)


@contextmanager
def temporary_files() -> Iterator[None]:
    """A block in which temporary files are made or written: UsageError when they cannot be."""
    try:
        yield
    except OSError as error:
        where = tempfile.tempdir or "the temporary directory"
        found, advice = "temporary files cannot be written", "set TMPDIR to another directory"
        raise UsageError.of_system(error, found, advice, where=where, code=MACHINE) from None


@contextmanager
def complete_file(path: Path | str) -> Iterator[IO[bytes]]:
    """An open file that takes its name when the block ends well, and vanishes otherwise.

    It replaces one of that name. Raises UsageError when it cannot be written, and for a name that
    is that of something else than a file: a device or a pipe would be lost.
    """
    target = Path(path)
    if os.path.lexists(target) and not target.is_file():
        raise UsageError("is no regular file", "choose another place", where=target, code=OUTPUT)
    partial = partial_of(target)
    try:
        remove_leftovers(target)
        with partial.open("xb") as file:  # neither there already nor a link
            lock(file.fileno())
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, target)
        to_disk(target.parent)
    except OSError as error:
        raise UsageError.of_system(
            error, "cannot be written", "choose another place", where=target, code=OUTPUT
        ) from None
    finally:
        with suppress(OSError):
            partial.unlink(missing_ok=True)


def partial_of(target: Path) -> Path:
    """A hidden neighbour of a file in which to write it; nobody can know its name before."""
    return target.with_name(f".{target.name}.partial-{os.urandom(8).hex()}")


def continued(path: Path) -> IO[str]:
    """A file to write more lines to, made where there is none.

    Raises OSError, also for a link, by which a neighbour may have another file written, and for a
    pipe or a device.
    """
    flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | _AT_ONCE | os.O_NOFOLLOW
    if os.path.lexists(path) and not stat.S_ISREG(path.lstat().st_mode):
        raise OSError(errno.EINVAL, "is a link or no regular file", str(path))
    return os.fdopen(os.open(path, flags, 0o666), "a", buffering=1, encoding="utf-8")


def to_disk(*paths: Path) -> None:
    """Wait until files and directories would survive a power cut; links need no word."""

    def wait(path: Path) -> None:
        if stat.S_IFMT(path.lstat().st_mode) not in (stat.S_IFREG, stat.S_IFDIR):
            return
        descriptor = os.open(path, _AT_ONCE)
        try:
            os.fsync(descriptor)
        except OSError as error:
            if error.errno != errno.EINVAL:  # a file system that does not know of it
                raise
        finally:
            os.close(descriptor)

    if len(paths) > 1:  # a disk writes many as fast as one
        from concurrent.futures import ThreadPoolExecutor  # slow to load, and only to write

        with suppress(RuntimeError), ThreadPoolExecutor(_TOGETHER) as threads:  # none to be had
            list(threads.map(wait, paths))
            return
    for path in paths:
        wait(path)


def remove_leftovers(target: Path) -> tuple[Path, ...]:
    """Remove what runs that were killed had begun to write in the place of a file; returns it.

    It has the name that `partial_of` gives, and no living run holds a lock on it. Raises OSError.
    """
    removed = []
    ours = re.compile(re.escape(f".{target.name}.partial-") + r"([0-9a-f]{16}|\d+)")
    for path in target.parent.iterdir():
        left = ours.fullmatch(path.name) and path.is_file() and not path.is_symlink()
        if left and is_nobody_s(path):
            path.unlink(missing_ok=True)
            removed.append(path)
    return tuple(removed)


def lock(descriptor: int) -> bool | None:
    """Take the lock of an open file or directory; False: somebody has it; None: there are none."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None
    return True


def holder_of(descriptor: int) -> str:
    """Who has the lock of an open file or directory, as far as the system tells."""
    inode = f":{os.fstat(descriptor).st_ino}"
    with suppress(OSError):
        for line in Path("/proc/locks").read_text(encoding="ascii").splitlines():
            _, kind, _, _, process, place, *_ = line.replace("-> ", "").split()
            if kind == "FLOCK" and place.endswith(inode):
                return f"process {process}"
    return "another process"


@contextmanager
def held(path: Path) -> Iterator[bool | None]:
    """A block that holds the lock of a file or directory, as far as `lock` says; raises OSError."""
    descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
    try:
        yield lock(descriptor)
    finally:
        os.close(descriptor)


def is_nobody_s(path: Path) -> bool:
    """Whether no living run holds a file or directory; where there are no locks, nobody can say."""
    with suppress(OSError), held(path) as mine:
        return mine is True
    return False
