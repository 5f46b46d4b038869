"""rosbag2's SQLite files (`.db3`) of every ROS 2 distribution, with what a damaged one still holds.

The message definitions that newer ones carry are not needed: the types read here have not changed.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Collection, Iterator
from functools import cached_property
from pathlib import Path
from urllib.parse import quote

from specmap_cli.core.errors import LogError
from specmap_cli.logs.readers.compression import compression_of, decompress
from specmap_cli.logs.readers.recording import (
    Contents,
    Message,
    Recording,
    TopicInfo,
    seconds,
    survey,
)
from specmap_cli.logs.readers.typestore import normalized_type

MAGIC = b"SQLite format 3\x00"


class Rosbag2File(Recording):
    """One SQLite file of a rosbag2 recording."""

    format = "rosbag2 (SQLite)"

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        pending = path.with_name(path.name + "-wal").exists()  # left by a recorder that was killed
        options = "mode=ro" if pending else "mode=ro&immutable=1"
        location = f"file:{quote(str(path.resolve()))}?{options}"
        try:
            self._db = sqlite3.connect(location, uri=True)
        except sqlite3.Error as error:
            raise LogError(f"{path}: cannot read: {error}") from None
        try:
            self._db.execute("PRAGMA writable_schema = ON")  # lets a cut-off file be read at all
            rows = self._db.execute("SELECT id, name, type FROM topics")
            self._topics = {
                number: (name, normalized_type(kind))
                for number, name, kind in rows
                if isinstance(name, str) and isinstance(kind, str)  # a cut-off file has holes
            }
            self._sorted = self._has_time_index()
        except sqlite3.Error as error:
            self._db.close()
            raise LogError(f"{path}: no readable rosbag2 file: {error}") from None

    def _has_time_index(self) -> bool:
        """Whether the messages can be had in time order without sorting them all."""
        indexes = self._db.execute("SELECT sql FROM sqlite_master WHERE type = 'index'")
        return any("messages" in (sql or "") and "timestamp" in sql for (sql,) in indexes)

    @cached_property
    def contents(self) -> Contents:
        """Counted by the database, or message by message when it is damaged."""
        try:
            rows = self._db.execute("SELECT topic_id, COUNT(*) FROM messages GROUP BY topic_id")
            counts = dict(rows.fetchall())
            times = self._db.execute("SELECT MIN(timestamp), MAX(timestamp) FROM messages")
            start, end = times.fetchone()
        except sqlite3.Error:
            self._sorted = False  # the index may be lost as well: read in the order of recording
            found = survey((m.topic, m.type, m.time_ns) for m in self.messages())
            if not self.damage:
                self.report("damaged or cut off: some messages are lost")
            return found
        if not self._topics:
            self.report("the list of topics is lost")
        topics = [TopicInfo(*self._topics[n], counts.get(n, 0)) for n in self._topics]
        ordered = sorted(topics, key=lambda topic: (topic.name, topic.type))
        return Contents(tuple(ordered), start or 0, end or 0)

    def messages(self, topics: Collection[str] | None = None) -> Iterator[Message]:
        """The messages on `topics` in time order, or as recorded when the file is damaged."""
        wanted = [n for n, (name, _) in self._topics.items() if topics is None or name in topics]
        last, read = 0, 0
        try:
            for number, time_ns, data in self._db.execute(*self._query(wanted)):
                if not isinstance(time_ns, int) or not isinstance(data, bytes):
                    continue
                last, read = time_ns, read + 1
                if compression_of(data[:4]) == "zstd":  # rosbag2's compression of single messages
                    data, _ = decompress(data, "zstd")
                yield Message(*self._topics[number], time_ns, data)
        except sqlite3.Error as error:
            self.report(
                f"{error} after message {read} at {seconds(last)}: what followed it is lost"
            )

    def _query(self, wanted: list[int]) -> tuple[str, list[int]]:
        order = "timestamp, id" if self._sorted else "id"
        places = ",".join("?" * len(wanted))
        query = f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({places})"
        return f"{query} ORDER BY {order}", wanted

    def close(self) -> None:
        """Release the file."""
        self._db.close()
