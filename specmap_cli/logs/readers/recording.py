"""What every file format offers: its contents, and its messages one at a time.

A recording is one file. `Log` joins the files of one or several recordings in time. Messages carry
ROS 2 CDR whatever the file held, and damage is written down, never raised, while anything can
still be read.
"""

from __future__ import annotations

import heapq
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import ClassVar, NamedTuple

from specmap_cli.core.errors import LogError

MAX_DAMAGE_LINES = 20  # a file, then one that says there is more


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
    """One file, read in pieces of bounded size."""

    format: ClassVar[str]

    def __init__(self, path: Path) -> None:
        self.path = path
        self.damage: list[str] = []

    @cached_property
    @abstractmethod
    def contents(self) -> Contents:
        """The topics and times: from the file's own index, otherwise by reading it once."""

    @abstractmethod
    def messages(self, topics: Collection[str] | None = None) -> Iterator[Message]:
        """The messages on `topics` (None: all) in time order, or as written without an index."""

    @abstractmethod
    def close(self) -> None:
        """Release the file."""

    def report(self, damage: str) -> None:
        """Note what was lost, once however often the file is read."""
        line = f"{self.path}: {damage}"
        if len(self.damage) == MAX_DAMAGE_LINES:
            line = f"{self.path}: there is more damage than is listed here"
        if line not in self.damage and len(self.damage) <= MAX_DAMAGE_LINES:
            self.damage.append(line)


class Log:
    """Recordings joined in time: what `open_log` returns. Use it in a `with` block.

    `given` are the paths the user named, files or directories.
    """

    def __init__(self, recordings: Sequence[Recording], given: Sequence[Path]) -> None:
        self.given = list(given)
        self._recordings = sorted(recordings, key=lambda r: (r.contents.start_ns, str(r.path)))

    @property
    def paths(self) -> list[Path]:
        """The files, earliest first."""
        return [recording.path for recording in self._recordings]

    @property
    def name(self) -> str:
        """What to call the log in messages."""
        more = len(self.given) - 1
        return f"{self.given[0]}" + (f" and {more} more" if more else "")

    @property
    def format(self) -> str:
        """The name of the format; several are joined by ` + `."""
        return " + ".join(sorted({recording.format for recording in self._recordings}))

    @property
    def damage(self) -> list[str]:
        """One line for each loss met so far: file, byte or message, time."""
        return [line for recording in self._recordings for line in recording.damage]

    @cached_property
    def contents(self) -> Contents:
        """Topics and times of all files together; a topic has one type throughout."""
        parts = [r.contents for r in self._recordings if r.contents.messages]
        counts: dict[tuple[str, str], int] = {}
        for topic in (topic for r in self._recordings for topic in r.contents.topics):
            key = (topic.name, topic.type)
            counts[key] = counts.get(key, 0) + topic.count
        return Contents(
            topics=tuple(TopicInfo(*key, counts[key]) for key in sorted(counts)),
            start_ns=min((part.start_ns for part in parts), default=0),
            end_ns=max((part.end_ns for part in parts), default=0),
        )

    def topics(self) -> list[TopicInfo]:
        """The topics by name."""
        return list(self.contents.topics)

    def messages(self, topics: Collection[str] | None = None) -> Iterator[Message]:
        """The messages on `topics` (None: all), one in memory at a time, in log time."""
        return merge_in_time(
            [(r.contents.start_ns, _opener(r, topics)) for r in self._recordings],
        )

    def close(self) -> None:
        """Release the files."""
        for recording in self._recordings:
            recording.close()

    def __enter__(self) -> Log:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _opener(
    recording: Recording, topics: Collection[str] | None
) -> Callable[[], Iterator[Message]]:
    return lambda: recording.messages(topics)


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


def survey(entries: Iterable[tuple[str, str, int]]) -> Contents:
    """The contents of a file without an index from (topic, type, time) of all its messages."""
    counts: dict[tuple[str, str], int] = {}
    start = end = None
    for topic, type_name, time_ns in entries:
        key = (topic, type_name)
        counts[key] = counts.get(key, 0) + 1
        start = time_ns if start is None else min(start, time_ns)
        end = time_ns if end is None else max(end, time_ns)
    topics = tuple(TopicInfo(*key, counts[key]) for key in sorted(counts))
    return Contents(topics, start or 0, end or 0)


def seconds(time_ns: int) -> str:
    """A time for messages to the user."""
    return f"{time_ns / 1e9:.3f} s"


def unreadable(path: Path, error: OSError) -> LogError:
    """The error for a file the system refuses to read."""
    return LogError(f"{path}: cannot read: {error.strerror or error}")
