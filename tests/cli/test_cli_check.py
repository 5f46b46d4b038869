"""The verdict on a map: `specmap check`, its exit codes and files for a CI, and that of a build."""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree

import pytest

from specmap_cli.core.process import peak_memory_mb
from specmap_cli.maps.store import read_map
from tests.cli.conftest import QUICK, Run
from tests.turning import turn


def test_a_good_map_keeps_the_rules(tiny_map: Path, tmp_path: Path, run: Run) -> None:
    """And a golden one is another map's measure."""
    told = run("check", tiny_map, "--against", tiny_map, "--json").result
    figures = told["figures"]
    assert told["passed"]
    assert figures["scans"] == 61
    assert figures["memory_mb"] > 10
    assert figures["scans_per_s"] > 0
    assert (figures["golden.same_share"], figures["golden.gone"]) == (1, 0)
    rules = {one["rule"] for one in told["rules"]}
    assert {"golden.aligned", "golden.area_share", "golden.closed", "golden.off_m"} <= rules
    assert run("check", tiny_map, "--against", tmp_path).code == 3


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


@pytest.mark.parametrize(
    ("doubtful", "failing", "code"),
    [(False, "doubtful", 0), (True, "poor", 0), (True, "doubtful", 5)],
)
def test_a_build_can_fail_on_its_verdict(
    run: Run, tiny_log: Path, tmp_path: Path, doubtful: bool, failing: str, code: int
) -> None:
    out = tmp_path / "map"
    if doubtful:
        turn("quality", odometry_share=0.0001)  # it has to agree to a tenth of a millimetre a metre
    outcome = run("build", tiny_log, "-o", out, *QUICK, "--fail-on", failing, "--json")
    assert outcome.code == code
    told = json.loads(outcome.out)["quality"]
    assert told["verdict"] == ("doubtful" if doubtful else "good")
    stored = read_map(out).record.graph.quality
    assert stored is not None
    assert stored.as_dict() == told  # the map is there in any case


def test_doubts_come_first_and_are_warned_of(run: Run, tiny_log: Path, tmp_path: Path) -> None:
    out = tmp_path / "map"
    turn("quality", odometry_share=0.0001)
    run("build", tiny_log, "--fail-on", "good", "-o", out).fails(2, "'doubtful', 'poor'")
    outcome = run("build", tiny_log, "-o", out, *QUICK)
    assert outcome.code == 0, "nobody asked it to fail"
    first = outcome.out.splitlines()[0]
    assert first.startswith(f"{out}: this map is doubtful: odometry and the map disagree by ")
    warned = first.removeprefix(f"{out}: this map is doubtful: ")
    assert f"specmap: warning: {warned}" in outcome.err.splitlines()
    assert warned in read_map(out).run["warnings"]
    assert "quality: good" not in outcome.out
    quiet = run("build", tiny_log, "-o", out, *QUICK, "--overwrite", "-q")
    assert (quiet.out.splitlines()[0], quiet.err) == (first, "")


def test_memory_is_that_of_this_process() -> None:
    before = peak_memory_mb()
    held = bytearray(150_000_000)
    after = peak_memory_mb()
    assert before is not None
    assert after is not None
    assert len(held) / 1e6 * 0.5 < after < 100_000
