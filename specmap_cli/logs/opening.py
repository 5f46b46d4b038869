"""Opening recordings by what is in them: the suffix of a file decides nothing.

The readers are the built-in ones, and those that installed packages add. The recordings of one or
several files are one `Log`, joined in time.
"""

from __future__ import annotations

import re
import stat
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from functools import cached_property, partial
from pathlib import Path
from types import MappingProxyType

from specmap_cli.core.errors import (
    LOG_DAMAGED,
    LOG_MISSING,
    PACKAGE,
    LogError,
    Paths,
    UsageError,
    instance_of,
    paths_of,
)
from specmap_cli.core.plugins import with_plugins
from specmap_cli.core.settings import LogConfig
from specmap_cli.core.text import counted, legible
from specmap_cli.logs.readers.carmen import CarmenFile
from specmap_cli.logs.readers.compression import compression_of, unpacked
from specmap_cli.logs.readers.mcap import McapFile
from specmap_cli.logs.readers.recording import (
    MAX_DAMAGE_LINES,
    Contents,
    Message,
    Recording,
    TopicInfo,
    contents_of,
    is_text,
    merge_in_time,
    refused,
    unreadable,
)
from specmap_cli.logs.readers.rosbag1 import Rosbag1File
from specmap_cli.logs.readers.rosbag2 import Rosbag2File, recorded_files

GROUP = "specmap.readers"
BUILT_IN: Mapping[str, type[Recording]] = MappingProxyType(
    {"mcap": McapFile, "rosbag2": Rosbag2File, "rosbag1": Rosbag1File, "carmen": CarmenFile}
)


def known_readers() -> dict[str, type[Recording]]:
    """The readers by name, those of other packages first, as they are asked first.

    So a package can read a dialect of a format that a built-in reader would take. Raises
    UsageError for an entry point that cannot be loaded or that is no whole `Recording`.
    """
    table = with_plugins(GROUP, BUILT_IN)
    added = {name: _checked(name, table[name]) for name in table if name not in BUILT_IN}
    return {**added, **BUILT_IN}


def _checked(name: str, reader: object) -> type[Recording]:
    """What an entry point names, if it is a reader; raises UsageError saying what it lacks."""
    fault = "is no class derived from specmap_cli.logs.readers.Recording"
    if isinstance(reader, type) and issubclass(reader, Recording):
        missing = sorted(reader.__abstractmethods__)
        if not isinstance(getattr(reader, "format", None), str):
            missing.append("format")
        own_sniff = any("sniff" in vars(base) for base in reader.__mro__ if base is not Recording)
        if not reader.magic and not own_sniff:
            missing.append("magic or sniff")
        if not missing:
            return reader
        fault = f"lacks {', '.join(missing)}"
    found = f"the reader {name!r} of {GROUP} {fault}"
    raise UsageError(found, "mend or remove its package", mark=";", code=PACKAGE)


HEAD_BYTES = 4096  # one page: longer than the magic of any format, short enough to read of any file
_KINDS = (
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


def head_of(path: Path) -> bytes:
    """The first bytes of a file; raises LogError when there is none or it cannot be read."""
    try:
        with path.open("rb") as file:
            return file.read(HEAD_BYTES)
    except OSError as error:
        raise unreadable(path, error) from None


_Readers = Mapping[str, type[Recording]]


def open_log(paths: Paths, config: LogConfig | None = None) -> Log:
    """Open one recording, or several files of it, as one log in time order.

    A path is a file, or a directory whose recordings are taken together. The readers are those of
    `known_readers`; `config` bounds what they unpack. Raises LogError for a path that is missing,
    empty, no recording or given twice, and when nothing in it can be read; TypeError for what is
    no path or no `LogConfig`.
    """
    given = paths_of(paths, "paths")
    settings = LogConfig() if config is None else instance_of(config, LogConfig, "config")
    if not given:
        raise LogError("no log given", "name a file or a directory", mark=";")
    readers = known_readers()
    with ExitStack() as held:
        files = (file for path in given for file in _files_at(path, readers))
        recordings = [_opened(file, readers, settings, held) for file in files]
        seen: set[Path] = set()
        for recording in recordings:
            place = recording.path.resolve()
            if place in seen:  # such as by its name and by its directory: it would count twice
                hint = "name each file of a recording once"
                raise refused(recording.path, "given twice", hint)
            seen.add(place)
        messages = sum(recording.contents.messages for recording in recordings)
        damaged = next((recording for recording in recordings if recording.damage), None)
        if damaged is not None and not messages:
            where = legible(str(damaged.path))
            found = damaged.damage[0].removeprefix(f"{where}: ")
            raise LogError(f"{found}; no message can be read", where=where, code=LOG_DAMAGED)
        folders = (path for path in given if path.is_dir())
        lost = [line for folder in folders for line in _not_read(folder, recordings)]
        return Log(recordings, given, held.pop_all(), lost)


def _files_at(path: Path, readers: _Readers) -> Iterator[Path]:
    """The file at a path, or the recordings in a directory by name; LogError for other things."""
    try:
        mode = path.stat().st_mode
    except OSError as error:
        raise unreadable(path, error) from None
    except ValueError:  # a zero byte, which no name has
        raise refused(path, "no such file or directory", code=LOG_MISSING) from None
    if stat.S_ISREG(mode):
        yield path
        return
    if not stat.S_ISDIR(mode):
        kind = next((name for is_kind, name in _KINDS if is_kind(mode)), "no file")
        other = f"is {kind}; a log must be a file or a directory"
        raise LogError(other, "copy it to one", where=path)
    try:
        files = sorted(path.iterdir())
        visible = [file for file in files if file.is_file() and not file.name.startswith(".")]
    except OSError as error:
        raise unreadable(path, error) from None
    found = [file for file in visible if looks_like_a_log(file, readers)]
    if not found:
        raise refused(path, "no recording in this directory", _expected(readers))
    yield from found


# the name of a file that was compressed after the recording
_PACKED = re.compile(r"\.(zstd?|gz|bz2|lz4)$")


def _not_read(folder: Path, recordings: Sequence[Recording]) -> Iterator[str]:
    """A line for each file that the metadata names and that is neither read nor renamed."""
    recorded = {_PACKED.sub("", name): told for name, told in recorded_files(folder).items()}
    read = {_PACKED.sub("", one.path.name): one for one in recordings}
    here = {name: one for name, one in read.items() if one.path.parent == folder}
    others = [one.contents.messages for name, one in here.items() if name not in recorded]
    lost: list[str] = []
    for name, messages in recorded.items():
        if name in read or messages == 0:
            continue
        if messages in others:
            others.remove(messages)
            continue
        unless = "unless it was renamed, " if others else ""
        what = "messages" if messages is None else counted(messages, "message")
        found = f"{name}, which metadata.yaml names, is missing or no recording"
        lost.append(f"{found}: {unless}its {what} cannot be read")
    if len(lost) > MAX_DAMAGE_LINES:
        more = counted(len(lost) - MAX_DAMAGE_LINES, "more file")
        lost[MAX_DAMAGE_LINES:] = [f"{more} that metadata.yaml names cannot be read"]
    yield from (legible(f"{folder}: {line}") for line in lost)


def _expected(readers: _Readers) -> str:
    """The formats in a phrase: `expected MCAP, ROS 1 bag or CARMEN log`."""
    *others, last = [reader.format for reader in readers.values()]
    return f"expected {', '.join(others)} or {last}" if others else f"expected {last}"


def looks_like_a_log(file: Path, readers: _Readers) -> bool:
    """Whether a file begins as a recording, or as a compressed file. Raises LogError."""
    head = head_of(file)
    packed = compression_of(head) is not None
    return packed or any(reader.sniff(head, file) for reader in readers.values())


def _opened(path: Path, readers: _Readers, config: LogConfig, held: ExitStack) -> Recording:
    """The recording in one file, which `held` closes; a compressed one is unpacked first."""
    compression = compression_of(head_of(path))
    if compression is None:
        recording = _reader_of(path, path, readers)(path, path, config)
        held.callback(recording.close)
        return recording

    def reader_inside(file: Path) -> type[Recording]:
        if compression_of(head_of(file)) is not None:
            raise refused(path, "compressed twice", "unpack it first")
        with _told_of(compression):
            return _reader_of(file, path, readers)

    file, lost = unpacked(path, compression, config, reader_inside, held)
    reader = reader_inside(file)
    with _told_of(compression):
        recording = reader(file, path, config)
    held.callback(recording.close)
    if lost is not None:
        recording.report(lost)
    return recording


@contextmanager
def _told_of(compression: str) -> Iterator[None]:
    """Errors say that they are about what is inside a compressed file."""
    inside = f"(inside {compression} compression)"
    try:
        yield
    except LogError as error:
        found, hint = error.found, error.hint
        found, hint = (found, f"{hint} {inside}") if hint else (f"{found} {inside}", None)
        raise LogError(found, hint, mark=error.mark, where=error.where, code=error.code) from None


def _reader_of(file: Path, path: Path, readers: _Readers) -> type[Recording]:
    """The reader of `file`, called `path`; raises LogError saying what it is instead."""
    head = head_of(file)
    if not head:
        raise refused(path, "the file is empty", code=LOG_DAMAGED)
    for reader in readers.values():
        if reader.sniff(head, file):
            return reader
    if any(known.magic.startswith(head) for known in readers.values()):
        cut = f"cut off after {len(head)} bytes; no message can be read"
        raise refused(path, cut, code=LOG_DAMAGED)
    kind = "a text file" if b"\x00" not in head and is_text(head) else "of an unknown format"
    raise refused(path, f"{kind}, not a recording", _expected(readers))


class Log:
    """Recordings joined in time: what `open_log` returns. Use it in a `with` block.

    `given` are the paths the user named, `paths` the files, earliest first, and `name` is what to
    call the log in messages. `held` is released with it, by default the recordings; `lost` are
    lines on files that are not there.
    """

    def __init__(
        self,
        recordings: Sequence[Recording],
        given: Sequence[Path],
        held: ExitStack | None = None,
        lost: Sequence[str] = (),
    ) -> None:
        self.given = tuple(given)
        self._recordings = sorted(recordings, key=lambda r: (r.contents.start_ns, str(r.path)))
        self.paths = [recording.path for recording in self._recordings]
        more = len(self.given) - 1
        self.name = f"{self.given[0]}" + (f" and {more} more" if more else "")
        self._lost = tuple(lost)
        self._held = held if held is not None else ExitStack()
        if held is None:
            for recording in recordings:
                self._held.callback(recording.close)

    @property
    def format(self) -> str:
        """The name of the format; several are joined by ` + `."""
        return " + ".join(sorted({recording.format for recording in self._recordings}))

    @property
    def damage(self) -> list[str]:
        """One line for each loss met so far: file, byte or message, time."""
        return [*self._lost, *(line for each in self._recordings for line in each.damage)]

    @property
    def missing(self) -> Counter[str]:
        """How many messages of each topic are known to be lost so far."""
        return sum((recording.missing for recording in self._recordings), Counter())

    @cached_property
    def contents(self) -> Contents:
        """Topics and times of all files together."""
        parts = [r.contents for r in self._recordings]
        timed = [part for part in parts if part.messages]
        return contents_of(
            ((topic.name, topic.type, topic.count) for part in parts for topic in part.topics),
            start_ns=min((part.start_ns for part in timed), default=0),
            end_ns=max((part.end_ns for part in timed), default=0),
        )

    def side_by_side(self, topic: str) -> Iterator[tuple[Path, Path, int]]:
        """Files that hold one topic at the same time, and for how many nanoseconds.

        Each is given with the one of those before it that lasts longest. A file begins with its
        first message on the topic: transforms may be repeated from the file before it.
        """
        longest: Recording | None = None
        for recording in self._recordings:
            first = next(iter(recording.messages([topic])), None)
            if first is None:
                continue
            if longest is not None:
                shared = min(longest.contents.end_ns, recording.contents.end_ns) - first.time_ns
                if shared > 0:
                    yield longest.path, recording.path, shared
            if longest is None or recording.contents.end_ns > longest.contents.end_ns:
                longest = recording

    def topics(self) -> list[TopicInfo]:
        """The topics by name; a name with two types is listed once for each."""
        return list(self.contents.topics)

    def messages(self, topics: Collection[str] | None = None) -> Iterator[Message]:
        """The messages on `topics` (None: all), one in memory at a time, in log time."""
        return merge_in_time(
            [(r.contents.start_ns, partial(r.messages, topics)) for r in self._recordings]
        )

    def close(self) -> None:
        """Release the files."""
        self._held.close()

    def __enter__(self) -> Log:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
