"""Summaries of a batch, read back."""

from __future__ import annotations

import csv
import io
import json
from xml.etree import ElementTree

import jsonschema
import pytest

from specmap_cli.batch import events
from specmap_cli.batch.dispatch import Finished, Quiet, Retried, Started, Turn
from specmap_cli.batch.ledger import Ledger
from specmap_cli.batch.tables import (
    COLUMNS,
    Row,
    as_csv,
    as_junit,
    as_markdown,
    as_parquet,
    headline,
    row_of,
)
from specmap_cli.core.schemas import read_schema
from tests.batch.results import failed, job, result, warned


@pytest.fixture
def rows() -> list[Row]:
    poor = result("c", figures={"verdict": "poor", "scans": 10, "lost_share": 0.64})
    bad = failed("b", reason='no scans | in "b"\x1b, <none>')
    known = {one.name: one for one in (result("a"), bad, poor)}
    return [row_of(name, known.get(name)) for name in "abcd"]


def test_csv_says_what_is_known(rows: list[Row]) -> None:
    read = list(csv.DictReader(io.StringIO(as_csv(rows).decode())))
    assert list(read[0]) == [column.name for column in COLUMNS]
    assert [row["state"] for row in read] == ["done", "failed", "done", "waiting"]
    assert read[0] | {"digest": ""} == {
        "name": "a",
        "state": "done",
        "kind": "",
        "reason": "",
        "verdict": "good",
        "lost_share": "0.0125",
        "submaps": "7",
        "area_m2": "123.46",
        "path_m": "45.68",
        "scans": "900",
        "scans_per_s": "50.0",
        "wall_s": "18.0",
        "memory_mb": "300.5",
        "attempts": "1",
        "warnings": "",
        "digest": "",
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


def test_markdown_of_many_failures_is_short() -> None:
    many = [row_of(f"{k:03}", failed(f"{k:03}")) for k in range(100)]
    text = as_markdown(many).decode()
    assert "... and 80 more: see summary.csv" in text
    assert text.count("holds no scans") == 20


def test_markdown_tells_of_warnings_once_though_every_step_warned() -> None:
    text = as_markdown([row_of("a", warned("a", "cut | off")), row_of("b", result("b"))]).decode()
    assert "#### Warnings\n\n| name | warnings |\n|---|---|\n| a | cut \\| off |\n" in text


def test_junit_is_a_test_a_job(rows: list[Row]) -> None:
    suite = ElementTree.fromstring(as_junit(rows)).find("testsuite")
    assert suite is not None
    assert {name: suite.get(name) for name in ("tests", "failures", "skipped")} == {
        "tests": "4",
        "failures": "1",
        "skipped": "1",
    }
    failure = suite.find("testcase[@name='b']/failure")
    assert failure is not None
    assert failure.get("type") == "log"


def test_headline_of_a_batch_that_went_well() -> None:
    good = [row_of(name, result(name)) for name in "abc"]
    assert headline(good) == "All 3 jobs done"
    assert headline(good[:1]) == "1 job done"


class TestEvents:
    def told(self) -> list[events.EventRecord]:
        ledger = Ledger([job(name) for name in "abc"], dict.fromkeys("abc", 1))
        lost = failed("b", "worker", attempts=1)
        heard = [
            ledger.began(),
            ledger.heard(Started(Turn(job("b")))),
            ledger.heard(Retried(Turn(job("b")), lost)),
            ledger.heard(Finished(result("a"))),
            ledger.heard(Finished(result("c", resumed=True))),
            *(ledger.heard(Quiet(slots)) for slots in (2, 0, 0, 1, 0)),
            ledger.heard(Finished(failed("b", attempts=2))),
            ledger.ended(),
        ]
        return [one for one in heard if one is not None]

    def test_every_line_fits_the_schema(self) -> None:
        schema = read_schema("batch")
        for event in self.told():
            jsonschema.validate(json.loads(event.line()), schema)
            assert event.line().count("\n") == 1

    def test_they_say_what_happened_in_order(self) -> None:
        told = [(one.event, one.job, one.attempt, one.done, one.failed) for one in self.told()]
        assert told == [
            ("began", None, None, 0, 0),
            ("started", "b", 1, 0, 0),
            ("retried", "b", 1, 0, 0),
            ("done", "a", 1, 1, 0),
            ("resumed", "c", 1, 2, 0),
            *[("stranded", None, None, 2, 0)] * 2,
            ("failed", "b", 2, 2, 1),
            ("ended", None, None, 2, 1),
        ]
