"""`specmap check`: exit codes, files for a CI, and what it refuses."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

from specmap_cli.core.process import peak_memory_mb
from tests.cli.conftest import Run


def test_a_good_map_keeps_the_rules(tiny_map: Path, run: Run) -> None:
    told = run("check", tiny_map, "--json").result
    assert told["passed"]
    assert told["figures"]["scans"] == 61
    assert told["figures"]["memory_mb"] > 10
    assert told["figures"]["scans_per_s"] > 0


def test_a_broken_rule_is_exit_code_5(tiny_map: Path, tmp_path: Path, run: Run) -> None:
    rules = tmp_path / "rules.toml"
    rules.write_text("[least]\nsubmaps = 40\n")
    junit, markdown = tmp_path / "check.xml", tmp_path / "check.md"
    line = ("check", tiny_map, "--rules", rules, "--junit", junit, "--markdown", markdown)
    said = run(*line)
    assert said.code == 5
    assert said.out.splitlines()[-1].endswith(": submaps")
    assert ElementTree.parse(junit).getroot()[0].get("failures") == "1"
    assert "**broken** | submaps | 1 |" in markdown.read_text()
    assert run(*line).error == f"{junit}: exists already: choose another name or say --overwrite"
    assert run(*line, "--overwrite").code == 5


def test_a_golden_map_is_another_map_s_measure(tiny_map: Path, tmp_path: Path, run: Run) -> None:
    told = run("check", tiny_map, "--against", tiny_map, "--json").result
    assert (told["figures"]["golden.same_share"], told["figures"]["golden.gone"]) == (1, 0)
    rules = {one["rule"] for one in told["rules"]}
    assert {"golden.aligned", "golden.area_share", "golden.closed", "golden.off_m"} <= rules
    assert run("check", tiny_map, "--against", tmp_path).code == 3


def test_memory_is_that_of_this_process() -> None:
    before = peak_memory_mb()
    held = bytearray(150_000_000)
    after = peak_memory_mb()
    assert before is not None
    assert after is not None
    assert len(held) / 1e6 * 0.5 < after < 100_000
