"""Figures of the small house under rules, the comparison with a golden map, and the reports."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import jsonschema
import pytest

from specmap_cli.checking.record import CheckRecord, OutcomeRecord, junit, lines_of, markdown
from specmap_cli.checking.rules import Rules, figures_against, figures_of, judged, read_rules
from specmap_cli.core.findings import VERDICTS, Verdict
from specmap_cli.core.schemas import read_schema
from specmap_cli.maps.store import read_map
from specmap_cli.maps.writing import MapResult, write_map
from specmap_cli.pipelines.check import check_map
from tests.comparisons import comparison, thing, way

RUN = {"wall_s": 4.0, "memory_mb": 200.0, "counts": {"scans": 80, "lost": 2, "breaks": 1}}
FINDING: dict[str, Any] = {
    **{"code": "walls-disagree", "severity": "doubtful", "advice": ""},
    **{"message": "near (1, 2) the walls | are *twice*"},
    **{"value": 0.3, "limit": None, "where": None},
}

House = Callable[..., Path]


@pytest.fixture
def house(tmp_path: Path, result: MapResult) -> House:
    """The map of the house with this run.json, this many links, and this verdict and findings."""

    def make(
        run: dict[str, Any] = RUN,
        *,
        edges: int = 2,
        verdict: str | None = "good",
        findings: tuple[dict[str, Any], ...] = (),
    ) -> Path:
        out = tmp_path / "house"
        out.mkdir()
        write_map(out, result)
        written = json.loads((out / "run.json").read_text())
        (out / "run.json").write_text(json.dumps({**written, **run}))
        document = json.loads((out / "topology.json").read_text())
        quality = {"verdict": verdict, "findings": findings}
        document["graph"]["quality"] = None if verdict is None else quality
        document["edges"] = document["edges"][:edges]
        (out / "topology.json").write_text(json.dumps(document))
        return out

    return make


def broken(path: Path, rules: Rules) -> dict[str, OutcomeRecord]:
    return {one.rule: one for one in check_map(path, rules).record.rules if not one.passed}


def test_the_figures_are_those_of_the_map(house: House) -> None:
    figures = figures_of(read_map(house()))
    assert figures["lost_share"] == pytest.approx(2 / 80)
    assert figures["scans_per_s"] == pytest.approx(20.0)
    assert (figures["breaks"], figures["memory_mb"]) == (1, 200.0)
    assert (figures["submaps"], figures["edges"], figures["parts"]) == (3, 2, 1)
    assert figures["duration_s"] == pytest.approx(29.0)
    assert figures["area_m2"] is not None
    assert figures["area_m2"] > 10.0


def test_a_figure_that_is_not_known_breaks_its_rule(house: House) -> None:
    path = house({"wall_s": "soon", "memory_mb": None, "counts": {"scans": "many", "lost": 2}})
    rules = Rules("poor", {"lost_share": 1, "memory_mb": 1e9, "breaks": 9}, {"scans_per_s": 0})
    for _ in range(2):
        found = broken(path, rules)
        assert list(found) == ["lost_share", "memory_mb", "breaks", "scans_per_s"]
        assert found["breaks"].detail == "not known: the map does not say"
        (path / "run.json").unlink(missing_ok=True)


def test_bounds_are_kept_up_to_their_value(house: House) -> None:
    path = house(edges=1)
    kept = Rules("poor", {"submaps": 3, "lost_share": 0.025}, {"submaps": 3})
    assert broken(path, kept) == {}
    low = Rules("poor", {"submaps": 2.9, "lost_share": 0.024}, {})
    assert list(broken(path, low)) == ["submaps", "lost_share"]
    assert list(broken(path, Rules("poor", {}, {"submaps": 3.1}))) == ["submaps"]
    assert list(broken(path, read_rules(None, against=False))) == ["parts"], "no link joins them"


@pytest.mark.parametrize("verdict", ["good", "doubtful", "poor", None])
def test_the_verdict_has_a_worst(house: House, verdict: Verdict | None) -> None:
    """A map that nobody judged is as bad as can be."""
    path = house(verdict=verdict)
    for worst in VERDICTS:
        passes = VERDICTS.index(verdict or "poor") <= VERDICTS.index(worst)
        assert check_map(path, Rules(worst, {}, {})).passed == passes, worst


def test_findings_are_counted_by_their_code_unless_they_are_notes(house: House) -> None:
    note = {**FINDING, "severity": "note", "code": "loose-part"}
    poor = {**FINDING, "severity": "poor", "message": "worse"}
    path = house(verdict="poor", findings=(note, FINDING, poor))
    found = broken(path, read_rules(None, against=False))
    assert set(found) == {"verdict", "findings.walls-disagree"}
    assert found["findings.walls-disagree"].value == 2
    assert found["findings.walls-disagree"].detail == "worse (and 1 more)"
    assert found["verdict"].detail == "walls-disagree"


def test_what_differs_from_a_golden_map_is_counted() -> None:
    """A room, a way and half of the floor are gone."""
    same = [{"old": id_, "new": id_, "iou": 1.0} for id_ in (0, 1)]
    submaps, appeared = {"same": same, "gone": [2]}, [thing(0.0, 0.0, 0.75)]
    record = comparison(submaps=submaps, closed=[way(1.0, 1.0)], appeared=appeared)
    figures = figures_against(record)
    assert (figures["golden.gone"], figures["golden.closed"]) == (1, 1)
    assert figures["golden.area_share"] == pytest.approx(0.5)
    assert figures["golden.same_share"] == pytest.approx(2 / 3)
    assert figures["golden.appeared_m2"] == pytest.approx(0.75)
    unknown = figures_against(None)
    assert (unknown["golden.aligned"], unknown["golden.gone"]) == (0, None)


def spoiled_record() -> CheckRecord:
    figures = {"lost_share": 0.251234, "submaps": 3, "parts": None}
    rules = Rules("good", {"lost_share": 0.05, "parts": 1}, {"submaps": 2})
    details = {"lost_share": FINDING["message"], "verdict": "<b> & \x01\x07"}
    return judged("maps/one", None, figures, "doubtful", rules, details)


def test_a_table_for_a_person() -> None:
    assert lines_of(spoiled_record()) == [
        "  BROKEN  verdict     doubtful  <= good  <b> & \\x01\\x07",
        "  BROKEN  lost_share    0.2512  <= 0.05  near (1, 2) the walls | are *twice*",
        "  BROKEN  parts        unknown  <= 1  not known: the map does not say",
        "  ok      submaps            3  >= 2",
        "maps/one: breaks 3 of 4 rules: verdict, lost_share, parts",
    ]


def test_junit_that_a_ci_reads() -> None:
    root = ElementTree.fromstring(junit(spoiled_record()))
    (suite,) = root
    assert (root.tag, suite.tag) == ("testsuites", "testsuite")
    assert (suite.get("tests"), suite.get("failures"), suite.get("errors")) == ("4", "3", "0")
    cases = {case.get("name"): case for case in suite}
    assert [case.get("name") for case in suite if case.find("failure") is None] == ["submaps >= 2"]
    failure = cases["lost_share <= 0.05"].find("failure")
    assert failure is not None
    assert failure.get("message") == "lost_share is 0.2512, allowed is <= 0.05"
    assert failure.text == FINDING["message"]


def test_markdown_keeps_a_name_in_its_cell_and_a_record_is_as_its_schema_says() -> None:
    lines = markdown(spoiled_record()).splitlines()
    assert lines[0].startswith("### maps/one: breaks 3 of 4 rules")
    rows = [line for line in lines if line.startswith("| **broken**") or line.startswith("| ok")]
    assert len(rows) == 4
    assert rows[-1].startswith("| ok | submaps | 3 | \\>= 2 |")
    assert "the walls \\| are \\*twice\\*" in rows[1]
    jsonschema.validate(json.loads(spoiled_record().model_dump_json()), read_schema("check"))
