"""An output directory that appears complete or not at all.

Everything is written to a hidden sibling of the target, which is renamed into place at the end.
The sibling is made on entering, before the long work, so that a target that cannot be written is
told at once and not after an hour.

A run holds a lock on its sibling, and on the directory that it will replace: another run that would
replace it, too, is refused, and what changes there by other hands meanwhile is never lost. The
system lets go of a lock when the run ends, however it ends: a sibling without one belongs to nobody
any more, and the next run puts it right.
"""

from __future__ import annotations

import ctypes
import os
import re
import shutil
import signal
import threading
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from types import FrameType, TracebackType
from typing import TYPE_CHECKING

from specmap_cli.core.errors import OUTPUT, OUTPUT_EXISTS, UsageError, is_of_the_place
from specmap_cli.core.files import held, holder_of, is_nobody_s, lock, to_disk
from specmap_cli.core.progress import Progress, Silent
from specmap_cli.maps.filenames import EDITS, TOPOLOGY, is_of_a_map

if TYPE_CHECKING:  # slow to load
    from specmap_cli.maps.store import Map

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
    anything but a map (one without the file `marker` as we write it) is never touched, and what is
    not `ours` in one, by its path inside, goes on to the successor. It is made of the maps
    `made_of`: no other's edits.toml is replaced, and none of them may change meanwhile. What a run
    that was killed left beside the target is put right on entering, and noted. Raises UsageError,
    on entering where possible, and MapError for a map that changed.
    """

    def __init__(
        self,
        path: str | Path,
        overwrite: bool = False,
        progress: Progress | None = None,
        *,
        marker: str = TOPOLOGY,
        ours: Callable[[str], bool] = is_of_a_map,
        made_of: Sequence[Map] = (),
    ) -> None:
        self.path = Path(path)
        self.overwrite = overwrite
        self.marker = marker
        self._ours = ours
        self._made_of = made_of
        self._found: Mapping[str, tuple[int, ...]] = {}
        self.progress = progress or Silent()
        self._target = Path(os.path.realpath(path))
        self._partial = sibling(self._target, "partial", os.urandom(4).hex())
        self._parents: list[Path] = []
        self._lock = ExitStack()
        # Runs when this object goes, at the latest at the exit of the interpreter, unless
        # `_clean_up` came to its end: wherever an interruption falls, nothing is left behind.
        self._finalizer = weakref.finalize(self, _remove, self._partial, self._parents, self._lock)

    def __enter__(self) -> Path:
        try:
            for line in put_right(self._target, self.marker):
                self.progress.note(line)
            self._hold_target()
            self._check_target()
            self._found = _contents(self._target)
            missing = self._target.parent
            while not missing.exists():
                self._parents.append(missing)
                missing = missing.parent
            for parent in reversed(self._parents):
                parent.mkdir(exist_ok=True)
            self._partial.mkdir()
            self._lock.enter_context(held(self._partial))
        except BaseException as error:
            self._clean_up()
            if not isinstance(error, OSError):
                raise
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
        inside = isinstance(error, UsageError) and str(error.where).startswith(str(self._partial))
        refused = error.__context__ if error is not None and inside else error
        if (
            isinstance(refused, OSError)
            and is_of_the_place(refused)
            and (refused.filename is None or str(refused.filename).startswith(str(self._partial)))
        ):
            advice = "choose another output directory"
            raise UsageError.of_system(
                refused, "cannot be written", advice, where=self.path, code=OUTPUT
            ) from None

    def _clean_up(self) -> None:
        """Take back what entering made; an interruption meanwhile is raised when that is done."""
        try:
            _remove(self._partial, self._parents, self._lock)
        except BaseException:  # interrupted before the signals were held back
            _remove(self._partial, self._parents, self._lock)
            raise
        self._finalizer.detach()

    def _hold_target(self) -> None:
        """Lock the target, where it is there and the system has locks."""
        while self._target.is_dir():
            with _signals_held():  # no interruption loses it
                descriptor = os.open(self._target, os.O_RDONLY)
                self._lock.callback(os.close, descriptor)
            if lock(descriptor) is False:
                who = holder_of(descriptor)
                raise self._refused(f"{who} is about to replace it", "wait until that has ended")
            if os.path.samestat(os.fstat(descriptor), self._target.stat()):
                return  # else it was replaced just now

    def _check_target(self) -> None:
        """Refuse a target that must not be replaced."""
        refused = self._refused
        for map_ in self._made_of:
            map_.refuse_changed()
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
        marker = self._target / self.marker
        # we wrote no directory without it, and no map without its version
        if not marker.is_file() or (of_map and b'"schema_version"' not in marker.read_bytes()):
            raise refused(
                f"is not empty and holds no {'map' if of_map else 'earlier result'} "
                f"(no {self.marker}{' of specmap' * marker.is_file()} in it)",
                "choose another output directory",
            )
        if not self.overwrite:
            raise refused(
                f"already holds {'a map' if of_map else 'a result'}",
                "use --overwrite to replace it, or another --out",
                code=OUTPUT_EXISTS,
            )
        if of_map:
            self._refuse_losing_edits()

    def _refuse_losing_edits(self) -> None:
        """Refuse to replace what a person decided by a map that does not say it, too."""
        old, new = self._target / EDITS, self._partial / EDITS
        of_it = any(os.path.realpath(map_.path) == str(self._target) for map_ in self._made_of)
        if of_it or not old.exists():
            return
        finished = (self._partial / self.marker).exists()
        if self._made_of and not finished:  # what the new one says is known when it is finished
            return
        if not new.exists() or new.read_bytes() != old.read_bytes():
            keep = "" if self._made_of else f"`build --like {self.path}` keeps them; or "
            raise UsageError(
                f"its {EDITS} holds a person's decisions, which a new map would lose",
                f"{keep}choose another --out, or move the file away",
                where=self.path,
            )

    def _refused(self, found: str, hint: str, code: str = OUTPUT) -> UsageError:
        return UsageError(found, hint, where=self.path, code=code)

    def _commit(self) -> None:
        """Put the finished directory in place of the target.

        Old away, new in: at once where the system can exchange them, otherwise one by one. The old
        one comes back when the new one cannot take its place.
        """
        replaced = sibling(self._target, "replaced", self._partial.name[-8:])
        try:
            self._check_target()
            for name in self._found:
                if not self._ours(name):
                    _keep(self._target / name, self._partial / name)
            with _signals_held():
                to_disk(self._partial, *self._partial.rglob("*"))
                if changed := self._found.items() ^ _contents(self._target).items():
                    names = ", ".join(sorted({name for name, _ in changed})[:3])
                    raise self._refused(f"was changed meanwhile: {names}", "run the command again")
                present = self._target.exists()
                if present and exchanged(self._partial, self._target):
                    to_disk(self._target.parent)
                    return  # the old one is the partial directory now, and goes with it
                if present:
                    os.rename(self._target, replaced)
                try:
                    os.rename(self._partial, self._target)
                except BaseException:
                    if present:
                        os.rename(replaced, self._target)
                    raise
                to_disk(self._target.parent)
                if present:  # by that name it may go piece by piece
                    os.rename(replaced, self._partial)
        except OSError as error:
            raise UsageError.of_system(
                error, "cannot put the finished directory in place", where=self.path, code=OUTPUT
            ) from None


def result_directory(
    out: str | Path, names: Sequence[str], overwrite: bool = False, progress: Progress | None = None
) -> OutputDirectory:
    """The directory `out` for files of those `names`, of which the first is always written.

    Entered before the work, it refuses what is in the way. Raises UsageError on entering.
    """
    ours = frozenset(names).__contains__
    return OutputDirectory(out, overwrite, progress, marker=names[0], ours=ours)


def _contents(directory: Path) -> dict[str, tuple[int, ...]]:
    """What a directory holds, by the path inside, and what changes when somebody writes it."""
    found: dict[str, tuple[int, ...]] = {}
    for path in directory.rglob("*"):
        about = path.lstat()
        of_file = () if path.is_dir() else (about.st_ino, about.st_size, about.st_mtime_ns)
        found[path.relative_to(directory).as_posix()] = of_file
    return found


def _keep(source: Path, target: Path) -> None:
    """Give a file, or an empty directory, another name, too: whenever a run ends, one is left."""
    if source.is_dir() and not source.is_symlink():
        target.mkdir(parents=True, exist_ok=True)
        return
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.link(source, target, follow_symlinks=False)
    except FileExistsError:  # the successor has one of that name
        return
    except OSError:  # a file system without such names
        shutil.copy2(source, target, follow_symlinks=False)


def _remove(partial: Path, parents: list[Path], locks: ExitStack) -> None:
    """Take back what entering made and is still there: partial directory, empty parents, locks."""
    with _signals_held():
        shutil.rmtree(partial, ignore_errors=True)
        with suppress(OSError):
            for parent in parents:
                parent.rmdir()
        locks.close()


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


def _ours(target: Path, role: str) -> list[Path]:
    """The siblings of the target whose names only OutputDirectory gives, and that are ours."""
    name = re.compile(re.escape(f".{target.name}.{role}-") + "[0-9a-f]{8}")
    with suppress(OSError):
        return [
            path
            for path in sorted(target.parent.iterdir())
            if name.fullmatch(path.name) and path.is_dir() and not path.is_symlink()
            if path.stat().st_uid == os.geteuid()  # not what a neighbour put there
        ]
    return []
