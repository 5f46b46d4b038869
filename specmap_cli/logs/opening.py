"""Opening recordings by what is in them: the suffix of a file decides nothing."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path

from specmap_cli.core.arguments import Paths, instance_of, paths_of
from specmap_cli.core.errors import LOG_DAMAGED, LogError
from specmap_cli.core.settings import LogConfig
from specmap_cli.logs.log import Log
from specmap_cli.logs.readers.compression import compression_of
from specmap_cli.logs.readers.recording import Recording, unreadable
from specmap_cli.logs.readers.sniffing import head_of, is_directory, is_text
from specmap_cli.logs.readers.table import format_names, known_readers, reader_for
from specmap_cli.logs.readers.unpacking import unpacked

_Readers = Mapping[str, type[Recording]]


def open_log(paths: Paths, config: LogConfig | None = None) -> Log:
    """Open one recording, or several files of it, as one log in time order.

    A path is a file, or a directory whose recordings are taken together. The readers are those of
    `logs.readers.table`; `config` bounds what they unpack. Raises LogError for a path that is
    missing, empty, no recording or given twice, and when nothing in it can be read; TypeError for
    what is no path or no `LogConfig`.
    """
    given = paths_of(paths, "paths")
    settings = LogConfig() if config is None else instance_of(config, LogConfig, "config")
    if not given:
        raise LogError("no log given; name a file or a directory")
    readers = known_readers()
    with ExitStack() as held:
        recordings: list[Recording] = []
        for path in given:
            for file in _files_at(path, readers):
                recordings.append(_opened(file, readers, settings, held))
        _refuse_repetition(recordings)
        _refuse_rubble(recordings)
        return Log(recordings, given, held.pop_all())


def _refuse_repetition(recordings: Sequence[Recording]) -> None:
    """A file given twice, such as by its name and by its directory, would count twice."""
    seen: set[Path] = set()
    for recording in recordings:
        place = recording.path.resolve()
        if place in seen:
            raise LogError(f"{recording.path}: given twice; name each file of a recording once")
        seen.add(place)


def _refuse_rubble(recordings: Sequence[Recording]) -> None:
    """A damaged log of which no message is left cannot be used."""
    messages = sum(recording.contents.messages for recording in recordings)
    damage = [line for recording in recordings for line in recording.damage]
    if damage and not messages:
        raise LogError(f"{damage[0]}; no message can be read", code=LOG_DAMAGED)


def _files_at(path: Path, readers: _Readers) -> Iterator[Path]:
    """The file at a path, or the recordings in a directory by name."""
    if not is_directory(path):
        yield path
        return
    try:
        files = sorted(path.iterdir())
        visible = [file for file in files if file.is_file() and not file.name.startswith(".")]
    except OSError as error:
        raise unreadable(path, error) from None
    found = [file for file in visible if looks_like_a_log(file, readers)]
    if not found:
        expected = format_names(readers.values())
        raise LogError(f"{path}: no recording in this directory; expected {expected}")
    yield from found


def looks_like_a_log(file: Path, readers: _Readers) -> bool:
    """Whether a file begins as a recording, or as a compressed file. Raises LogError."""
    head = head_of(file)
    return compression_of(head) is not None or reader_for(head, file, readers) is not None


def _opened(path: Path, readers: _Readers, config: LogConfig, held: ExitStack) -> Recording:
    """The recording in one file, which `held` closes; a compressed one is unpacked first."""
    compression = compression_of(_head(path, path))
    if compression is None:
        return _read(path, path, readers, config, held)

    inside = f"(inside {compression} compression)"

    def look(file: Path) -> None:
        if compression_of(head_of(file)) is not None:
            raise LogError(f"{path}: compressed twice; unpack it first")
        try:
            _reader_of(file, path, readers)
        except LogError as error:
            raise LogError(f"{error} {inside}", code=error.code) from None

    copy = unpacked(path, compression, config, look, held)
    look(copy.file)
    try:
        recording = _read(copy.file, path, readers, config, held)
    except LogError as error:
        raise LogError(f"{error} {inside}", code=error.code) from None
    if copy.lost is not None:
        recording.report(copy.lost)
    return recording


def _read(
    file: Path, path: Path, readers: _Readers, config: LogConfig, held: ExitStack
) -> Recording:
    recording = _reader_of(file, path, readers)(file, path, config)
    held.callback(recording.close)
    return recording


def _reader_of(file: Path, path: Path, readers: _Readers) -> type[Recording]:
    """The reader of `file`, called `path`; raises LogError saying what it is instead."""
    head = _head(file, path)
    reader = reader_for(head, file, readers)
    if reader is not None:
        return reader
    if any(known.magic.startswith(head) for known in readers.values()):
        raise LogError(
            f"{path}: cut off after {len(head)} bytes; no message can be read", code=LOG_DAMAGED
        )
    kind = "a text file" if b"\x00" not in head and is_text(head) else "of an unknown format"
    expected = format_names(readers.values())
    raise LogError(f"{path}: {kind}, not a recording; expected {expected}")


def _head(file: Path, path: Path) -> bytes:
    head = head_of(file)
    if not head:
        raise LogError(f"{path}: the file is empty", code=LOG_DAMAGED)
    return head
