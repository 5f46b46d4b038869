"""The verdict on a map as the command line tells it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from specmap_cli.maps.store import read_map
from tests.cli.conftest import QUICK, Run
from tests.turning import turn


def doubting() -> None:
    """Odometry has to agree with the map to a tenth of a millimetre a metre."""
    turn("quality", odometry_share=0.0001)


@pytest.mark.parametrize(
    ("doubtful", "failing", "code"),
    [(False, "doubtful", 0), (True, "poor", 0), (True, "doubtful", 5)],
)
def test_a_build_can_fail_on_its_verdict(
    run: Run, tiny_log: Path, tmp_path: Path, doubtful: bool, failing: str, code: int
) -> None:
    out = tmp_path / "map"
    if doubtful:
        doubting()
    outcome = run("build", tiny_log, "-o", out, *QUICK, "--fail-on", failing, "--json")
    assert outcome.code == code
    told = json.loads(outcome.out)["quality"]
    assert told["verdict"] == ("doubtful" if doubtful else "good")
    stored = read_map(out).record.graph.quality
    assert stored is not None
    assert stored.as_dict() == told  # the map is there in any case


def test_other_verdicts_cannot_be_asked_for(run: Run, tmp_path: Path) -> None:
    line = ("build", "no.mcap", "--fail-on", "good", "-o", tmp_path / "map")
    run(*line).fails(2, "'doubtful', 'poor'")


def test_doubts_come_first_and_are_warned_of(run: Run, tiny_log: Path, tmp_path: Path) -> None:
    out = tmp_path / "map"
    doubting()
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
