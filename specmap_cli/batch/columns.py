"""What the summaries of a batch say of a job: the columns, in their order."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

from specmap_cli.batch.records import JobRecord

Value = str | int | float | None
Row = Mapping[str, Value]


@dataclass(frozen=True, slots=True)
class Column:
    """A column: its name, the type of its values, what they mean, and where they come from."""

    name: str
    type: Literal["text", "whole", "real"]
    meaning: str
    of: Callable[[JobRecord], Value]


def _figure(name: str, places: int | None = None) -> Callable[[JobRecord], Value]:
    """A figure of the map; whole numbers for 0 places."""

    def of(record: JobRecord) -> Value:
        value = record.figures.get(name)
        if value is None or isinstance(value, str) or places is None:
            return value
        return round(value) if places == 0 else round(value, places)

    return of


def _scans_per_s(record: JobRecord) -> Value:
    """Scans in each second of the attempt, all of its steps counted."""
    scans = record.figures.get("scans")
    return round(scans / record.wall_s, 1) if isinstance(scans, int | float) and scans else None


def _memory(record: JobRecord) -> Value:
    return None if record.memory_mb is None else round(record.memory_mb, 1)


def _warnings(record: JobRecord) -> Value:
    """What the steps warned of, each once."""
    said = dict.fromkeys(each for step in record.steps for each in step.warnings)
    return "; ".join(said) or None


COLUMNS = (
    Column("name", "text", "of the job and of its folder", lambda one: one.name),
    Column("state", "text", "done, failed, or waiting", lambda one: one.state),
    Column("kind", "text", "what kind of failure; see docs/batch.md", lambda one: one.kind),
    Column("reason", "text", "why it failed", lambda one: one.reason),
    Column("verdict", "text", "on the map: good, doubtful or poor", _figure("verdict")),
    Column("lost_share", "real", "share of the scans that were lost", _figure("lost_share", 4)),
    Column("submaps", "whole", "submaps of the map", _figure("submaps", 0)),
    Column("area_m2", "real", "square metres of floor", _figure("area_m2", 2)),
    Column("path_m", "real", "metres driven", _figure("path_m", 2)),
    Column("scans", "whole", "scans that were read", _figure("scans", 0)),
    Column("scans_per_s", "real", "scans in each second of the job", _scans_per_s),
    Column("wall_s", "real", "seconds that the job took", lambda one: round(one.wall_s, 2)),
    Column("memory_mb", "real", "most megabytes that a step held", _memory),
    Column("attempts", "whole", "how many times it was tried", lambda one: one.attempts),
    Column("warnings", "text", "what its steps warned of", _warnings),
    Column("digest", "text", "SHA-256 of all that decides the result", lambda one: one.digest),
)
WAITING = "waiting"


def row_of(name: str, record: JobRecord | None) -> Row:
    """A row of the summary; of a job without a result its name and that it waits."""
    if record is None:
        row: dict[str, Value] = dict.fromkeys((column.name for column in COLUMNS), None)
        return row | {"name": name, "state": WAITING}
    return {column.name: column.of(record) for column in COLUMNS}
