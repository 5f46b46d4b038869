"""A log: the recordings of one or several files, joined in time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from contextlib import ExitStack
from functools import cached_property, partial
from pathlib import Path

from specmap_cli.logs.readers.recording import Contents, Message, Recording, TopicInfo, contents_of
from specmap_cli.logs.readers.time_order import merge_in_time


class Log:
    """Recordings joined in time: what `open_log` returns. Use it in a `with` block.

    `given` are the paths the user named, files or directories. `held` is what must be released
    with the log, by default the recordings.
    """

    def __init__(
        self,
        recordings: Sequence[Recording],
        given: Sequence[Path],
        held: ExitStack | None = None,
    ) -> None:
        self.given = tuple(given)
        self._recordings = sorted(recordings, key=lambda r: (r.contents.start_ns, str(r.path)))
        self._held = held if held is not None else ExitStack()
        if held is None:
            for recording in recordings:
                self._held.callback(recording.close)

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
            [(r.contents.start_ns, partial(r.messages, topics)) for r in self._recordings],
        )

    def close(self) -> None:
        """Release the files."""
        self._held.close()

    def __enter__(self) -> Log:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
