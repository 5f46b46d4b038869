"""rosbag2's SQLite files (`.db3`) of every ROS 2 distribution, with what a damaged one still holds.

The message definitions that newer ones carry are not needed: the types read here have not changed.
"""

from __future__ import annotations

import sqlite3
from collections import Counter
from collections.abc import Collection, Iterator
from functools import cached_property
from pathlib import Path
from urllib.parse import quote

from specmap_cli.core.errors import LogError
from specmap_cli.core.settings import LogConfig
from specmap_cli.core.text import counted
from specmap_cli.logs.readers.compression import compression_of, decompress
from specmap_cli.logs.readers.metadata import recorded_messages
from specmap_cli.logs.readers.recording import (
    Contents,
    Message,
    Recording,
    contents_of,
    lost_text,
    survey,
    time_text,
)
from specmap_cli.logs.readers.typestore import normalized_type

MAGIC = b"SQLite format 3\x00"


class Rosbag2File(Recording):
    """One SQLite file of a rosbag2 recording."""

    format = "rosbag2 (SQLite)"
    magic = MAGIC

    def __init__(
        self, file: Path, path: Path | None = None, config: LogConfig | None = None
    ) -> None:
        super().__init__(file, path, config)
        self._message_max = round(self.config.chunk_max_mb * 1_000_000)  # bytes in a megabyte
        pending = file.with_name(file.name + "-wal").exists()  # left by a recorder that was killed
        options = "mode=ro" if pending else "mode=ro&immutable=1"
        location = f"file:{quote(str(file.resolve()))}?{options}"
        try:
            self._db = sqlite3.connect(location, uri=True)
        except sqlite3.Error as error:
            raise LogError(f"{self.path}: cannot read: {error}") from None
        try:
            self._db.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, self._message_max)
            self._db.execute("PRAGMA writable_schema = ON")  # lets a cut-off file be read at all
            rows = self._db.execute("SELECT id, name, type FROM topics")
            self._topics = {
                number: (name, normalized_type(kind))
                for number, name, kind in rows
                if isinstance(name, str) and isinstance(kind, str)  # a cut-off file has holes
            }
            self._time_index = self._find_time_index()
            self._sorted = self._time_index is not None
        except sqlite3.Error as error:
            self._db.close()
            raise LogError(f"{self.path}: no readable rosbag2 file: {error}") from None

    def _find_time_index(self) -> str | None:
        """The name of an index by which messages come in time order without sorting them all."""
        indexes = self._db.execute("SELECT name, sql FROM sqlite_master WHERE type = 'index'")
        return next(
            (n for n, sql in indexes if "timestamp" in (sql or "") and "messages" in sql), None
        )

    @cached_property
    def contents(self) -> Contents:
        """Counted by the database, or message by message when it is damaged."""
        try:
            times = self._db.execute("SELECT MIN(timestamp), MAX(timestamp) FROM messages")
            start, end = (time if isinstance(time, int) else 0 for time in times.fetchone())
            counts = self._counts
        except sqlite3.Error:
            self._sorted = False  # the index may be lost as well: read in the order of recording
            found = survey((m.topic, m.type, m.time_ns) for m in self.messages())
            if not self.damage:
                self.report("damaged or cut off: some messages are lost")
            return found
        if not self._topics:
            self.report("the list of topics is lost")
        try:
            self._check_numbers(sum(counts.values()))
        except sqlite3.Error as error:
            self._sorted = False
            self.report(f"{error}: whether messages are missing cannot be checked")
        counted = ((*topic, counts.get(number, 0)) for number, topic in self._topics.items())
        return contents_of(counted, start, end)

    @cached_property
    def _counts(self) -> Counter[int]:
        """The messages of each topic in the table itself; raises sqlite3.Error."""
        rows = self._db.execute(
            "SELECT topic_id, COUNT(*) FROM messages NOT INDEXED GROUP BY topic_id"
        )
        return Counter({number: count for number, count in rows if isinstance(number, int)})

    def _check_numbers(self, there: int) -> None:
        """Compare the messages in the table with what else tells of them; raises sqlite3.Error."""
        first, last = self._db.execute("SELECT MIN(rowid), MAX(rowid) FROM messages").fetchone()
        numbered = last - first + 1 if there else 0
        listed = self._count_by_time(there)
        self._sorted = self._sorted and listed == there  # the order of recording misses none
        whole = max(numbered, listed, recorded_messages(self.path) or 0)
        if whole > there:
            self.report(
                f"{whole - there:,} of {counted(whole, 'message')} are not in its table: the "
                "numbers of the messages, the index or metadata.yaml tell of them"
            )
        unknown = {n: count for n, count in self._counts.items() if n not in self._topics}
        if unknown:
            self.report(f"{counted(sum(unknown.values()), 'message')} on topics without a name")

    def _count_by_time(self, there: int) -> int:
        """How many messages the time index lists, -1 when it is lost; `there` without one."""
        if self._time_index is None:
            return there
        name = self._time_index.replace('"', '""')
        try:
            rows = self._db.execute(f'SELECT COUNT(*) FROM messages INDEXED BY "{name}"')
            return int(rows.fetchone()[0])
        except sqlite3.Error:
            return -1

    def messages(self, topics: Collection[str] | None = None) -> Iterator[Message]:
        """The messages on `topics` in time order, or as recorded when the file is damaged."""
        wanted = [n for n, (name, _) in self._topics.items() if topics is None or name in topics]
        last, found = 0, Counter[int]()
        try:
            for number, time_ns, data in self._db.execute(*self._query(wanted)):
                message = self._message(number, time_ns, data)
                found[number] += 1
                if message is not None:
                    last = time_ns
                    yield message
        except sqlite3.Error as error:
            self.report(
                f"{error} after message {found.total()} at {time_text(last)}: what followed it "
                "is lost",
                self._unread(wanted, found),
            )
            return
        lost = self._unread(wanted, found)
        if lost:
            self.report(f"{lost_text(lost)} cannot be found", lost)

    def _unread(self, wanted: list[int], found: Counter[int]) -> Counter[str]:
        """The messages by topic that the table has and that no pass has come to."""
        try:
            counts = self._counts
        except sqlite3.Error:
            return Counter()
        unread: Counter[str] = Counter()
        for number in wanted:
            unread[self._topics[number][0]] += max(counts[number] - found[number], 0)
        return +unread

    def _message(self, number: int, time_ns: object, data: object) -> Message | None:
        """The message in a row of the table; None, and reported, when there is none."""
        name, kind = self._topics[number]
        fault = None
        if not isinstance(time_ns, int) or not isinstance(data, bytes):
            fault = "the row of a message does not hold one"
        elif compression_of(data[:4]) == "zstd":  # rosbag2's compression of single messages
            data, complete, beyond = decompress(data, "zstd", self._message_max)
            if beyond:
                fault = f"a message at {time_text(time_ns)} is beyond log.chunk_max_mb"
            elif not complete:
                fault = f"a message at {time_text(time_ns)} is damaged in its compression"
        if fault is not None:
            self.report(f"{fault}: one on {name} is lost", {name: 1})
            return None
        assert isinstance(time_ns, int)
        assert isinstance(data, bytes)
        return Message(name, kind, time_ns, data)

    def _query(self, wanted: list[int]) -> tuple[str, list[int]]:
        order = "timestamp, id" if self._sorted else "id"
        places = ",".join("?" * len(wanted))
        query = f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({places})"
        return f"{query} ORDER BY {order}", wanted

    def close(self) -> None:
        """Release the file."""
        self._db.close()
