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
    run("report", tiny_map, "-o", target).fails(2, "--overwrite")
    again = run("report", tiny_map, "-o", target, "--overwrite", "--compare", tiny_map, "--json")
    assert json.loads(again.out) == {
        "schema_version": 1,
        "map": str(tiny_map),
        "compare": str(tiny_map),
        "out": str(target),
        "submaps": 1,
        "bytes": target.stat().st_size,
    }
