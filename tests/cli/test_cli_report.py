"""`specmap report` as a person runs it."""

from __future__ import annotations

import json
from pathlib import Path

from tests.cli.conftest import Run


def test_a_map_becomes_a_page(run: Run, tiny_map: Path, tmp_path: Path) -> None:
    target = tmp_path / "tiny.html"
    outcome = run("report", tiny_map, "-o", target)
    assert outcome.code == 0
    assert outcome.out.startswith(f"{target}: 0.")
    assert target.read_text(encoding="utf-8").startswith("<!doctype html>")
    assert run("report", tiny_map, "-o", target).code == 2
    assert run("report", tiny_map, "-o", target, "--overwrite").code == 0


def test_the_result_for_a_machine(run: Run, tiny_map: Path, tmp_path: Path) -> None:
    target = tmp_path / "tiny.html"
    outcome = run("report", tiny_map, "-o", target, "--compare", tiny_map, "--json")
    assert json.loads(outcome.out) == {
        "schema_version": 1,
        "map": str(tiny_map),
        "compare": str(tiny_map),
        "out": str(target),
        "submaps": 1,
        "bytes": target.stat().st_size,
    }


def test_the_map_stays_as_it_is(run: Run, own_map: Path) -> None:
    outcome = run("report", own_map, "-o", own_map / "run.json", "--overwrite")
    assert outcome.code == 2
    assert "would replace the input" in outcome.error


def test_what_is_no_map_is_refused_in_one_line(run: Run, tmp_path: Path) -> None:
    outcome = run("report", tmp_path / "nothing", "-o", tmp_path / "page.html")
    assert outcome.code == 3
    assert "no such map directory" in outcome.error
    assert not (tmp_path / "page.html").exists()
