"""The summary of a batch as tables: CSV, Parquet, Markdown and JUnit XML."""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Sequence
from xml.etree import ElementTree

from specmap_cli.batch.columns import COLUMNS, WAITING, Row
from specmap_cli.checking.reports import cell, xml_text
from specmap_cli.core.text import counted
from specmap_cli.report.words import lasting

_MOST = 20  # rows of a table that a person reads


def as_csv(rows: Sequence[Row]) -> bytes:
    """A line a job under the names of the columns; empty where nothing is known."""
    text = io.StringIO()
    writer = csv.DictWriter(text, [column.name for column in COLUMNS], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue().encode("utf-8", "backslashreplace")


def as_parquet(rows: Sequence[Row]) -> bytes:
    """The same as a Parquet file; null where nothing is known."""
    import pyarrow as pa
    from pyarrow import parquet

    types = {"text": pa.string(), "whole": pa.int64(), "real": pa.float64()}
    schema = pa.schema([(column.name, types[column.type]) for column in COLUMNS])
    kept = io.BytesIO()
    parquet.write_table(pa.Table.from_pylist([dict(row) for row in rows], schema), kept)
    return kept.getvalue()


def as_markdown(rows: Sequence[Row]) -> bytes:
    """A page for a person: totals, what failed and why, what is doubtful, what took longest."""
    failed = [row for row in rows if row["state"] == "failed"]
    doubtful = [row for row in rows if row["verdict"] in ("doubtful", "poor")]
    worked = [row for row in rows if row["wall_s"] is not None]
    slowest = sorted(worked, key=lambda row: -float(row["wall_s"] or 0.0))[:5]
    lines = [
        f"### {headline(rows)}",
        "",
        *_totals(rows),
        *_section("Failed", failed, ("name", "kind", "reason", "attempts")),
        *_section("Doubtful or poor", doubtful, ("name", "verdict", "lost_share", "submaps")),
        *_section("Warnings", [row for row in rows if row["warnings"]], ("name", "warnings")),
        *_section("Slowest", slowest, ("name", "wall_s", "scans", "scans_per_s", "memory_mb")),
    ]
    return "\n".join([*lines, ""]).encode("utf-8", "backslashreplace")


def as_junit(rows: Sequence[Row]) -> bytes:
    """A test suite with a test case a job; one that waits is skipped."""
    states = Counter(row["state"] for row in rows)
    suite = ElementTree.Element(
        "testsuite",
        name="specmap batch",
        tests=str(len(rows)),
        failures=str(states["failed"]),
        errors="0",
        skipped=str(states[WAITING]),
        time=f"{sum(float(row['wall_s'] or 0.0) for row in rows):.3f}",
    )
    for row in rows:
        suite.append(_case(row))
    root = ElementTree.Element("testsuites")
    root.append(suite)
    ElementTree.indent(root)
    return bytes(ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)) + b"\n"


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


def _totals(rows: Sequence[Row]) -> list[str]:
    verdicts = Counter(row["verdict"] for row in rows if row["verdict"] is not None)
    said = [
        f"{total(rows, 'scans'):,.0f} scans over {total(rows, 'path_m'):,.0f} m in "
        f"{lasting(total(rows, 'wall_s'))} of work"
    ]
    if verdicts:
        said.append("maps: " + ", ".join(f"{verdicts[one]:,} {one}" for one in sorted(verdicts)))
    if kinds := kinds_of(rows):
        said.append("failures: " + ", ".join(f"{count:,} {kind}" for kind, count in kinds))
    return [*(f"- {line}" for line in said), ""]


def _section(title: str, rows: Sequence[Row], columns: Sequence[str]) -> list[str]:
    if not rows:
        return []
    known = {column.name: column.type for column in COLUMNS}
    more = [f"... and {len(rows) - _MOST:,} more: see summary.csv", ""] if rows[_MOST:] else []
    return [
        f"#### {title}",
        "",
        "| " + " | ".join(column.replace("_", " ") for column in columns) + " |",
        "|" + "".join("---|" if known[column] == "text" else "---:|" for column in columns),
        *(
            "| " + " | ".join(cell(str(_shown(row, column))) for column in columns) + " |"
            for row in rows[:_MOST]
        ),
        "",
        *more,
    ]


def _shown(row: Row, column: str) -> str:
    value = row[column]
    return "" if value is None else f"{value:,}" if isinstance(value, int | float) else value


def _case(row: Row) -> ElementTree.Element:
    case = ElementTree.Element(
        "testcase",
        classname="specmap batch",
        name=xml_text(str(row["name"])),
        time=f"{float(row['wall_s'] or 0.0):.3f}",
    )
    if row["state"] == "failed":
        told = xml_text(str(row["reason"]))
        ElementTree.SubElement(case, "failure", message=told, type=str(row["kind"]))
    elif row["state"] == WAITING:
        ElementTree.SubElement(case, "skipped")
    return case
