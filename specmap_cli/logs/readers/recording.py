"""The protocol of a reader: what every format gives, and its messages one at a time."""

from __future__ import annotations

import heapq
from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, NamedTuple

from specmap_cli.core.errors import LOG_MISSING, LogError
from specmap_cli.core.settings import LogConfig
from specmap_cli.core.text import counted, legible

_LONGEST_CHARACTER_BYTES = 4  # of UTF-8
MAX_DAMAGE_LINES = 20  # a file, as many as a person reads; one more line sums the others up


class Message(NamedTuple):
    """One message: `time_ns` is the recorder's log time, `data` ROS 2 CDR of `type`."""

    topic: str
    type: str
    time_ns: int
    data: bytes


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """A topic, its ROS 2 type and how many messages it holds."""

    name: str
    type: str
    count: int


@dataclass(frozen=True, slots=True)
class Contents:
    """The topics of a recording by name, and its first and last log time (0, 0 when empty)."""

    topics: tuple[TopicInfo, ...]
    start_ns: int
    end_ns: int

    @property
    def messages(self) -> int:
        """Number of messages."""
        return sum(topic.count for topic in self.topics)


class Recording(ABC):
    '''A reader: one file of one format, read in pieces of bounded size.

    A class for a format derives from this one and gives all of the following.

    - `format`: the name of the format, as people know it.
    - `magic`: the first bytes of such a file. A format without any has its own `sniff(head, file)`,
      which says from the first bytes, and from the file where they are not enough, whether the
      class can read it. It must be quick and must not raise for a file of another format.
    - The constructor takes `file`, where the bytes lie, `path`, what the user calls it, and
      `config`, the settings, whose bounds it keeps. The paths differ for a compressed recording,
      which is unpacked into a temporary file: read `file`, and name `path` in messages. Raise
      LogError, starting with `path`, when nothing can be read.
    - `contents`: the topics with their counts, the first and the last log time. `survey` counts
      them in a file that has no index.
    - `messages(topics)`: an iterator over the messages on these topics, ROS 2 CDR whatever the file
      holds. `logs.readers.encoding` makes CDR of plain values. It may be asked for several times,
      also at once. It holds one piece of the file in memory, never all messages.
    - Damage is never raised while anything can still be read: `report` notes what was lost, with
      the number of messages by topic where that is known.
    - `close` releases what the constructor opened.

    A package adds its reader by an entry point in its pyproject.toml::

        [project.entry-points."specmap.readers"]
        range_lines = "range_lines:RangeLines"

    A whole reader, of lines with a stamp in nanoseconds and ranges in metres::

        from specmap_cli.logs.readers import Message, Recording, survey
        from specmap_cli.logs.readers.encoding import scan_cdr

        SCAN = "sensor_msgs/msg/LaserScan"

        class RangeLines(Recording):
            """One scan a line, a degree between its beams."""

            format = "range lines"
            magic = b"RANGES 1\\n"

            @property
            def contents(self):
                return survey((m.topic, m.type, m.time_ns) for m in self.messages())

            def messages(self, topics=None):
                if topics is not None and "/scan" not in topics:
                    return
                with self.file.open("rb") as lines:
                    for number, line in enumerate(lines, start=1):
                        if number == 1:
                            continue
                        try:
                            stamp, *words = line.split()
                            stamp_ns, ranges = int(stamp), [float(word) for word in words]
                        except ValueError:
                            what = f"line {number} is damaged: one scan is lost"
                            self.report(what, {"/scan": 1})
                            continue
                        data = scan_cdr("laser", stamp_ns, 0.0, 0.01745, ranges, range_max=30.0)
                        yield Message("/scan", SCAN, stamp_ns, data)

            def close(self):
                """The file is closed after each reading."""
    '''

    format: ClassVar[str]
    magic: ClassVar[bytes] = b""

    def __init__(
        self, file: Path, path: Path | None = None, config: LogConfig | None = None
    ) -> None:
        self.file = file
        self.path = path if path is not None else file
        self.config = config if config is not None else LogConfig()
        # the most bytes of a chunk or a message that are taken into memory
        self.chunk_max = round(self.config.chunk_max_mb * 1_000_000)
        self._damage: dict[str, Counter[str]] = {}

    @classmethod
    def sniff(cls, head: bytes, file: Path) -> bool:  # noqa: ARG003 (for formats without magic)
        """Whether this class reads `file`, whose first 4,096 bytes, or fewer, are `head`."""
        return bool(cls.magic) and head.startswith(cls.magic)

    @property
    @abstractmethod
    def contents(self) -> Contents:
        """The topics and times: from the file's own index, otherwise by reading it once."""

    @abstractmethod
    def messages(self, topics: Collection[str] | None = None) -> Iterator[Message]:
        """The messages on `topics` (None: all) in time order, or as written without an index."""

    @abstractmethod
    def close(self) -> None:
        """Release the file."""

    @property
    def damage(self) -> tuple[str, ...]:
        """One line for each loss met so far: file, byte or message, time, what was lost.

        From a number of lines on, one more line sums the others up.
        """
        lines = tuple(f"{legible(str(self.path))}: {line}" for line in self._damage)
        more = len(lines) - MAX_DAMAGE_LINES
        if more <= 0:
            return lines
        total = f"; in all, {lost_text(self.missing)} are lost" if self.missing else ""
        summed = f"{legible(str(self.path))}: damaged at {counted(more, 'more place')}{total}"
        return (*lines[:MAX_DAMAGE_LINES], summed)

    @property
    def missing(self) -> Counter[str]:
        """How many messages of each topic are known to be lost so far."""
        return sum(self._damage.values(), Counter())

    def report(self, damage: str, lost: Mapping[str, int] | None = None) -> None:
        """Note what was lost, once however often the file is read.

        `lost` are the numbers of messages by topic, where they are known.
        """
        self._damage.setdefault(legible(damage), Counter(lost or {}))


def lost_text(lost: Mapping[str, int], of: Mapping[str, int] | None = None) -> str:
    """`3 messages on /scan and 2 on /odom`; with `of`, `3 of 5 messages on /scan`."""
    parts: list[str] = []
    for topic in sorted(lost):
        number, whole = lost[topic], (of or {}).get(topic)
        noun = "" if parts else " message" + ("s" if (whole or number) != 1 else "")
        share = f" of {whole:,}" if whole is not None else ""
        parts.append(f"{number:,}{share}{noun} on {topic}")
    return " and ".join(", ".join(parts).rsplit(", ", 1))


def survey(entries: Iterable[tuple[str, str, int]]) -> Contents:
    """The contents of a file without an index from (topic, type, time) of all its messages."""
    counts: Counter[tuple[str, str]] = Counter()
    start = end = None
    for topic, type_name, time_ns in entries:
        counts[topic, type_name] += 1
        start = time_ns if start is None else min(start, time_ns)
        end = time_ns if end is None else max(end, time_ns)
    return contents_of(((*key, count) for key, count in counts.items()), start or 0, end or 0)


def contents_of(counted: Iterable[tuple[str, str, int]], start_ns: int, end_ns: int) -> Contents:
    """The contents from (topic, type, count); counts of one topic and type are added up."""
    counts: Counter[tuple[str, str]] = Counter()
    for topic, type_name, count in counted:
        counts[topic, type_name] += count
    topics = tuple(TopicInfo(*key, counts[key]) for key in sorted(counts))
    return Contents(topics, start_ns, end_ns)


def time_text(time_ns: int) -> str:
    """A log time for messages to the user."""
    return f"{time_ns / 1e9:.3f} s"


def refused(where: Path | str, found: str, hint: str = "", code: str | None = None) -> LogError:
    """The error of a recording that cannot be used: where, what was found there, what to do."""
    return LogError(found, hint or None, mark=";", where=where, code=code)


def unreadable(path: Path, error: OSError) -> LogError:
    """The error for a file that is not there or that the system refuses to read."""
    if isinstance(error, FileNotFoundError):
        return refused(path, "no such file or directory", code=LOG_MISSING)
    return LogError.of_system(error, "cannot read", where=path)


def merge_in_time(
    sources: Iterable[tuple[int, Callable[[], Iterator[Message]]]],
) -> Iterator[Message]:
    """Join iterators of messages by log time, opening each only when its start has come.

    `sources` are (start_ns, function that opens the iterator). Only those whose spans overlap are
    open together. An iterator that runs backwards in time keeps its own order.
    """
    waiting = deque(sorted(sources, key=lambda source: source[0]))
    heap: list[tuple[int, int, Message, Iterator[Message]]] = []
    opened = 0
    while waiting or heap:
        while waiting and (not heap or waiting[0][0] <= heap[0][0]):
            messages = waiting.popleft()[1]()
            first = next(messages, None)
            if first is not None:
                heapq.heappush(heap, (first.time_ns, opened, first, messages))
                opened += 1
        if not heap:
            continue
        _, number, message, messages = heap[0]
        yield message
        following = next(messages, None)
        if following is None:
            heapq.heappop(heap)
        else:
            heapq.heapreplace(heap, (following.time_ns, number, following, messages))


def is_text(head: bytes) -> bool:
    """Whether the first bytes of a file are text in UTF-8."""
    try:
        head.decode("utf-8")
    except UnicodeDecodeError as error:
        # the end of the piece may cut a character in two
        return error.start > len(head) - _LONGEST_CHARACTER_BYTES
    return True
