from __future__ import annotations

import itertools
from typing import Any

import pytest

from specmap_cli.core.findings import (
    UNDOUBTED,
    VERDICTS,
    Finding,
    Quality,
    Severity,
    Where,
    at_least_as_bad,
    summary,
)


def finding(severity: Severity, code: str = "code", message: str = "said") -> Finding:
    return Finding(code=code, severity=severity, message=message)


@pytest.mark.parametrize(
    ("severities", "verdict"),
    [
        ((), "good"),
        (("note",), "good"),
        (("note", "doubtful"), "doubtful"),
        (("poor", "doubtful", "note"), "poor"),
    ],
)
def test_the_gravest_finding_decides(severities: tuple[Severity, ...], verdict: str) -> None:
    for order in itertools.permutations(severities):
        quality = Quality.of(finding(severity) for severity in order)
        assert quality.verdict == verdict
        assert all(one.severity == verdict for one in quality.worst)
        assert bool(quality.worst) is (verdict != "good")


def test_verdicts_are_ordered() -> None:
    for (i, a), (j, b) in itertools.product(enumerate(VERDICTS), repeat=2):
        assert at_least_as_bad(a, b) is (i >= j)


def test_a_finding_for_a_machine_says_where_it_is() -> None:
    said: dict[str, Any] = {"code": "walls-disagree", "severity": "poor", "message": "walls"}
    said |= {"advice": "look", "value": 0.3, "limit": 0.1}
    where = {"stamp": 1.5, "x": 1.0, "y": 2.0}
    full = Finding(**said, where=Where(1_500_000_000, 1.0, 2.0))
    assert full.as_dict() == said | {"where": where}
    assert finding("note").as_dict()["where"] is None
    assert UNDOUBTED.as_dict() == {"verdict": "good", "findings": []}


def test_many_findings_of_a_kind_are_one_line_and_advice_follows() -> None:
    lines = summary(
        [
            finding("note", "a", "a first"),
            finding("doubtful", "b", "b first"),
            finding("poor", "a", "a worst"),
            finding("poor", "a", "a later"),
        ]
    )
    assert lines == ["a worst (and 2 more like it)", "b first"]
    told = Finding(code="a", severity="poor", message="it is dark", advice="make light")
    assert summary([told]) == ["it is dark: make light"]
    assert summary([]) == []


def test_notes_about_the_result_are_no_warnings() -> None:
    quality = Quality.of((finding("doubtful", "a"), finding("note", "b"), finding("note", "input")))
    assert [one.code for one in quality.warnings] == ["a", "input"]
    assert [one.code for one in quality.notes] == ["b"]
