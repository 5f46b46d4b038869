"""The page: scoreboard.json for programs, docs/scoreboard.md for people, and two pages compared."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from datetime import date
from pathlib import Path
from typing import Any

from benchmarks.scoreboard.digest import ROOT, digest
from benchmarks.scoreboard.rows import Figure, Row, Section
from benchmarks.scoreboard.running import Done, rows_of

JSON = ROOT / "benchmarks" / "scoreboard.json"
MARKDOWN = ROOT / "docs" / "scoreboard.md"

Page = dict[str, Any]
_ROW = ("must", "aim", "better", "form", "unit", "others", "title")

_HEAD = """# Scoreboard
Every figure of this project, measured on one tree by one command: `make scoreboard`. Real
recordings come first. A figure stands here and nowhere else.

- *must* is the bar of a row and *aim* the ambition. A row without them is told, not judged.
  **Bold** figures keep their bar.
- *before* is the figure of the page before this one. Where a row was repeated, its figure is the
  median, and the least and the largest stand behind it.
- The command under a heading measures its rows again and prints the details that are behind them:
  floors, recordings, cases. [benchmarks/README.md](../benchmarks/README.md) names the data.
"""


def read(path: Path) -> Page | None:
    """A page as it was written, None where there is none."""
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else None


def state() -> str:
    """One line: whether the page is of this tree."""
    page = read(JSON)
    if page is None:
        return "scoreboard: there is no page yet: `make scoreboard` makes it"
    if page["digest"] != digest():
        return (
            f"scoreboard: the page is of another tree ({page['digest']}, {page['made']}): its "
            "figures may not hold here; `make scoreboard` makes it anew"
        )
    return f"scoreboard: the page is of this tree ({page['made']})"


def page_of(sections: Sequence[Section], done: Mapping[str, Done], before: Page | None) -> Page:
    """The page of some sections; `before` is the page that it takes the place of."""
    mine = digest()
    again = before is not None and before["digest"] == mine
    old = {} if before is None else dict(figures_in(before, "before" if again else "value"))
    return {
        "digest": mine,
        "made": date.today().isoformat(),
        "machine": {
            "processors": os.cpu_count(),
            "processor": _processor(),
            "python": platform.python_version(),
        },
        "seconds": round(sum(each.seconds for each in done.values())),
        "sections": [_section(section, done[section.name], old) for section in sections],
    }


def _processor() -> str:
    lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def _section(section: Section, found: Done, old: Mapping[str, Any]) -> Page:
    rows = []
    for row in rows_of(section):
        one = found.figures.get(row.key, Figure(None))
        kept = {"key": row.key, **asdict(one), "before": old.get(f"{section.name}.{row.key}")}
        rows.append(kept | {name: getattr(row, name) for name in _ROW})
    return {
        "name": section.name,
        "title": section.title,
        "command": f"python -m benchmarks.scoreboard --only {section.name}",
        "seconds": round(found.seconds),
        "why": found.why,
        "rows": rows,
    }


def figures_in(page: Page, what: str = "value") -> Iterator[tuple[str, Any]]:
    """The figures of a page by section and row: `cold.iou`."""
    for section in page["sections"]:
        for row in section["rows"]:
            yield f"{section['name']}.{row['key']}", row[what]


def json_text(page: Page) -> str:
    """The page as it is kept."""
    return json.dumps(page, indent=1, ensure_ascii=False) + "\n"


def markdown(page: Page) -> str:
    """The page for reading."""
    machine = page["machine"]
    lines = [
        _HEAD,
        f"Made on {page['made']} of the tree `{page['digest']}`, Python {machine['python']}, on "
        f"{machine['processors']} processors ({machine['processor']}).",
    ]
    for section in page["sections"]:
        lines += ["", f"## {section['title']}"]
        lines += [
            f"`{section['command']}`" + (f" ({section['why']})" if section["why"] else ""),
            "",
        ]
        lines += [
            "| row | figure | must | aim | before | others |",
            "|---|---:|---:|---:|---:|---|",
        ]
        lines += [_line(row) for row in section["rows"]]
    return "\n".join(lines) + "\n"


def _line(kept: Page) -> str:
    row = row_in(kept)
    shown = row.text(kept["value"])
    if kept["value"] is not None and row.must is not None and row.reaches(kept["value"], row.must):
        shown = f"**{shown}**"
    if kept["low"] is not None and row.text(kept["low"]) != row.text(kept["high"]):
        shown += f" ({kept['low']:{row.form}} to {kept['high']:{row.form}})"
    if kept["note"]:
        shown += f"; {kept['note']}"
    bars = [row.text(bar) if bar is not None else "" for bar in (row.must, row.aim)]
    before = row.text(kept["before"])
    cells = [row.title, shown, *bars, before if before != "-" else "", row.others]
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def row_in(kept: Page) -> Row:
    """The row of a page that was read."""
    return Row(key=kept["key"], **{name: kept[name] for name in _ROW})


def compared(old: Page, new: Page) -> list[str]:
    """What got better and worse from one page to another, beyond what repeats show."""
    there = {
        f"{section['name']}.{row['key']}": row
        for section in old["sections"]
        for row in section["rows"]
    }
    lines: dict[str, list[str]] = {"worse": [], "better": [], "gone": [], "new": []}
    for section in new["sections"]:
        for kept in section["rows"]:
            name, row = f"{section['name']}.{kept['key']}", row_in(kept)
            other = there.pop(name, None)
            if other is None or other["value"] is None or kept["value"] is None:
                _tell_of_one(lines, name, row, other, kept)
            elif row.better != "none" and (way := _way(row, other, kept)):
                told = f"{row.text(other['value'])} -> {row.text(kept['value'])}"
                lines[way].append(f"{name:40} {told:24} {row.title}")
    lines["gone"] += [f"{name:40} {row['title']}" for name, row in there.items()]
    return [line for way, some in lines.items() if some for line in (f"{way}:", *some)]


def _tell_of_one(
    lines: dict[str, list[str]], name: str, row: Row, other: Page | None, kept: Page
) -> None:
    """A row that only one of the pages has a figure for."""
    before = None if other is None else other["value"]
    if before is None and kept["value"] is not None:
        lines["new"].append(f"{name:40} {row.text(kept['value']):24} {row.title}")
    elif before is not None:
        lines["gone"].append(f"{name:40} {row.text(before):24} {row.title}")


def _way(row: Row, old: Page, new: Page) -> str:
    """`better` or `worse`; nothing for what repeats of either page reach, or as it is printed."""
    if row.text(old["value"]) == row.text(new["value"]):
        return ""
    (least, most), (now_least, now_most) = (
        (kept["value"], kept["value"]) if kept["low"] is None else (kept["low"], kept["high"])
        for kept in (old, new)
    )
    if now_least <= most and least <= now_most:
        return ""
    more = new["value"] > old["value"]
    return "better" if more == (row.better == "more") else "worse"
