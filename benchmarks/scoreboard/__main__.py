"""Every figure of this tree.

    python -m benchmarks.scoreboard                      all of it: the page is written anew
    python -m benchmarks.scoreboard --quick              what tells most in eight minutes; no page
    python -m benchmarks.scoreboard --only cold          a section, with its details; no page
    python -m benchmarks.scoreboard --only cold.iou      a row
    python -m benchmarks.scoreboard --compare OLD.json   what got better and worse since a page

What was measured of this tree is kept in `.scoreboard` and not measured again: a run that was
stopped goes on where it was. `--again` measures anew.
"""

from __future__ import annotations

import argparse
import shutil
import sys
from pathlib import Path

from benchmarks.scoreboard import page
from benchmarks.scoreboard.digest import ROOT
from benchmarks.scoreboard.rows import Section
from benchmarks.scoreboard.running import Done, folder_of, measure, read, rows_of, run
from benchmarks.scoreboard.sections import SECTIONS


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", nargs="+", metavar="SECTION[.ROW]", help="these alone")
    parser.add_argument("--quick", action="store_true", help="the quick sections")
    parser.add_argument("--list", action="store_true", help="name the sections and their rows")
    parser.add_argument(
        "--compare", type=Path, metavar="OLD.json", help="hold the page against one"
    )
    parser.add_argument("--state", action="store_true", help="is the page of this tree?")
    parser.add_argument("--again", action="store_true", help="forget what was measured")
    parser.add_argument("--work", type=Path, default=ROOT / ".scoreboard", help="folder to work in")
    parser.add_argument("--section", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.state:
        print(page.state())
        return 0
    if given.compare is not None:
        return _compare(given.compare)
    named = {section.name: section for section in SECTIONS}
    if given.section:
        measure(named[given.section], given.work)
        return 0
    if given.list:
        for section in SECTIONS:
            print(f"{section.name}: {section.title}")
            for row in rows_of(section):
                print(f"    {section.name}.{row.key:24} {row.title}")
        return 0
    if given.only:
        return _only(given.only, named, given.work, given.again)
    sections = [section for section in SECTIONS if section.quick or not given.quick]
    return _all(sections, given.work, given.again, write=not given.quick)


def _only(names: list[str], named: dict[str, Section], work: Path, again: bool) -> int:
    """Some sections or rows, with the details."""
    folder, failed = folder_of(work), False
    for name in names:
        section_name, _, key = name.partition(".")
        section = named.get(section_name)
        if section is None or key not in {"", *(row.key for row in rows_of(section))}:
            print(f"no section or row {name}: see --list", file=sys.stderr)
            return 2
        done = None if again or not key else read(section, folder)
        done = done or measure(section, folder)
        failed |= bool(done.why)
        print("\n".join(_told(section, done, key)))
    return int(failed)


def _told(section: Section, done: Done, key: str = "") -> list[str]:
    """The rows of a section for reading."""
    if done.why:
        return [f"{section.name}: {done.why}"]
    lines = []
    for row in rows_of(section):
        if key in ("", row.key):
            one = done.figures[row.key]
            bars = "" if row.must is None else f"  must {row.text(row.must)}"
            bars += "" if row.aim is None else f", aim {row.text(row.aim)}"
            note = f"  ({one.note})" if one.note else ""
            name = f"{section.name}.{row.key}"
            lines.append(f"{name:40} {row.text(one.value):>12}{bars}  {row.title}{note}")
    return lines


def _all(sections: list[Section], work: Path, again: bool, *, write: bool) -> int:
    """Measure the sections, print all rows, and write the page."""
    if again:
        shutil.rmtree(work, ignore_errors=True)
    folder = folder_of(work)
    done = run(sections, folder)
    for section in sections:
        print("\n".join(_told(section, done[section.name])))
    failed = [name for name, each in done.items() if each.why.startswith("failed")]
    if failed:
        print(f"failed: {', '.join(failed)}; no page is written", file=sys.stderr)
        return 1
    if write:
        before = page.read(page.JSON)
        made = page.page_of(SECTIONS, done, before)
        page.JSON.write_text(page.json_text(made), encoding="utf-8")
        page.MARKDOWN.write_text(page.markdown(made), encoding="utf-8")
        print(f"the page is in {page.MARKDOWN.relative_to(ROOT)}")
        if before is not None:
            print("\n".join(page.compared(before, made)))
    return 0


def _compare(old: Path) -> int:
    mine, other = page.read(page.JSON), page.read(old)
    if mine is None or other is None:
        print(f"no page in {old if other is None else page.JSON}", file=sys.stderr)
        return 2
    print("\n".join(page.compared(other, mine)) or "nothing changed")
    return 0


if __name__ == "__main__":
    sys.exit(main())
