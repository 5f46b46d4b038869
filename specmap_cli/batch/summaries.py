"""The summaries of a batch: what they say of a job, as tables and as a page that links the results.

The tables are CSV, Parquet, Markdown and JUnit XML.
"""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Literal
from urllib.parse import quote

from specmap_cli.batch.records import LOG_TEXT, MAP, REPORT, JobRecord, Kind
from specmap_cli.core.text import Case, counted, csv_text, junit, markdown_table, markdown_text
from specmap_cli.report.html import html_page, lasting, tones

INDEX = "index.html"
WAITING = "waiting"
_MOST = 20  # rows of a table that a person reads
_PACKAGE = "specmap_cli.batch"
_SCRIPTS = ("core.js", "tables.js", "batch.js")
_STYLES = ("page.css", "parts.css", "batch.css", "print.css")
_KM = 1000.0
_OVERVIEW = f"{MAP}/overview.png"
# Heads of the table of the page: their words, and how the column is sorted.
_HEADS = (
    ("job", "text"),
    ("result", "text"),
    ("lost", "number"),
    ("submaps", "number"),
    ("m²", "number"),
    ("scans", "number"),
    ("scans/s", "number"),
    ("time", "number"),
    ("MB", "number"),
    ("tries", "number"),
)
# What to do about a job that failed, by the kind of its failure.
_ADVICE: Mapping[Kind, str] = {
    "log": "see what `specmap info --check` says of the recording",
    "no-result": "see what `specmap info` says of the recording: its scans do not fit together",
    "rule": "look at the report; change the rule if the map is right",
    "settings": "mend the option, and run the batch again",
    "memory": "run the batch again with a larger --memory-limit",
    "time": "run the batch again with a larger --time-limit",
    "place": "make room, or bring the store within reach, and run the batch again",
    "worker": "run the batch again: its worker was lost",
    "bug": "report it, with the file log",
}
_FIRST = ("failed", "poor", "doubtful")  # results that somebody must look at, above all others

Value = str | int | float | None
Row = Mapping[str, Value]


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


def _warnings(record: JobRecord) -> Value:
    """What the steps warned of, each once."""
    said = dict.fromkeys(each for step in record.steps for each in step.warnings)
    return "; ".join(said) or None


# The columns: the type of their values, and where they come from; docs/batch.md has their meaning.
COLUMNS: Mapping[str, tuple[Literal["text", "whole", "real"], Callable[[JobRecord], Value]]] = {
    "name": ("text", lambda one: one.name),
    "state": ("text", lambda one: one.state),
    "kind": ("text", lambda one: one.kind),
    "reason": ("text", lambda one: one.reason),
    "verdict": ("text", _figure("verdict")),
    "lost_share": ("real", _figure("lost_share", 4)),
    "submaps": ("whole", _figure("submaps", 0)),
    "area_m2": ("real", _figure("area_m2", 2)),
    "path_m": ("real", _figure("path_m", 2)),
    "scans": ("whole", _figure("scans", 0)),
    "scans_per_s": ("real", _scans_per_s),
    "wall_s": ("real", lambda one: round(one.wall_s, 2)),
    "memory_mb": ("real", lambda one: one.memory_mb and round(one.memory_mb, 1)),
    "attempts": ("whole", lambda one: one.attempts),
    "warnings": ("text", _warnings),
    "digest": ("text", lambda one: one.digest),
}


def rows_of(names: Iterable[str], records: Mapping[str, JobRecord]) -> list[Row]:
    """A row of the summary for each job, in order of names.

    Of a job without a record it has the name and that it waits.
    """
    rows: list[Row] = []
    for name in sorted(names):
        row: dict[str, Value] = {"name": name, "state": WAITING}
        for column, (_, value_in) in COLUMNS.items():
            row[column] = value_in(records[name]) if name in records else row.get(column)
        rows.append(row)
    return rows


def as_csv(rows: Sequence[Row]) -> bytes:
    """A line a job under the names of the columns; empty where nothing is known."""
    text = csv_text(list(COLUMNS), ([row[name] for name in COLUMNS] for row in rows))
    return text.encode("utf-8", "backslashreplace")


def as_parquet(rows: Sequence[Row]) -> bytes:
    """The same as a Parquet file; null where nothing is known."""
    import pyarrow as pa
    from pyarrow import parquet

    types = {"text": pa.string(), "whole": pa.int64(), "real": pa.float64()}
    schema = pa.schema([(name, types[kind]) for name, (kind, _) in COLUMNS.items()])
    kept = io.BytesIO()
    parquet.write_table(pa.Table.from_pylist([dict(row) for row in rows], schema), kept)
    return kept.getvalue()


def as_markdown(rows: Sequence[Row]) -> bytes:
    """A page for a person: totals, what failed and why, what is doubtful, what took longest."""
    failed = [row for row in rows if row["state"] == "failed"]
    doubtful = [row for row in rows if row["verdict"] in ("doubtful", "poor")]
    worked = [row for row in rows if row["wall_s"] is not None]
    slowest = sorted(worked, key=lambda row: -float(row["wall_s"] or 0.0))[:5]
    verdicts = Counter(row["verdict"] for row in rows if row["verdict"] is not None)
    of_maps = ", ".join(f"{verdicts[one]:,} {one}" for one in sorted(verdicts))
    of_failures = ", ".join(f"{count:,} {kind}" for kind, count in kinds_of(rows))
    lines = [
        f"### {headline(rows)}",
        "",
        f"- {total(rows, 'scans'):,.0f} scans over {total(rows, 'path_m'):,.0f} m in "
        f"{lasting(total(rows, 'wall_s'))} of work",
        *([f"- maps: {of_maps}"] if of_maps else []),
        *([f"- failures: {of_failures}"] if of_failures else []),
        "",
        *_section("Failed", failed, ("name", "kind", "reason", "attempts")),
        *_section("Doubtful or poor", doubtful, ("name", "verdict", "lost_share", "submaps")),
        *_section("Warnings", [row for row in rows if row["warnings"]], ("name", "warnings")),
        *_section("Slowest", slowest, ("name", "wall_s", "scans", "scans_per_s", "memory_mb")),
    ]
    return "\n".join([*lines, ""]).encode("utf-8", "backslashreplace")


def as_junit(rows: Sequence[Row]) -> bytes:
    """A test suite with a test case a job; one that waits is skipped."""
    cases = [
        Case(
            name=str(row["name"]),
            seconds=float(row["wall_s"] or 0.0),
            skipped=row["state"] == WAITING,
            failure=str(row["reason"]) if row["state"] == "failed" else None,
            kind=str(row["kind"]),
        )
        for row in rows
    ]
    return junit("specmap batch", "specmap batch", cases)


def headline(rows: Sequence[Row]) -> str:
    """How a batch went, in a line."""
    states = Counter(row["state"] for row in rows)
    if not states["failed"] and not states[WAITING]:
        return f"All {counted(len(rows), 'job')} done" if len(rows) > 1 else "1 job done"
    said = [f"{states['done']:,} of {counted(len(rows), 'job')} done"]
    said += [f"{states['failed']:,} failed"] if states["failed"] else []
    said += [f"{states[WAITING]:,} waiting"] if states[WAITING] else []
    return ", ".join(said)


def kinds_of(rows: Sequence[Row]) -> list[tuple[str, int]]:
    """The kinds of failure and how often, the most frequent first."""
    counts = Counter(str(row["kind"]) for row in rows if row["state"] == "failed")
    return sorted(counts.items(), key=lambda one: (-one[1], one[0]))


def total(rows: Sequence[Row], column: str) -> float:
    """The sum of a column; what is not known counts nothing."""
    return sum(float(row[column] or 0.0) for row in rows)


def _section(title: str, rows: Sequence[Row], columns: Sequence[str]) -> list[str]:
    if not rows:
        return []

    def shown(value: Value) -> str:
        text = f"{value:,}" if isinstance(value, int | float) else value
        return markdown_text(text or "")

    more = [f"... and {len(rows) - _MOST:,} more: see summary.csv", ""] if rows[_MOST:] else []
    heads = {column: column.replace("_", " ") for column in columns}
    table = markdown_table(
        list(heads.values()),
        ([shown(row[column]) for column in columns] for row in rows[:_MOST]),
        {head for column, head in heads.items() if COLUMNS[column][0] != "text"},
    )
    return [f"#### {title}", "", *table, "", *more]


def as_html(rows: Sequence[Row], records: Mapping[str, JobRecord]) -> bytes:
    """The page, what failed first; links go to the folders beside it."""
    entries = []
    for row in rows:
        record = records.get(str(row["name"]))
        base, files = quote(str(row["name"]), safe=""), {} if record is None else record.files
        has_map = any(name.startswith(f"{MAP}/") for name in files)
        entry: dict[str, Any] = {
            "row": row,
            "result": (row["state"] == "done" and row["verdict"]) or row["state"],
            "folder": f"{base}/{MAP}/" if has_map else None,
            "advice": _ADVICE[record.kind] if record is not None and record.kind else None,
        }
        for part, name in (("picture", _OVERVIEW), ("report", REPORT), ("log", LOG_TEXT)):
            entry[part] = f"{base}/{quote(name)}" if name in files else None
        entries.append(entry)
    ranks = {result: rank for rank, result in enumerate(_FIRST)}
    entries.sort(key=lambda entry: ranks.get(entry["result"], len(ranks)))  # then by name
    states, verdicts = (Counter(row[column] for row in rows) for column in ("state", "verdict"))
    metres = total(rows, "path_m")
    context = {
        "title": headline(rows),
        "entries": entries,
        "results": sorted({entry["result"] for entry in entries}),
        "heads": _HEADS,
        "kinds": kinds_of(rows),
        "facts": [  # over the table: what, and how much
            ("done", f"{states['done']:,}"),
            ("failed", f"{states['failed']:,}"),
            ("doubtful or poor", f"{verdicts['doubtful'] + verdicts['poor']:,}"),
            ("scans", f"{total(rows, 'scans'):,.0f}"),
            ("driven", f"{metres:,.0f} m" if metres < _KM else f"{metres / _KM:,.1f} km"),
            ("of work", lasting(total(rows, "wall_s"))),
        ],
        "tones": tones([]),
        "data": {},
    }
    return html_page(_PACKAGE, "batch.html", context, _STYLES, _SCRIPTS).encode()


_MADE: Mapping[str, Callable[[Sequence[Row]], bytes]] = {
    "summary.csv": as_csv,
    "summary.parquet": as_parquet,
    "summary.md": as_markdown,
    "junit.xml": as_junit,
}
SUMMARIES = (*_MADE, INDEX)


def summaries_of(names: Iterable[str], records: Mapping[str, JobRecord]) -> dict[str, bytes]:
    """The contents of all summaries by their file names; `names` are those of all jobs."""
    rows = rows_of(names, records)
    return {name: made(rows) for name, made in _MADE.items()} | {INDEX: as_html(rows, records)}
