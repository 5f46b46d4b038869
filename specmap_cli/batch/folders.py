"""The folder of a job in the output: complete or not there, on this machine and in a store."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from pydantic import ValidationError

from specmap_cli.batch.places import path_at, reaching, store_at
from specmap_cli.batch.records import JobRecord
from specmap_cli.batch.steps import JOB, MAP
from specmap_cli.core.errors import UsageError
from specmap_cli.core.files import read_bytes
from specmap_cli.core.text import to_json
from specmap_cli.maps import filenames
from specmap_cli.maps.directory import OutputDirectory

EDITS = f"{MAP}/{filenames.EDITS}"
_MOST_MB = 16.0  # of a job.json: some hundred thousand files
_FLAT = {"s3", "s3a", "gs", "gcs", "abfs", "abfss", "az", "oss", "memory"}  # without directories
_BEGUN = "job.begun"  # lies in a folder of a store while it is written


class Folder(Protocol):
    """Where the result of one job is kept."""

    def stored(self) -> JobRecord | None:
        """The record of a complete result, None when there is none."""

    def edited(self) -> str | None:
        """Where a person's decisions about the map lie that are not of the job; None for none."""

    def fresh(self, scratch: Path) -> AbstractContextManager[Path]:
        """A directory to write a new result into; it takes its place when the block ends well.

        Raises UsageError when something else lies there, PlaceError for a store out of reach.
        """


def folder_at(output: str, name: str) -> Folder:
    """The folder of the job `name` in an output directory, a path or a URL."""
    path = path_at(output)
    if path is not None:
        return _Here(path, name)
    return _InStore(f"{output.rstrip('/')}/{name}")


def write_record(directory: Path, record: JobRecord) -> None:
    """Write job.json."""
    (directory / JOB).write_text(to_json(record.model_dump()), encoding="utf-8")


def files_in(directory: Path) -> dict[str, int]:
    """The files below a directory and their bytes; without job.json."""
    found = {
        path.relative_to(directory).as_posix(): path.stat().st_size
        for path in sorted(directory.rglob("*"))
        if path.is_file()
    }
    found.pop(JOB, None)
    return found


@dataclass(frozen=True, slots=True)
class _Found:
    """A `job.json` and the bytes of the files beside it."""

    record: JobRecord
    sizes: Mapping[str, int]

    @classmethod
    def of(cls, data: bytes, sizes: Mapping[str, int]) -> _Found | None:
        """None for what is no record."""
        try:
            return cls(JobRecord.model_validate_json(data), sizes)
        except ValidationError:
            return None

    @property
    def edited(self) -> bool:
        """Whether a person decided about the map since the job made it: `specmap edit`."""
        return EDITS in self.sizes and self.sizes[EDITS] != self.record.files.get(EDITS)

    @property
    def complete(self) -> bool:
        """Whether all files are there as the record says; those of an edited map may differ."""
        return all(
            self.sizes.get(name) == size
            or (self.edited and name in self.sizes and name.startswith(f"{MAP}/"))
            for name, size in self.record.files.items()
        )


class _Here:
    """A folder on this machine: a hidden sibling is renamed when it is complete."""

    def __init__(self, output: Path, name: str) -> None:
        self._path = output / name

    def stored(self) -> JobRecord | None:
        """The record of a complete result."""
        found = self._found()
        return found.record if found is not None and found.complete else None

    def edited(self) -> str | None:
        """The path of edits.toml."""
        found = self._found()
        return str(self._path / EDITS) if found is not None and found.edited else None

    def _found(self) -> _Found | None:
        try:
            return _Found.of(read_bytes(self._path / JOB, _MOST_MB), files_in(self._path))
        except OSError:
            return None

    @contextmanager
    def fresh(self, scratch: Path) -> Iterator[Path]:
        """A new result beside the old one, which goes when it is complete."""
        del scratch  # a rename needs the same file system
        with OutputDirectory(self._path, overwrite=True, marker=JOB) as directory:
            yield directory


class _InStore:
    """A folder in a store, where nothing can be renamed: job.json goes first and comes last."""

    def __init__(self, url: str) -> None:
        self._url = url
        self._system, self._root = store_at(url)

    def stored(self) -> JobRecord | None:
        """The record of a complete result."""
        found = self._found()
        return found.record if found is not None and found.complete else None

    def edited(self) -> str | None:
        """The URL of edits.toml."""
        found = self._found()
        return f"{self._url}/{EDITS}" if found is not None and found.edited else None

    def _found(self) -> _Found | None:
        sizes = self._sizes()
        if JOB not in sizes or sizes[JOB] > _MOST_MB * 1e6:
            return None
        with reaching(self._url):
            return _Found.of(self._system.cat_file(self._at(JOB)), sizes)

    @contextmanager
    def fresh(self, scratch: Path) -> Iterator[Path]:
        """A directory in the scratch, copied to the store when it is complete."""
        present = self._sizes()
        if present and not {JOB, _BEGUN} & set(present):
            raise UsageError(
                f"{self._url}: is not empty and holds no earlier result (no {JOB} in it): "
                "choose another output directory"
            )
        directory = scratch / "result"
        directory.mkdir()
        yield directory
        with reaching(self._url):
            self._replace(directory)

    def _replace(self, directory: Path) -> None:
        """Old away, new in; whenever this is cut off, there is no job.json or a complete result."""
        system: Any = self._system
        present = self._sizes()
        self._make(self._root)
        system.pipe_file(self._at(_BEGUN), b"")
        if JOB in present:
            system.rm_file(self._at(JOB))
        for name in sorted(set(present) - {JOB, _BEGUN}):
            system.rm_file(self._at(name))
        made = {self._root}
        for name in [*files_in(directory), JOB]:
            parent = self._at(name).rsplit("/", 1)[0]
            if parent not in made:
                self._make(parent)
                made.add(parent)
            system.put_file(str(directory / name), self._at(name))
        system.rm_file(self._at(_BEGUN))

    def _make(self, directory: str) -> None:
        """Make a directory where files need one; elsewhere it could only make a whole bucket."""
        spoken = self._system.protocol
        if _FLAT.isdisjoint([spoken] if isinstance(spoken, str) else spoken):
            self._system.makedirs(directory, exist_ok=True)

    def _sizes(self) -> dict[str, int]:
        """The files in the folder and their bytes."""
        with reaching(self._url):
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
