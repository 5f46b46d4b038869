"""Opening recordings by what is in them: the suffix of a file decides nothing."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

from specmap_cli.core.errors import LogError
from specmap_cli.logs.readers import carmen, mcap, rosbag1, rosbag2
from specmap_cli.logs.readers.compression import compression_of, stream
from specmap_cli.logs.readers.recording import Log, Recording, unreadable

_HEAD_BYTES = 4096
_CARMEN_SEARCH_BYTES = 1 << 22  # comments and PARAM lines may come first
_COPY_BYTES = 1 << 20

_FORMATS: dict[bytes, Callable[[Path], Recording]] = {
    mcap.MAGIC: mcap.McapFile,
    rosbag1.MAGIC: rosbag1.Rosbag1File,
    rosbag2.MAGIC: rosbag2.Rosbag2File,
}
_KNOWN = "MCAP, rosbag2, ROS 1 bag or CARMEN log"


def open_log(paths: Path | str | Sequence[Path | str]) -> Log:
    """Open one recording, or several files of it, as one log in time order.

    A path is a file, or a directory whose recordings are taken together. Raises LogError for a
    path that is missing, empty, no recording or given twice, and when nothing in it can be read.
    """
    given = [paths] if isinstance(paths, str | Path) else list(paths)
    if not given:
        raise LogError("no log given; name a file or a directory")
    recordings: list[Recording] = []
    try:
        for path in given:
            recordings.extend(_recordings_at(Path(path)))
        _refuse_repetition(recordings)
        log = Log(recordings, [Path(path) for path in given])
        _refuse_rubble(log)
    except BaseException:
        for recording in recordings:
            recording.close()
        raise
    return log


def _refuse_repetition(recordings: Sequence[Recording]) -> None:
    """A file given twice, such as by its name and by its directory, would count twice."""
    seen: set[Path] = set()
    for recording in recordings:
        place = recording.path.resolve()
        if place in seen:
            raise LogError(f"{recording.path}: given twice; name each file of a recording once")
        seen.add(place)


def _refuse_rubble(log: Log) -> None:
    """A damaged log of which no message is left cannot be used."""
    if log.damage and not log.contents.messages:
        raise LogError(f"{log.damage[0]}; no message can be read")


def _recordings_at(path: Path) -> Iterator[Recording]:
    if not path.is_dir():
        yield _open_file(path)
        return
    found = False
    for file in sorted(path.iterdir()):
        if file.is_file() and not file.name.startswith(".") and _looks_like_a_log(file):
            found = True
            yield _open_file(file)
    if not found:
        raise LogError(f"{path}: no recording in this directory; expected {_KNOWN}")


def _looks_like_a_log(file: Path) -> bool:
    head = _head(file)
    return _format_of(head) is not None or compression_of(head) is not None or _is_carmen(file)


def _open_file(path: Path) -> Recording:
    """The recording in one file; raises LogError saying what it is instead."""
    head = _head(path)
    if not head:
        raise LogError(f"{path}: the file is empty")
    if compression_of(head) is not None:
        return _open_compressed(path)
    reader = _format_of(head)
    if reader is not None:
        return reader(path)
    if _is_carmen(path):
        return carmen.CarmenFile(path)
    if any(magic.startswith(head) for magic in _FORMATS):
        raise LogError(f"{path}: cut off after {len(head)} bytes; no message can be read")
    kind = "a text file" if b"\x00" not in head and _is_text(head) else "of an unknown format"
    raise LogError(f"{path}: {kind}, not a recording; expected {_KNOWN}")


def _open_compressed(path: Path) -> Recording:
    """The recording inside a compressed file, unpacked into a temporary one."""
    name = compression_of(_head(path)) or ""
    with tempfile.NamedTemporaryFile(prefix="specmap-", suffix=path.stem) as unpacked:
        complete = False
        for part, complete in stream(_slices(path), name):  # noqa: B007 (the last one counts)
            unpacked.write(part)
        unpacked.flush()
        if compression_of(_head(Path(unpacked.name))) is not None:
            raise LogError(f"{path}: compressed twice; unpack it first")
        try:
            recording = _open_file(Path(unpacked.name))  # stays readable once unlinked
        except LogError as error:
            reason = str(error).removeprefix(f"{unpacked.name}: ")
            raise LogError(f"{path}: {reason} (inside {name} compression)") from None
        recording.path = path
        if not complete:
            recording.report(f"the {name} compression ends early: the rest is lost")
        return recording


def _slices(path: Path) -> Iterable[bytes]:
    with path.open("rb") as file:
        while piece := file.read(_COPY_BYTES):
            yield piece


def _head(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(_HEAD_BYTES)
    except FileNotFoundError:
        raise LogError(f"{path}: no such file or directory") from None
    except OSError as error:
        raise unreadable(path, error) from None


def _format_of(head: bytes) -> Callable[[Path], Recording] | None:
    return next((reader for magic, reader in _FORMATS.items() if head.startswith(magic)), None)


def _is_text(head: bytes) -> bool:
    try:
        head.decode("utf-8")
    except UnicodeDecodeError as error:
        return error.start > len(head) - 4  # a character cut in two by the end of the piece
    return True


def _is_carmen(path: Path) -> bool:
    """Whether one of the first lines is CARMEN's."""
    if not _is_text(_head(path)):
        return False
    searched = 0
    with path.open("rb") as file:
        for line in iter(lambda: file.readline(_COPY_BYTES), b""):
            searched += len(line)
            if line.split(b" ", 1)[0] in [word.encode() for word in carmen.KEYWORDS]:
                return True
            if searched > _CARMEN_SEARCH_BYTES:
                return False
    return False
