"""rosbag2's SQLite files (`.db3`) of every ROS 2 distribution, with what a damaged one still holds.

The message definitions that newer ones carry are not needed: the types read here have not changed.
"""

from __future__ import annotations

import re
import sqlite3
from bisect import bisect_left
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

from specmap_cli.core.errors import LOG_DAMAGED
from specmap_cli.core.files import read_bytes
from specmap_cli.core.settings import LogConfig
from specmap_cli.core.text import counted, legible
from specmap_cli.core.yaml import read_yaml
from specmap_cli.logs.readers import recording
from specmap_cli.logs.readers.compression import MAGIC, Unpacked, decompress
from specmap_cli.logs.readers.encoding import SUPPORTED_TYPES, normalized_type

_LARGEST_MB = 4.0  # of a metadata.yaml: some kilobytes, with many topics and files a megabyte
_MOST = 10**18  # messages in a file


def recorded_files(folder: Path) -> dict[str, int | None]:
    """The names of the files of a recording by its metadata, and how many messages each has.

    None stands for a number that it does not tell: recorders before ROS 2 Galactic wrote a list of
    paths alone. Empty where there is no metadata, or a damaged one.
    """
    found: dict[str, int | None] = {}
    with suppress(OSError, ValueError, TypeError, KeyError):
        read = read_yaml(read_bytes(folder / "metadata.yaml", _LARGEST_MB))
        about = read["rosbag2_bagfile_information"]
        with suppress(TypeError, KeyError):
            found = {Path(path).name: None for path in about["relative_file_paths"]}
        for one in about["files"]:
            messages = int(one["message_count"])
            found[Path(one["path"]).name] = messages if 0 <= messages < _MOST else None
    found.pop("", None)
    return found


_TYPE_NAME = re.compile(r"[A-Za-z]\w*(/\w+){1,2}")  # package/msg/Name

# The same for the table and for an index that has all its rows: a sum that has no order. The primes
# keep it exact for a thousand million messages.
_FINGERPRINT = "TOTAL(timestamp % 10007 * (rowid % 503))"


@dataclass(frozen=True, slots=True)
class _Table:
    """What the table of messages says by itself; times are those of the first and the last."""

    counts: Counter[int]
    start_ns: int
    end_ns: int
    fingerprint: float


def _is_damaged_type(kind: str) -> bool:
    """Whether this names no type, or one that is read but for one letter."""
    name = normalized_type(kind)
    off = [sum(map(str.__ne__, name, one)) for one in SUPPORTED_TYPES if len(one) == len(name)]
    return _TYPE_NAME.fullmatch(kind) is None or 1 in off


class Rosbag2File(recording.Recording):
    """One SQLite file of a rosbag2 recording."""

    format = "rosbag2 (SQLite)"
    magic = b"SQLite format 3\x00"

    def __init__(
        self, file: Path, path: Path | None = None, config: LogConfig | None = None
    ) -> None:
        super().__init__(file, path, config)
        pending = file.with_name(file.name + "-wal").exists()  # left by a recorder that was killed
        options = "mode=ro" if pending else "mode=ro&immutable=1"
        location = f"file:{quote(str(file.resolve()))}?{options}"
        try:
            self._db = sqlite3.connect(location, uri=True)
        except sqlite3.Error as error:
            raise recording.refused(self.path, f"cannot read: {error}") from None
        # a damaged byte costs a character, not the row
        self._db.text_factory = partial(str, encoding="utf-8", errors="replace")
        try:
            self._db.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, self.chunk_max)
            self._db.execute("PRAGMA writable_schema = ON")  # lets a cut-off file be read at all
            rows = self._db.execute("SELECT id, name, type FROM topics")
            self._topics = {
                number: (name, normalized_type(kind))
                for number, name, kind in rows
                if isinstance(name, str) and isinstance(kind, str)  # a cut-off file has holes
            }
            # an index by which messages come in time order without sorting them all
            indexes = self._db.execute("SELECT name, sql FROM sqlite_master WHERE type = 'index'")
            self._time_index: str | None = None
            for name, made in indexes:
                sound = isinstance(name, str) and isinstance(made, str) and "\0" not in name
                if sound and "timestamp" in made and "messages" in made:
                    self._time_index = name
                    break
            self._sorted = self._time_index is not None
        except sqlite3.Error as error:
            self._db.close()
            fault = f"no readable rosbag2 file: {error}"
            raise recording.refused(self.path, fault, code=LOG_DAMAGED) from None

    @cached_property
    def contents(self) -> recording.Contents:
        """Counted by the database, or message by message when it is damaged."""
        try:
            table = self._table
        except sqlite3.Error:
            self._sorted = False  # the index may be lost as well: read in the order of recording
            found = recording.survey((m.topic, m.type, m.time_ns) for m in self.messages())
            if not self.damage:
                self.report("damaged or cut off: some messages are lost")
            return found
        if not self._topics:
            self.report("the list of topics is lost")
        for number, (name, kind) in self._topics.items():
            count = table.counts[number]
            if count and _is_damaged_type(kind):
                self.report(
                    f"the type of topic {legible(name)} is damaged ({legible(kind)}): "
                    f"{counted(count, 'message')} cannot be read"
                )
        try:
            self._check_numbers(table)
        except sqlite3.Error as error:
            self._sorted = False
            self.report(f"{error}: whether messages are missing cannot be checked")
        counts = ((*topic, table.counts[number]) for number, topic in self._topics.items())
        return recording.contents_of(counts, table.start_ns, table.end_ns)

    @cached_property
    def _table(self) -> _Table:
        """What the table of messages holds by itself; raises sqlite3.Error."""
        rows = self._db.execute(
            "SELECT topic_id, COUNT(*), MIN(timestamp), MAX(timestamp), "
            f"{_FINGERPRINT} FROM messages NOT INDEXED GROUP BY topic_id"
        ).fetchall()
        times = [time for row in rows for time in row[2:4] if isinstance(time, int)]
        return _Table(
            counts=Counter({row[0]: row[1] for row in rows if isinstance(row[0], int)}),
            start_ns=min(times, default=0),
            end_ns=max(times, default=0),
            fingerprint=sum(row[4] for row in rows),
        )

    def _check_numbers(self, table: _Table) -> None:
        """Compare the messages in the table with what else tells of them; raises sqlite3.Error."""
        there, listed = table.counts.total(), 0
        ends = "SELECT MIN(rowid), MAX(rowid) FROM messages NOT INDEXED"
        first, last = self._db.execute(ends).fetchone()
        numbered = last - first + 1 if there else 0
        if self._time_index is not None:
            name = self._time_index.replace('"', '""')
            query = f'SELECT COUNT(*), {_FINGERPRINT} FROM messages INDEXED BY "{name}"'
            try:
                listed, fingerprint = self._db.execute(query).fetchone()
            except sqlite3.Error:
                fingerprint = -1.0
            self._sorted = fingerprint == table.fingerprint  # the order of recording misses none
            if not self._sorted and listed <= there:
                self.report(
                    "the index of time is damaged: read in the order of recording, "
                    "nothing is lost by this"
                )
        whole = max(numbered, listed, recorded_files(self.path.parent).get(self.path.name) or 0)
        if whole > there:
            self.report(
                f"{whole - there:,} of {counted(whole, 'message')} are not in its table: the "
                "numbers of the messages, the index or metadata.yaml tell of them"
            )
        unknown = {n: count for n, count in table.counts.items() if n not in self._topics}
        if unknown:
            self.report(f"{counted(sum(unknown.values()), 'message')} on topics without a name")

    def messages(self, topics: Collection[str] | None = None) -> Iterator[recording.Message]:
        """The messages on `topics` in time order, or as recorded when the file is damaged."""
        wanted = [n for n, (name, _) in self._topics.items() if topics is None or name in topics]
        found = Counter[int]()
        for row in Rows(self._db, wanted, self._sorted):
            if isinstance(row, Fault):
                self._tell(row)
                found.update([] if row.topic is None else [row.topic])
                continue
            found[row.topic] += 1
            message = self._message(*row)
            if message is not None:
                yield message
        lost: Counter[str] = Counter()
        with suppress(sqlite3.Error):  # what the table has and this pass has not come to
            counts = self._table.counts
            for number in wanted:
                lost[self._topics[number][0]] += max(counts[number] - found[number], 0)
        if +lost:
            self.report(f"{recording.lost_text(+lost)} cannot be found", +lost)

    def _tell(self, fault: Fault) -> None:
        """Report what could not be read of the table."""
        time = recording.time_text(fault.time_ns) if isinstance(fault.time_ns, int) else None
        if fault.topic is not None:
            name = self._topics[fault.topic][0]
            why = "it is beyond log.chunk_max_mb" if "too big" in fault.error else fault.error
            when = time or "an unknown time"
            self.report(f"one message on {name} at {when} is lost: {why}", {name: 1})
        else:
            when = f"after {time}" if time else "at first"
            rest = "what followed" if fault.is_end else "some of what followed"
            self.report(f"{fault.error} {when}: {rest} is lost")

    def _message(self, number: int, time_ns: object, data: object) -> recording.Message | None:
        """The message in a row of the table; None, and reported, when there is none."""
        name, kind = self._topics[number]
        fault = "the row of a message does not hold one"
        if isinstance(time_ns, int) and isinstance(data, bytes):
            unpacked = Unpacked(data, complete=True)
            if data.startswith(MAGIC["zstd"]):  # rosbag2's compression of single messages
                unpacked = decompress(data, "zstd", self.chunk_max)
            if unpacked.complete:
                return recording.Message(name, kind, time_ns, unpacked.data)
            fault = f"a message at {recording.time_text(time_ns)} is {unpacked.fault}"
        self.report(f"{fault}: one on {name} is lost", {name: 1})
        return None

    def close(self) -> None:
        """Release the file."""
        self._db.close()


_LAST_ROW = (1 << 63) - 1  # SQLite numbers its rows in 64 bits, with a sign


class Row(NamedTuple):
    """A message as it is stored; a damaged file may hold values of any type."""

    topic: int
    time_ns: object
    data: object


class Fault(NamedTuple):
    """What could not be read behind a time (None: at first).

    `topic` is that of the one message that is lost; None when nobody knows which ones are.
    """

    error: str
    time_ns: object
    topic: int | None = None
    is_end: bool = False


class _Place(NamedTuple):
    """A message among the others: its time and its row."""

    time_ns: object
    row: int


@dataclass(frozen=True, slots=True)
class Rows:
    """The messages of some topics, by time or in the order of recording."""

    db: sqlite3.Connection
    topics: list[int]
    by_time: bool

    def __iter__(self) -> Iterator[Row | Fault]:
        """The rows, and a fault in the place of each that cannot be read."""
        place: _Place | None = None
        while True:
            before = place
            try:
                columns = "timestamp, rowid, topic_id, data"
                for row in self.db.execute(*self._query(columns, place)):
                    place = _Place(*row[:2])
                    yield Row(row[2], row[0], row[3])
                return
            except sqlite3.Error as error:  # Python asks ahead: a sound row may come first
                found, place = self._single(place, str(error))
            if found is not None:
                yield found
            if place is None or (not self.by_time and place.row == _LAST_ROW):
                return
            if before is not None:  # in a damaged table rows may lead back, round and round
                now, then = (
                    (time if self.by_time and isinstance(time, int) else 0, row)
                    for time, row in (place, before)
                )
                if now <= then:
                    return

    def _single(self, place: _Place | None, error: str) -> tuple[Row | Fault | None, _Place | None]:
        """The row behind a place read on its own, and from where to go on: None for nowhere."""
        try:
            key = self._first("timestamp, rowid, topic_id", place)
        except sqlite3.Error:
            time = place.time_ns if place is not None else None
            behind = None if self.by_time else self._readable(place.row if place else 0)
            return Fault(error, time, is_end=behind is None), behind
        if key is None:
            return None, None
        time, row, topic = key
        try:
            query = "SELECT data FROM messages NOT INDEXED WHERE rowid = ?"
            found = self.db.execute(query, (row,)).fetchone()
        except sqlite3.Error as fault:
            found, error = None, str(fault)
        if found is None:  # a damaged table leads elsewhere by the number of the row
            return Fault(error, time, topic), _Place(time, row)
        return Row(topic, time, found[0]), _Place(time, row)

    def _readable(self, last: int) -> _Place | None:
        """The first place after row `last` that can be read, by steps that double, then halving."""

        def can_go_on(row: int) -> bool:
            try:
                self._first("topic_id", _Place(None, row))
            except sqlite3.Error:
                return False
            return True

        step = 1
        while last + step < _LAST_ROW and not can_go_on(last + step):
            step *= 2
        if last + step >= _LAST_ROW:
            return None
        tried = range(last + step // 2 + 1, last + step)
        return _Place(None, tried.start + bisect_left(tried, True, key=can_go_on))

    def _first(self, columns: str, behind: _Place | None) -> tuple[Any, ...] | None:
        query, values = self._query(columns, behind)
        row: tuple[Any, ...] | None = self.db.execute(f"{query} LIMIT 1", values).fetchone()
        return row

    def _query(self, columns: str, behind: _Place | None) -> tuple[str, list[object]]:
        """The query for what comes behind a place, in order."""
        topics = ", ".join("?" * len(self.topics))
        query = f"SELECT {columns} FROM messages WHERE topic_id IN ({topics})"
        values: list[object] = [*self.topics]
        if behind is not None and self.by_time:
            query, values = f"{query} AND (timestamp, rowid) > (?, ?)", [*values, *behind]
        elif behind is not None:  # not by >, which would look into the page of `behind`
            query, values = f"{query} AND rowid >= ?", [*values, behind.row + 1]
        return f"{query} ORDER BY {'timestamp, rowid' if self.by_time else 'rowid'}", values
