"""The index of a batch: one page that links to what came of every job."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from urllib.parse import quote

from specmap_cli.batch.records import JobRecord
from specmap_cli.batch.steps import LOG_TEXT, MAP, REPORT
from specmap_cli.batch.tables import Row, headline, kinds_of, total
from specmap_cli.report import words
from specmap_cli.report.colours import tones
from specmap_cli.report.pouring import page_parts, poured

_PACKAGE = "specmap_cli.batch"
_SCRIPTS = ("core.js", "tables.js", "batch.js")
_STYLES = ("page.css", "parts.css", "batch.css", "print.css")
_FILTERS = ("lasting", "percent", "figure")
_KM = 1000.0
_OVERVIEW = f"{MAP}/overview.png"
# Heads of the table: their words, and how the column is sorted.
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


@dataclass(frozen=True, slots=True)
class Entry:
    """A row of the page: what is known of a job, and where its files are; None: there is none."""

    row: Row
    picture: str | None
    report: str | None
    log: str | None
    folder: str | None

    @property
    def result(self) -> str:
        """The verdict on the map of a job that is done, else its state."""
        state = str(self.row["state"])
        return str(self.row["verdict"] or state) if state == "done" else state


def as_html(rows: Sequence[Row], records: Mapping[str, JobRecord]) -> bytes:
    """The page; links go to the folders beside it."""
    entries = [_entry(row, records.get(str(row["name"]))) for row in rows]
    context = {
        "title": headline(rows),
        "entries": entries,
        "results": sorted({entry.result for entry in entries}),
        "heads": _HEADS,
        "kinds": kinds_of(rows),
        "facts": _facts(rows),
        "tones": tones([]),
        "data": {},
        **page_parts(_PACKAGE, _SCRIPTS, _STYLES),
    }
    filters = {name: getattr(words, name) for name in _FILTERS}
    return poured(_PACKAGE, "batch.html", context, filters).encode()


def _entry(row: Row, record: JobRecord | None) -> Entry:
    files = set() if record is None else set(record.files)
    base = quote(str(row["name"]), safe="")
    found = {name: f"{base}/{quote(name)}" for name in (_OVERVIEW, REPORT, LOG_TEXT)}
    picture, report, log = (link if name in files else None for name, link in found.items())
    has_map = any(name.startswith(f"{MAP}/") for name in files)
    return Entry(row, picture, report, log, f"{base}/{MAP}/" if has_map else None)


def _facts(rows: Sequence[Row]) -> list[tuple[str, str]]:
    """The figures over the table: what, and how much."""
    done = sum(row["state"] == "done" for row in rows)
    return [
        ("done", f"{done:,}"),
        ("failed", f"{sum(count for _, count in kinds_of(rows)):,}"),
        ("doubtful or poor", f"{sum(row['verdict'] in ('doubtful', 'poor') for row in rows):,}"),
        ("scans", f"{total(rows, 'scans'):,.0f}"),
        ("driven", _distance(total(rows, "path_m"))),
        ("of work", words.lasting(total(rows, "wall_s"))),
    ]


def _distance(metres: float) -> str:
    return f"{metres:,.0f} m" if metres < _KM else f"{metres / _KM:,.1f} km"
