"""`specmap evaluate`: what it prints for machines, and requests that are not clear."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import pytest

from tests.cli.conftest import QUICK, Run

SAMPLES = Path(__file__).parents[2] / "sample_logs"


def test_a_hold_out_is_one_object_and_a_picture(tiny_log: Path, tmp_path: Path, run: Run) -> None:
    picture = tmp_path / "confusion.png"
    line = ("evaluate", tiny_log, "--protocol", "holdout", "--share", "0.3", *QUICK)
    found = run(*line, "--json", "--confusion", picture, "-q").result
    for part in ("train", "test"):
        assert found[part].keys() >= {"recall", "precision", "scans"}
        assert found[part]["scans"] > 0
        assert 0.0 <= found[part]["recall"] <= 1.0
    assert sum(row["scans"] for row in found["submaps"]) == found["test"]["scans"]
    assert cv2.imread(str(picture)) is not None
    lines = run(*line, "-q").out.splitlines()
    assert [text.split()[0] for text in lines[:4]][1:] == ["training", "held-out", "held-out,"]
    assert len(lines) > 6


def test_a_trajectory_against_a_reference(run: Run) -> None:
    truth = SAMPLES / "office_again.tum"
    found = run("evaluate", "--trajectory", truth, "--reference", truth, "--json").result
    assert found["matched"] == found["total"] > 2000
    assert found["ate_m"] == pytest.approx(0.0, abs=1e-6)
    assert set(found["relative"]) == {"1", "5", "20"}


def test_a_trajectory_against_relations(tmp_path: Path, run: Run) -> None:
    tum, relations = tmp_path / "a.tum", tmp_path / "a.relations"
    tum.write_text("1 0 0 0 0 0 0 1\n2 1 0 0 0 0 0 1\n")
    relations.write_text("1 2 1.5 0 0 0 0 0\n")
    said = run("evaluate", "--trajectory", tum, "--relations", relations, "--json")
    assert json.loads(said.out)["translation_m"]["mean"] == pytest.approx(0.5)
    assert "1 of 1 relations" in run("evaluate", "--trajectory", tum, "--relations", relations).out


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("a.mcap", "--protocol", "holdout", "--trajectory", "a.tum"), "one thing only"),
        (("--protocol", "holdout"), "needs one log"),
        (("a.mcap", "b.mcap", "--protocol", "revisit"), "--reference twice"),
        (("a.mcap", "b.mcap", "--baseline", "room-hallway"), "--rooms once"),
        (("--trajectory", "a.tum"), "one of --relations"),
    ],
)
def test_what_is_not_clear_is_asked(arguments: tuple[str, ...], told: str, run: Run) -> None:
    run("evaluate", *arguments).fails(2, told)
