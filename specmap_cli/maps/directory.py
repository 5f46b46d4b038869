"""An output directory that appears complete or not at all.

Everything is written to a hidden sibling of the target, which is renamed into place at the end.
The sibling is made on entering, before the long work, so that a target that cannot be written is
told at once and not after an hour.

A run holds a lock on its sibling. The system lets go of the lock when the run ends, however it
ends: a sibling without a lock belongs to nobody any more, and the next run puts it right.
"""

from __future__ import annotations

import ctypes
import functools
import os
import re
import shutil
import signal
import threading
import weakref
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from types import FrameType, TracebackType

from specmap_cli.core.errors import OUTPUT, OUTPUT_EXISTS, UsageError, is_of_the_place
from specmap_cli.core.files import is_nobody_s, lock
from specmap_cli.core.progress import Progress, Silent
from specmap_cli.maps.filenames import TOPOLOGY

_EXCHANGE = 2  # RENAME_EXCHANGE of renameat2


def refuse_inside(output: Path | None, directory: Path) -> None:
    """Refuse an output in a directory that is about to be replaced; None is no output.

    Raises UsageError.
    """
    if output is None:
        return
    place, target = (Path(os.path.realpath(path)) for path in (output, directory))
    if place == target or target in place.parents:
        raise UsageError(
            f"is inside {directory}, which is written anew", "choose another place", where=output
        )


class OutputDirectory:
    """`with OutputDirectory(path) as partial:` write into `partial`; leaving renames it to `path`.

    An exception inside, an interruption included, removes what was written. An existing map is
    replaced only with `overwrite`, and only once its successor is complete; a directory that holds
    anything but a map (one without the file `marker`) is never touched. What a run that was killed
    left beside the target is put right on entering, and noted. Raises UsageError, on entering where
    possible.
    """

    def __init__(
        self,
        path: str | Path,
        overwrite: bool = False,
        progress: Progress | None = None,
        marker: str = TOPOLOGY,
    ) -> None:
        self.path = Path(path)
        self.overwrite = overwrite
        self.marker = marker
        self.progress = progress or Silent()
        self._target = Path(os.path.realpath(path))
        self._partial = sibling(self._target, "partial", os.urandom(4).hex())
        self._parents: list[Path] = []
        self._lock = ExitStack()
        # Runs when this object goes, at the latest at the exit of the interpreter, unless
        # `_clean_up` came to its end: wherever an interruption falls, nothing is left behind.
        self._finalizer = weakref.finalize(self, _remove, self._partial, self._parents)

    def __enter__(self) -> Path:
        try:
            for line in put_right(self._target, self.marker):
                self.progress.note(line)
            self._check_target()
            missing = self._target.parent
            while not missing.exists():
                self._parents.append(missing)
                missing = missing.parent
            for parent in reversed(self._parents):
                parent.mkdir(exist_ok=True)
            self._partial.mkdir()
            self._lock.enter_context(held(self._partial))
        except OSError as error:
            self._clean_up()
            raise UsageError.of_system(
                error,
                f"cannot write there: {self._target.parent}",
                "choose another output directory",
                where=self.path,
                code=OUTPUT,
            ) from None
        return self._partial

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            if kind is None:
                self._commit()
        finally:
            self._clean_up()
        # where the system refused to write what belongs into the directory, and no other file
        if (
            isinstance(error, OSError)
            and is_of_the_place(error)
            and (error.filename is None or str(error.filename).startswith(str(self._partial)))
        ):
            advice = "choose another output directory"
            raise UsageError.of_system(
                error, "cannot be written", advice, where=self.path, code=OUTPUT
            ) from None

    def _clean_up(self) -> None:
        """Take back what entering made; an interruption meanwhile is raised when that is done."""
        try:
            self._lock.close()
            _remove(self._partial, self._parents)
        except BaseException:  # interrupted before the signals were held back
            _remove(self._partial, self._parents)
            raise
        self._finalizer.detach()

    def _check_target(self) -> None:
        """Refuse a target that must not be replaced."""
        refused = functools.partial(UsageError, where=self.path, code=OUTPUT)
        if not self._target.name:
            raise refused("not a place for a map", "choose a directory of its own")
        if not os.path.lexists(self._target):
            return
        if not self._target.is_dir():
            raise refused("is a file", "choose a directory that does not exist yet")
        if os.path.ismount(self._target):
            raise refused("is a mount point", "choose a directory inside it")
        if not any(self._target.iterdir()):
            return
        of_map = self.marker == TOPOLOGY
        if not (self._target / self.marker).is_file():  # we wrote no directory without it
            raise refused(
                f"is not empty and holds no {'map' if of_map else 'earlier result'} "
                f"(no {self.marker} in it)",
                "choose another output directory",
            )
        if not self.overwrite:
            raise refused(
                f"already holds {'a map' if of_map else 'a result'}",
                "use --overwrite to replace it, or another --out",
                code=OUTPUT_EXISTS,
            )

    def _commit(self) -> None:
        """Put the finished directory in place of the target.

        Old away, new in: at once where the system can exchange them, otherwise one by one. The old
        one comes back when the new one cannot take its place.
        """
        replaced = sibling(self._target, "replaced", self._partial.name[-8:])
        try:
            self._check_target()
            with _signals_held():
                present = self._target.exists()
                if present and exchanged(self._partial, self._target):
                    return  # the old one is the partial directory now, and goes with it
                if present:
                    os.rename(self._target, replaced)
                try:
                    os.rename(self._partial, self._target)
                except BaseException:
                    if present:
                        os.rename(replaced, self._target)
                    raise
                if present:  # by that name it may go piece by piece
                    os.rename(replaced, self._partial)
        except OSError as error:
            raise UsageError.of_system(
                error, "cannot put the finished directory in place", where=self.path, code=OUTPUT
            ) from None


def _remove(partial: Path, parents: list[Path]) -> None:
    """Take back what entering made: the partial directory, and its parents while they are empty.

    After the partial directory was renamed there is nothing to take back. It may run twice.
    """
    with _signals_held():
        shutil.rmtree(partial, ignore_errors=True)
        for parent in parents:
            try:
                parent.rmdir()
            except OSError:
                return


@contextmanager
def _signals_held() -> Iterator[None]:
    """Hold SIGINT and SIGTERM back while the few system calls inside run, then deliver them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    received: list[int] = []
    holding = True

    def remember(number: int, _frame: FrameType | None) -> None:
        if holding:
            received.append(number)
        else:
            put_back()
            os.kill(os.getpid(), number)

    def put_back() -> None:
        for number, handler in before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)

    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        for number in before:
            signal.signal(number, remember)
        yield
    finally:
        try:
            holding = False
            put_back()
        except BaseException:  # of a signal that came between
            put_back()
            raise
        finally:
            for pending in received:
                os.kill(os.getpid(), pending)


def exchanged(one: Path, other: Path) -> bool:
    """Whether two directories could change places in one step: Linux has a call for it."""
    try:
        rename = ctypes.CDLL(None, use_errno=True).renameat2
    except (OSError, AttributeError, TypeError):  # another system, or an old C library
        return False
    here = -100  # AT_FDCWD: the paths are as they stand
    return bool(rename(here, os.fsencode(one), here, os.fsencode(other), _EXCHANGE) == 0)


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
            # by that name it may go piece by piece
            os.rename(old, sibling(target, "partial", old.name[-8:]))
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
    name = re.compile(re.escape(f".{target.name}.{role}-") + "[0-9a-f]{8}")
    with suppress(OSError):
        return [
            path
            for path in sorted(target.parent.iterdir())
            if name.fullmatch(path.name) and path.is_dir() and not path.is_symlink()
        ]
    return []
