"""Places of files: paths of this machine, stores that fsspec knows, and temporary directories.

And what a batch leaves in its output: a folder for each job, which is complete or not there, and
beside them the summaries, the index page and the journal of events.
"""

from __future__ import annotations

import errno
import os
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from specmap_cli.batch.records import EXTRA, JOB, MAP, JobRecord
from specmap_cli.core.errors import MACHINE, PACKAGE, SpecmapError, UsageError
from specmap_cli.core.files import continued, held, lock, read_bytes, write_together
from specmap_cli.core.plugins import extra
from specmap_cli.core.text import to_json
from specmap_cli.maps import filenames
from specmap_cli.maps.directory import OutputDirectory

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
    fsspec = extra("fsspec", EXTRA, "needs an extra", url)
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
                with suppress(OSError), held(left) as nobody_s:
                    if nobody_s:
                        shutil.rmtree(left, ignore_errors=True)
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


_JOURNAL = "events.jsonl"
_EDITS = f"{MAP}/{filenames.EDITS}"
_MOST_MB = 16.0  # of a job.json: some hundred thousand files
# Without directories: to make one could only make a whole bucket.
_FLAT = {"s3", "s3a", "gs", "gcs", "abfs", "abfss", "az", "oss", "memory"}
_BEGUN = "job.begun"  # lies in a folder of a store while it is written


class Folder:
    """Where the result of one job is kept: a directory here, or a folder of a store."""

    def __init__(self, place: str) -> None:
        self.place = place

    def stored(self) -> JobRecord | None:
        """The record of a complete result, None when there is none.

        Complete: all files are there as it says; those of a map that was edited since may differ.
        """
        record, sizes, edited = self._found()
        if record is None:
            return None
        complete = all(
            sizes.get(name) == size or (edited and name in sizes and name.startswith(f"{MAP}/"))
            for name, size in record.files.items()
        )
        return record if complete else None

    def edited(self) -> str | None:
        """Where a person's decisions about the map lie that are not of the job; None for none."""
        return f"{self.place}/{_EDITS}" if self._found()[2] else None

    @contextmanager
    def fresh(self, scratch: Path) -> Iterator[Path]:
        """A directory to write a new result into; it takes its place when the block ends well.

        Raises UsageError when something else lies there, PlaceError for a store out of reach.
        """
        del scratch  # a hidden sibling is renamed, which needs the same file system
        with OutputDirectory(
            self.place, overwrite=True, marker=JOB, ours=lambda _: True
        ) as directory:
            yield directory

    def _read(self) -> tuple[bytes, Mapping[str, int]] | None:
        """What job.json holds, and the files beside it in bytes; None where there is none."""
        path = Path(self.place)
        try:
            return read_bytes(path / JOB, _MOST_MB), files_in(path)
        except OSError:
            return None

    def _found(self) -> tuple[JobRecord | None, Mapping[str, int], bool]:
        """The record there, the files beside it in bytes, and whether a person edited the map."""
        found = self._read()
        if found is None:
            return None, {}, False
        text, sizes = found
        try:
            record = JobRecord.model_validate_json(text)
        except ValidationError:
            return None, {}, False
        return record, sizes, _EDITS in sizes and sizes[_EDITS] != record.files.get(_EDITS)


def folder_at(output: str, name: str) -> Folder:
    """The folder of the job `name` in an output directory, a path or a URL."""
    path = path_at(output)
    return _InStore(f"{output.rstrip('/')}/{name}") if path is None else Folder(str(path / name))


def files_in(directory: Path) -> dict[str, int]:
    """The files below a directory and their bytes; without job.json."""
    found = {
        path.relative_to(directory).as_posix(): path.stat().st_size
        for path in sorted(directory.rglob("*"))
        if path.is_file()
    }
    found.pop(JOB, None)
    return found


def write_record(directory: Path, record: JobRecord) -> None:
    """Write job.json."""
    (directory / JOB).write_text(to_json(record.model_dump()), encoding="utf-8")


class _InStore(Folder):
    """A folder in a store, where nothing can be renamed: job.json goes first and comes last."""

    def __init__(self, url: str) -> None:
        super().__init__(url)
        self._system, self._root = store_at(url)

    def _read(self) -> tuple[bytes, Mapping[str, int]] | None:
        sizes = self._sizes()
        if JOB not in sizes or sizes[JOB] > _MOST_MB * 1e6:
            return None
        with reaching(self.place):
            return self._system.cat_file(self._at(JOB)), sizes

    @contextmanager
    def fresh(self, scratch: Path) -> Iterator[Path]:
        """A directory in the scratch, copied to the store when it is complete."""
        present = self._sizes()
        if present and not {JOB, _BEGUN} & set(present):
            raise UsageError(
                f"is not empty and holds no earlier result (no {JOB} in it)",
                "choose another output directory",
                where=self.place,
            )
        directory = scratch / "result"
        directory.mkdir()
        yield directory
        # whenever this is cut off, there is no job.json or a complete result
        with reaching(self.place):
            system: Any = self._system
            present = self._sizes()
            spoken = system.protocol
            if _FLAT.isdisjoint([spoken] if isinstance(spoken, str) else spoken):
                folders = {self._at(name).rsplit("/", 1)[0] for name in files_in(directory)}
                for folder in sorted({self._root, *folders}):
                    system.makedirs(folder, exist_ok=True)
            system.pipe_file(self._at(_BEGUN), b"")
            if JOB in present:
                system.rm_file(self._at(JOB))
            for name in sorted(set(present) - {JOB, _BEGUN}):
                system.rm_file(self._at(name))
            for name in [*files_in(directory), JOB]:
                system.put_file(str(directory / name), self._at(name))
            system.rm_file(self._at(_BEGUN))

    def _sizes(self) -> dict[str, int]:
        """The files in the folder and their bytes."""
        with reaching(self.place):
            self._system.invalidate_cache()
            try:
                found = self._system.find(self._root, detail=True)
            except FileNotFoundError:
                return {}
        return {
            path.removeprefix(self._root).lstrip("/"): info["size"] for path, info in found.items()
        }

    def _at(self, name: str) -> str:
        return f"{self._root.rstrip('/')}/{name}"


def write_files(output: str, contents: Mapping[str, bytes]) -> None:
    """Write files beside the folders of the jobs anew, each complete or not at all.

    Raises UsageError or PlaceError where they cannot be written.
    """
    directory = path_at(output)
    if directory is not None:
        write_together({directory / name: data for name, data in contents.items()})
        return
    system, root = store_at(output)
    for name, data in contents.items():
        with reaching(output):
            system.pipe_file(f"{root}/{name}", data)


@contextmanager
def taken(output: str) -> Iterator[Callable[[str], object]]:
    """The output of a batch made ready, nobody else's while the block lasts; what keeps a line.

    The lines are those of the journal of events. A directory of this machine is made where there is
    none, and held by a lock of its journal. A store has no locks; there the journal is written when
    the block ends. Raises UsageError for a directory that another batch holds or that cannot be
    made.
    """
    directory = path_at(output)
    if directory is None:
        lines: list[str] = []
        system, root = store_at(output)
        journal = f"{root}/{_JOURNAL}"
        with reaching(output):
            before = system.cat_file(journal) if system.exists(journal) else b""
            system.pipe_file(journal, before)  # whether it lets us write is told before any job
        try:
            yield lines.append
        finally:
            with reaching(output):
                system.pipe_file(journal, before + "".join(lines).encode())
        return
    try:
        directory.mkdir(parents=True, exist_ok=True)
        file = continued(directory / _JOURNAL)
    except OSError as error:
        where, advice = error.filename or directory, "choose another place"
        raise UsageError.of_system(error, "cannot be written", advice, where=where) from None
    with file:
        if lock(file.fileno()) is not True:
            raise UsageError(
                "another batch is writing there",
                "wait for it, or choose another directory",
                where=directory,
            )
        yield file.write
