"""Summaries of a batch: the tables read back, and the page with its links, also in a browser."""

from __future__ import annotations

import csv
import io
import re
from pathlib import Path
from xml.etree import ElementTree

import pytest

from specmap_cli.batch.records import JobRecord
from specmap_cli.batch.summaries import (
    COLUMNS,
    Row,
    as_csv,
    as_html,
    as_junit,
    as_markdown,
    as_parquet,
    headline,
    rows_of,
)
from tests.batch.results import failed, result, warned
from tests.report.browser import Browser, installed


def rows_for(*records: JobRecord, waiting: str = "") -> list[Row]:
    known = {one.name: one for one in records}
    return rows_of([*known, *waiting], known)


@pytest.fixture
def rows() -> list[Row]:
    poor = result("c", figures={"verdict": "poor", "scans": 10, "lost_share": 0.64})
    bad = failed("b", reason='no scans | in "b"\x1b, <none>')
    return rows_for(result("a"), bad, poor, waiting="d")


def test_csv_says_what_is_known(rows: list[Row]) -> None:
    read = list(csv.DictReader(io.StringIO(as_csv(rows).decode())))
    assert list(read[0]) == [column.name for column in COLUMNS]
    assert [row["state"] for row in read] == ["done", "failed", "done", "waiting"]
    assert read[0] == {
        **dict.fromkeys(("kind", "reason", "warnings"), ""),
        **{"name": "a", "state": "done", "verdict": "good", "lost_share": "0.0125"},
        **{"submaps": "7", "area_m2": "123.46", "path_m": "45.68", "scans": "900"},
        **{"scans_per_s": "50.0", "wall_s": "18.0", "memory_mb": "300.5", "attempts": "1"},
        "digest": "d" * 64,
    }


def test_parquet_says_the_same_with_types(rows: list[Row]) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    table = parquet.read_table(io.BytesIO(as_parquet(rows)))
    assert table.to_pylist() == [dict(row) for row in rows]
    assert str(table.schema.field("scans").type) == "int64"
    assert str(table.schema.field("lost_share").type) == "double"


def test_markdown_names_what_failed_and_what_is_doubtful(rows: list[Row]) -> None:
    text = as_markdown(rows).decode()
    assert text.startswith("### 2 of 4 jobs done, 1 failed, 1 waiting\n")
    assert "- 910 scans over 46 m in 54 s of work\n- maps: 1 good, 1 poor\n" in text
    assert '| b | log | no scans \\| in "b"\\\\x1b, \\<none\\> | 1 |' in text
    assert "| c | poor | 0.64 |  |" in text
    assert "\n| d |" not in text, "a job that waits took no time"


def test_markdown_of_many_failures_is_short_and_tells_of_warnings_once() -> None:
    text = as_markdown(rows_for(*(failed(f"{k:03}") for k in range(100)))).decode()
    assert "... and 80 more: see summary.csv" in text
    assert text.count("holds no scans") == 20
    text = as_markdown(rows_for(warned("a", "cut | off"), result("b"))).decode()
    assert "#### Warnings\n\n| name | warnings |\n|---|---|\n| a | cut \\| off |\n" in text
    good = rows_for(*map(result, "abc"))
    assert [headline(good), headline(good[:1])] == ["All 3 jobs done", "1 job done"]


def test_junit_is_a_test_a_job(rows: list[Row]) -> None:
    suite = ElementTree.fromstring(as_junit(rows)).find("testsuite")
    assert suite is not None
    assert [suite.get(name) for name in ("tests", "failures", "skipped")] == ["4", "1", "1"]
    failure = suite.find("testcase[@name='b']/failure")
    assert failure is not None
    assert failure.get("type") == "log"


def page(*records: JobRecord, waiting: str = "") -> str:
    rows = rows_for(*records, waiting=waiting)
    return as_html(rows, {one.name: one for one in records}).decode()


def links(text: str) -> set[str]:
    """What a page links and shows."""
    return set(re.findall(r'<[^>]* (?:href|src)="([^"]*)"', text))


def test_the_page_links_what_there_is_and_needs_no_other_file() -> None:
    text = page(result("a"), failed("b"), waiting="c")
    of_a = {f"a/{name}" for name in ("map/overview.png", "report.html", "log.txt", "map/")}
    assert links(text) == of_a | {"b/log.txt"}
    assert "default-src 'none'" in text


def test_what_needs_somebody_stands_first_with_what_to_do() -> None:
    text = page(result("a"), failed("z"), waiting="b")
    assert re.findall('<tr data-name="(.)"', text) == ["z", "a", "b"]
    assert text.count("What to do:") == 1
    assert "see what `specmap info --check` says of the recording" in text


def test_names_reasons_and_warnings_are_text() -> None:
    text = page(result("50% #1?"), failed("b", reason="<script>alert(1)</script>"))
    assert "<script>alert" not in text
    assert "50%25%20%231%3F/report.html" in links(text)
    assert '<p class="reason">cut &lt;off&gt;; late</p>' in page(warned("a", "cut <off>", "late"))
    assert 'class="reason"' not in page(result("a"))
    assert len(page(*(result(f"{k:04}") for k in range(1000)))) < 3e6, "few megabytes of many jobs"


@pytest.mark.skipif(installed() is None, reason="needs a Chromium")
def test_in_a_browser_the_page_is_searched_and_sorted(tmp_path: Path) -> None:
    file = tmp_path / "index.html"
    slow = result("corridor", wall_s=99.0)
    file.write_text(page(slow, result("lobby"), failed("lab")), encoding="utf-8")
    program = installed()
    assert program is not None
    names = (
        "[...document.querySelectorAll('#jobs tbody tr:not([hidden])')].map(r => r.dataset.name)"
    )
    with Browser(program) as browser:
        browser.open(file)
        browser.run(
            "const s = document.querySelector('#sought'); s.value = 'L';"
            "s.dispatchEvent(new Event('input'))"
        )
        assert browser.run(names) == ["lab", "lobby"]
        browser.run("s.value = ''; s.dispatchEvent(new Event('input'))")
        browser.run("document.querySelectorAll('#jobs thead button')[7].click()")
        assert browser.run(names) == ["lab", "lobby", "corridor"]
        missing = "ERR_FILE_NOT_FOUND"  # the pictures of these jobs
        assert [error for error in browser.errors if missing not in error] == []
