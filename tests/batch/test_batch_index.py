"""The index of a batch: what it links, what it escapes, and its table in a browser."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path

import pytest

from specmap_cli.batch.index import as_html
from specmap_cli.batch.records import JobResult
from specmap_cli.batch.tables import row_of
from tests.batch.results import failed, result, warned
from tests.report.browser import Browser, installed


def page(*results: JobResult, waiting: tuple[str, ...] = ()) -> str:
    known = {one.name: one for one in results}
    rows = [row_of(name, known.get(name)) for name in sorted([*known, *waiting])]
    return as_html(rows, known).decode()


class Links(HTMLParser):
    """What a page links and shows."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        target = given.get("href") if tag == "a" else given.get("src")
        if target:
            self.found.append(target)


def test_it_links_what_there_is() -> None:
    found = set(Links(page(result("a"), failed("b"), waiting=("c",))).found)
    assert found == {"a/map/overview.png", "a/report.html", "a/log.txt", "a/map/", "b/log.txt"}


def test_names_and_reasons_are_text() -> None:
    text = page(result("50% #1?"), failed("b", reason="<script>alert(1)</script>"))
    assert "<script>alert" not in text
    assert "50%25%20%231%3F/report.html" in Links(text).found


def test_a_warning_stands_under_the_result() -> None:
    assert '<p class="reason">cut &lt;off&gt;; late</p>' in page(warned("a", "cut <off>", "late"))
    assert 'class="reason"' not in page(result("a"))


def test_it_needs_no_other_file_and_runs_no_other_script() -> None:
    text = page(result("a"))
    assert not any("://" in link for link in Links(text).found)
    assert "default-src 'none'" in text


def test_a_thousand_jobs_are_a_page_of_few_megabytes() -> None:
    assert len(page(*(result(f"{k:04}") for k in range(1000)))) < 3e6


@pytest.mark.skipif(installed() is None, reason="needs a Chromium")
def test_in_a_browser_it_is_searched_and_sorted(tmp_path: Path) -> None:
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
