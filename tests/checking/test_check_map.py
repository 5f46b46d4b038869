"""Files of rules; figures of the small house under rules, against a golden map; the reports."""

import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import Mock
from xml.etree import ElementTree

import jsonschema
import pytest

from specmap_cli.checking.rules import (
    BOUNDED,
    DEFAULTS,
    FINDINGS,
    GOLDEN,
    CheckRecord,
    OutcomeRecord,
    Rules,
    figures_against,
    figures_of,
    judged,
    junit,
    lines_of,
    markdown,
    read_rules,
)
from specmap_cli.core.errors import NoResultError, UsageError
from specmap_cli.core.findings import INPUT, VERDICTS, Verdict
from specmap_cli.core.schemas import read_schema
from specmap_cli.maps.store import read_map
from specmap_cli.pipelines.check import check_map
from specmap_cli.quality import findings, holes, odometry
from tests.comparisons import comparison, thing, way
from tests.flats import forget_digests

RUN = {"wall_s": 4.0, "memory_mb": 200.0, "counts": {"scans": 80, "lost": 2, "breaks": 1}}
FINDING: dict[str, Any] = {
    **{"code": "walls-disagree", "severity": "doubtful", "advice": ""},
    **{"message": "near (1, 2) the walls | are *twice*"},
    **{"value": 0.3, "limit": None, "where": None},
}

House = Callable[..., Path]


@pytest.fixture
def changed(house: Path) -> House:
    """The map of the house with this run.json, this many links, and this verdict and findings."""

    def change(
        run: dict[str, Any] = RUN,
        *,
        edges: int = 2,
        verdict: str | None = "good",
        findings: tuple[dict[str, Any], ...] = (),
    ) -> Path:
        written = json.loads((house / "run.json").read_text())
        (house / "run.json").write_text(json.dumps({**written, **run}))
        document = json.loads((house / "topology.json").read_text())
        quality = {"verdict": verdict, "findings": findings}
        document["graph"]["quality"] = None if verdict is None else quality
        document["edges"] = document["edges"][:edges]
        (house / "topology.json").write_text(json.dumps(document))
        return house

    return change


def broken(path: Path, rules: Rules) -> dict[str, OutcomeRecord]:
    return {one.rule: one for one in check_map(path, rules).rules if not one.passed}


def test_the_figures_are_those_of_the_map(changed: House) -> None:
    figures = figures_of(read_map(changed()))
    assert figures["lost_share"] == pytest.approx(2 / 80)
    assert figures["scans_per_s"] == pytest.approx(20.0)
    assert (figures["breaks"], figures["memory_mb"]) == (1, 200.0)
    assert (figures["submaps"], figures["edges"], figures["parts"]) == (3, 2, 1)
    assert figures["duration_s"] == pytest.approx(29.0)
    assert figures["area_m2"] is not None
    assert figures["area_m2"] > 10.0


@pytest.mark.parametrize("damage", [0, 2])
def test_a_map_of_a_damaged_recording_breaks_a_default_rule(changed: House, damage: int) -> None:
    path = changed({**RUN, "counts": {"scans": 80, "lost": 0, "breaks": 0, "damage": damage}})
    assert ("damage" in broken(path, read_rules(None, against=False))) == (damage > 0)


def test_a_figure_that_is_not_known_breaks_its_rule(changed: House) -> None:
    path = changed({"wall_s": "soon", "memory_mb": None, "counts": {"scans": "many", "lost": 2}})
    rules = Rules("poor", {"lost_share": 1, "memory_mb": 1e9, "breaks": 9}, {"scans_per_s": 0})
    for _ in range(2):
        found = broken(path, rules)
        assert list(found) == ["lost_share", "memory_mb", "breaks", "scans_per_s"]
        assert found["breaks"].detail == "not known: the map does not say"
        (path / "run.json").unlink(missing_ok=True)


def test_a_map_of_no_recording_is_told_how_to_leave_the_default_rules_out(changed: House) -> None:
    path = changed(verdict=None)
    forget_digests(path)
    for name in ("run.json", "labels.csv"):  # as `specmap segment` leaves it
        (path / name).unlink()
    found = broken(path, read_rules(None, against=False))
    assert list(found) == ["verdict", "lost_share"]
    assert all("rules with `defaults = false` leave" in one.detail for one in found.values())


def test_bounds_are_kept_up_to_their_value(changed: House) -> None:
    path = changed(edges=1)
    assert broken(path, Rules("poor", {"submaps": 3, "lost_share": 0.025}, {"submaps": 3})) == {}
    low = Rules("poor", {"submaps": 2.9, "lost_share": 0.024}, {})
    assert list(broken(path, low)) == ["submaps", "lost_share"]
    assert list(broken(path, Rules("poor", {}, {"submaps": 3.1}))) == ["submaps"]
    assert list(broken(path, read_rules(None, against=False))) == ["parts"], "no link joins them"


@pytest.mark.parametrize("verdict", ["good", "doubtful", "poor", None])
def test_the_verdict_has_a_worst(changed: House, verdict: Verdict | None) -> None:
    """A map that nobody judged is as bad as can be."""
    path = changed(verdict=verdict)
    for worst in VERDICTS:
        passes = VERDICTS.index(verdict or "poor") <= VERDICTS.index(worst)
        assert check_map(path, Rules(worst, {}, {})).passed == passes, worst


def test_findings_are_counted_by_their_code_unless_they_are_notes(changed: House) -> None:
    note = {**FINDING, "severity": "note", "code": "loose-part"}
    poor = {**FINDING, "severity": "poor", "message": "worse"}
    path = changed(verdict="poor", findings=(note, FINDING, poor))
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


def test_what_does_not_fit_is_told_once(changed: House, monkeypatch: pytest.MonkeyPatch) -> None:
    path = changed()
    refused = Mock(side_effect=NoResultError("they do not fit"))
    monkeypatch.setattr("specmap_cli.pipelines.check.compare_maps", refused)
    lines = lines_of(check_map(path, against=path))
    assert sum("they do not fit" in line for line in lines) == 1
    assert any("not known: see golden.aligned" in line for line in lines)


def test_a_golden_rule_broken_by_a_map_that_fits_is_told_without_a_doubt(changed: House) -> None:
    path = changed()
    record = check_map(path, Rules("poor", {}, {"golden.area_share": 2.0}), against=path)
    (only,) = (one for one in record.rules if not one.passed)
    assert (only.value, only.detail) == (1.0, "")


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
    lines = markdown(spoiled_record()).decode().splitlines()
    assert lines[0].startswith("### maps/one: breaks 3 of 4 rules")
    rows = [line for line in lines if line.startswith("| **broken**") or line.startswith("| ok")]
    assert len(rows) == 4
    assert rows[-1].startswith("| ok | submaps | 3 | \\>= 2 |")
    assert "the walls \\| are \\*twice\\*" in rows[1]
    jsonschema.validate(json.loads(spoiled_record().model_dump_json()), read_schema("check"))


DOCUMENT = Path(__file__).parents[2] / "docs" / "check.md"


def written(folder: Path, text: str) -> Path:
    path = folder / "rules.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_without_a_file_the_defaults_hold() -> None:
    assert read_rules(None, against=True) == DEFAULTS
    alone = read_rules(None, against=False)
    assert set(alone.most) == {name for name in DEFAULTS.most if not name.startswith(GOLDEN)}
    assert set(alone.least) == {"submaps"}


def test_every_default_is_of_a_figure_and_every_doubt_has_one() -> None:
    assert {name for name, _, _ in DEFAULTS.each()} <= set(BOUNDED)
    codes = {
        code
        for name, code in {**vars(holes), **vars(odometry), **vars(findings)}.items()
        if name.isupper() and isinstance(code, str) and not name.startswith("_")
    }
    only_notes = {findings.BREAK, findings.REFUTED, INPUT}
    assert len(codes) >= 12
    known = {name for name in BOUNDED if name.startswith(FINDINGS)}
    assert known == {FINDINGS + code for code in codes}
    assert {f"{FINDINGS}{code}" for code in codes - only_notes} == {
        name for name in DEFAULTS.most if name.startswith(FINDINGS)
    }


def test_a_file_goes_over_the_defaults_or_does_without_them(tmp_path: Path) -> None:
    text = 'verdict = "good"\n[most]\nlost_share = 0.2\nparts = inf\nfindings.tracking-break = 3\n'
    text += "[least]\nsubmaps = 5\nscans_per_s = 20"
    rules = read_rules(written(tmp_path, text), against=False)
    assert rules.verdict == "good"
    assert (rules.most["lost_share"], rules.most["findings.tracking-break"]) == (0.2, 3)
    assert "parts" not in rules.most
    assert rules.most["findings.walls-disagree"] == 0
    assert rules.least == {"submaps": 5, "scans_per_s": 20}
    rules = read_rules(written(tmp_path, "defaults = false\n[most]\nparts = 2"), against=True)
    assert (rules.verdict, rules.most, rules.least) == ("poor", {"parts": 2}, {})


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[most]\nlost_shar = 1", "most.lost_shar: no such figure: did you mean lost_share?"),
        (
            "[most]\nfindings.walls-disagre = 0",
            "most.findings.walls-disagre: no such figure: did you mean findings.walls-disagree?",
        ),
        ("[most]\nzebra = 1", "most.zebra: no such figure: choose from scans, lost_share"),
        ("[least]\nsubmaps = true", "least.submaps is True: expected a number"),
        ("[least]\nsubmaps = nan", "least.submaps is nan: expected a number"),
        ('[most]\nparts = "two"', "most.parts is 'two': expected a number"),
        ("most = 3", "most is 3: expected a table [most]"),
        ("[atmost]\nparts = 3", "atmost: no such key, did you mean most?"),
        ("[zebra]", "zebra: no such key, expected defaults, verdict, most, least"),
        ('verdict = "fine"', "verdict is 'fine': choose from good, doubtful, poor"),
        ("verdict = []", "verdict is []: choose from good, doubtful, poor"),
        ("defaults = 0", "defaults is 0: expected true or false"),
        ("[most]\ngolden.gone = 2", "most.golden.gone: needs another map: give --against"),
        ("[most", "not valid TOML"),
        ("x = " + "[" * 3000, "nested too deeply"),
    ],
)
def test_what_is_wrong_in_a_file_is_told(tmp_path: Path, text: str, told: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(UsageError) as raised:
        read_rules(path, against=False)
    assert str(raised.value).startswith(f"{path}: {told}")


def test_the_document_lists_every_figure_and_every_default() -> None:
    text = DOCUMENT.read_text(encoding="utf-8")
    listed = re.findall(r"^\| `(\S+)` \| \S", text, re.MULTILINE)
    assert listed == [*(name for name in BOUNDED if not name.startswith(FINDINGS)), "findings.CODE"]
    rows = dict(re.findall(r"^\| `(\S+)` \| .* \| (at .*) \|$", text, re.MULTILINE))
    bounds = {name: f"at {bound} {limit:g}" for name, bound, limit in DEFAULTS.each()}
    of_findings = {name for name in bounds if name.startswith(FINDINGS)}
    assert {bounds.pop(name) for name in of_findings} == {rows.pop("findings.CODE")}
    assert rows == bounds
    assert not any(math.isinf(limit) for _, _, limit in DEFAULTS.each())
