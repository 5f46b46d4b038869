"""The rows of the table of messages of a rosbag2 file, also when parts of it cannot be read."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from typing import Any, NamedTuple

_ROWS_END = 1 << 63  # SQLite numbers its rows in 64 bits


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


class Rows:
    """The messages of some topics, by time or in the order of recording."""

    def __init__(self, db: sqlite3.Connection, topics: list[int], by_time: bool) -> None:
        self._db = db
        self._topics = topics
        self._by_time = by_time

    def __iter__(self) -> Iterator[Row | Fault]:
        """The rows, and a fault in the place of each that cannot be read."""
        place: _Place | None = None
        while True:
            before = place
            try:
                columns = "timestamp, rowid, topic_id, data"
                for row in self._db.execute(*self._query(columns, place)):
                    place = _Place(*row[:2])
                    yield Row(row[2], row[0], row[3])
                return
            except sqlite3.Error as error:  # Python asks ahead: a sound row may come first
                found, place = self._single(place, str(error))
            if found is not None:
                yield found
            if place is None or not self._is_behind(place, before):
                return

    def _is_behind(self, place: _Place, other: _Place | None) -> bool:
        """Whether a place comes later: in a damaged table rows may lead back, round and round."""
        if other is None:
            return True
        if not self._by_time:
            return place.row > other.row
        times = [time if isinstance(time, int) else 0 for time in (place.time_ns, other.time_ns)]
        return (times[0], place.row) > (times[1], other.row)

    def _single(self, place: _Place | None, error: str) -> tuple[Row | Fault | None, _Place | None]:
        """The row behind a place read on its own, and from where to go on: None for nowhere."""
        try:
            key = self._first("timestamp, rowid, topic_id", place)
        except sqlite3.Error:
            time = place.time_ns if place is not None else None
            behind = None if self._by_time else self._readable(place.row if place else 0)
            return Fault(error, time, is_end=behind is None), behind
        if key is None:
            return None, None
        time, row, topic = key
        try:
            query = "SELECT data FROM messages NOT INDEXED WHERE rowid = ?"
            found = self._db.execute(query, (row,)).fetchone()
        except sqlite3.Error as fault:
            return Fault(str(fault), time, topic), _Place(time, row)
        if found is None:  # a damaged table leads elsewhere by the number of the row
            return Fault(error, time, topic), _Place(time, row)
        return Row(topic, time, found[0]), _Place(time, row)

    def _readable(self, last: int) -> _Place | None:
        """The first place behind the rows after `last` that cannot be read; None when all cannot.

        Steps double until one leads out of the damage; halving finds where it ends.
        """
        step = 1
        while not self._can_go_on(last + step):
            step *= 2
            if last + step >= _ROWS_END:
                return None
        fails, works = step // 2, step
        while works - fails > 1:
            middle = (fails + works) // 2
            if self._can_go_on(last + middle):
                works = middle
            else:
                fails = middle
        return _Place(None, last + works)

    def _can_go_on(self, row: int) -> bool:
        """Whether what follows a row can be read."""
        try:
            self._first("topic_id", _Place(None, row))
        except sqlite3.Error:
            return False
        return True

    def _first(self, columns: str, behind: _Place | None) -> tuple[Any, ...] | None:
        query, values = self._query(columns, behind)
        row: tuple[Any, ...] | None = self._db.execute(f"{query} LIMIT 1", values).fetchone()
        return row

    def _query(self, columns: str, behind: _Place | None) -> tuple[str, list[object]]:
        """The query for what comes behind a place, in order."""
        topics = ", ".join("?" * len(self._topics))
        query = f"SELECT {columns} FROM messages WHERE topic_id IN ({topics})"
        values: list[object] = [*self._topics]
        if behind is not None and self._by_time:
            query, values = f"{query} AND (timestamp, rowid) > (?, ?)", [*values, *behind]
        elif behind is not None:  # not by >, which would look into the page of `behind`
            query, values = f"{query} AND rowid >= ?", [*values, behind.row + 1]
        return f"{query} ORDER BY {'timestamp, rowid' if self._by_time else 'rowid'}", values
