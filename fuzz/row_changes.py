"""Mutations of the rows of rosbag2's SQLite files."""

from __future__ import annotations

import random
import sqlite3
from typing import Any

from fuzz.changes import Change

_VALUES: tuple[Any, ...] = (
    None,
    0,
    -1,
    1 << 62,
    -(1 << 63),
    1e300,
    float("inf"),
    "",
    "text",
    "\x1b[31mred\x07\n",
    b"",
    b"\x00",
    b"\x28\xb5\x2f\xfd" + bytes(20),  # as one message compressed with zstd begins
)
_COLUMNS = {
    "messages": ("id", "topic_id", "timestamp", "data"),
    "topics": ("id", "name", "type", "serialization_format"),
}
_SCHEMAS = (
    "DROP INDEX IF EXISTS timestamp_idx",
    "DROP TABLE topics",
    "ALTER TABLE messages RENAME COLUMN data TO payload",
    "ALTER TABLE messages RENAME TO others",
    "DELETE FROM topics",
    "CREATE TABLE extra(id INTEGER)",
)


def change_rows(rng: random.Random, data: bytes) -> Change:
    """A cell with another value, a row dropped or repeated, or another schema."""
    db = sqlite3.connect(":memory:")
    try:
        db.deserialize(data)
        kind = rng.random()
        if kind < 0.1:
            statement, clean = rng.choice(_SCHEMAS), False
            db.execute(statement)
            note = statement
        elif kind < 0.25:
            note, clean = _rows(rng, db), True
        else:
            note, clean = _cell(rng, db), False
        db.commit()
        return Change(db.serialize(), note, clean)
    except sqlite3.Error as error:
        return Change(data, f"SQLite refused: {error}")
    finally:
        db.close()


def _rows(rng: random.Random, db: sqlite3.Connection) -> str:
    number = rng.randrange(1, 25)
    if rng.random() < 0.5:
        db.execute("DELETE FROM messages WHERE id = ?", (number,))
        return f"message {number} deleted"
    db.execute(
        "INSERT INTO messages(topic_id, timestamp, data) "
        "SELECT topic_id, timestamp, data FROM messages WHERE id = ?",
        (number,),
    )
    return f"message {number} twice"


def _cell(rng: random.Random, db: sqlite3.Connection) -> str:
    """A cell of any type: SQLite does not hold to those of its columns."""
    table = rng.choice(["messages", "messages", "topics"])
    column, value = rng.choice(_COLUMNS[table]), rng.choice(_VALUES)
    number = rng.randrange(1, 25 if table == "messages" else 4)
    db.execute("PRAGMA ignore_check_constraints = ON")
    db.execute("PRAGMA writable_schema = ON")
    db.execute(f"UPDATE {table} SET {column} = ? WHERE id = ?", (value, number))
    return f"{table}.{column} of row {number} = {value!r}"
