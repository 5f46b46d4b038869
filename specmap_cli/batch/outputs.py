"""What a batch writes beside the folders of its jobs: summaries, index, the journal of events."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol, TextIO

from specmap_cli.batch.events import EventRecord
from specmap_cli.batch.index import as_html
from specmap_cli.batch.ledger import Ledger
from specmap_cli.batch.places import path_at, reaching, store_at
from specmap_cli.batch.tables import as_csv, as_junit, as_markdown, as_parquet
from specmap_cli.core.errors import UsageError, reason
from specmap_cli.core.files import lock, write_together

SUMMARIES = {
    "summary.csv": as_csv,
    "summary.parquet": as_parquet,
    "summary.md": as_markdown,
    "junit.xml": as_junit,
}
INDEX, JOURNAL, LOCK = "index.html", "events.jsonl", ".specmap-batch.lock"


class Journal(Protocol):
    """Keeps the events of a batch."""

    def write(self, event: EventRecord) -> None:
        """Keep one more."""


def write_summaries(output: str, ledger: Ledger) -> None:
    """Write all summaries anew, each complete or not at all.

    Raises UsageError or PlaceError where they cannot be written.
    """
    rows = ledger.rows()
    contents = {name: made(rows) for name, made in SUMMARIES.items()}
    contents[INDEX] = as_html(rows, ledger.results)
    directory = path_at(output)
    if directory is not None:
        write_together({directory / name: data for name, data in contents.items()})
        return
    system, root = store_at(output)
    for name, data in contents.items():
        with reaching(output):
            system.pipe_file(f"{root}/{name}", data)


@contextmanager
def taken(output: str) -> Iterator[Journal]:
    """The output of a batch made ready, and its journal; nobody else's while the block lasts.

    A directory of this machine is made where there is none, and held by a lock. A store has no
    locks; there the journal is written when the block ends. Raises UsageError for a directory that
    another batch holds or that cannot be made.
    """
    directory = path_at(output)
    if directory is None:
        with _in_store(output) as journal:
            yield journal
        return
    try:
        directory.mkdir(parents=True, exist_ok=True)
        holder = os.open(directory / LOCK, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as error:
        why = reason(error, "choose another place")
        raise UsageError(f"{directory}: cannot be written: {why}") from None
    try:
        if not lock(holder):
            raise UsageError(
                f"{directory}: another batch is writing there: wait for it, or choose another "
                "directory"
            )
        with (directory / JOURNAL).open("a", encoding="utf-8") as file:
            yield _Appended(file)
    finally:
        os.close(holder)


class _Appended:
    """A journal in a file; each line is there as soon as it is written."""

    def __init__(self, file: TextIO) -> None:
        self._file = file

    def write(self, event: EventRecord) -> None:
        """Append a line."""
        self._file.write(event.line())
        self._file.flush()


class _Gathered:
    """A journal in memory."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def write(self, event: EventRecord) -> None:
        """Keep a line."""
        self.lines.append(event.line())


@contextmanager
def _in_store(output: str) -> Iterator[Journal]:
    """A journal that goes to a store at the end, after the lines that are there.

    It is written once before: whether the store lets us write is told before any job is done.
    """
    journal, (system, root) = _Gathered(), store_at(output)
    place = f"{root}/{JOURNAL}"
    with reaching(output):
        before = system.cat_file(place) if system.exists(place) else b""
        system.pipe_file(place, before)
    try:
        yield journal
    finally:
        with reaching(output):
            system.pipe_file(place, before + "".join(journal.lines).encode())
