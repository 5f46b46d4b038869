"""What a map's figures are worth under rules: rule by rule."""

from __future__ import annotations

from collections.abc import Mapping

from specmap_cli.checking.figures import FINDINGS, Figures
from specmap_cli.checking.record import CheckRecord, OutcomeRecord, RuleName
from specmap_cli.checking.rules import Bound, Rules
from specmap_cli.core.findings import Verdict, at_least_as_bad

VERDICT = "verdict"
_UNKNOWN = "not known: the map does not say"


def judged(
    map_: str,
    against: str | None,
    figures: Figures,
    verdict: Verdict | None,
    rules: Rules,
    details: Mapping[str, str],
) -> CheckRecord:
    """Every rule and whether the map keeps it; `details` are words on figures that break one."""
    outcomes = [
        _of_verdict(verdict, rules.verdict, details),
        *(_of_figure(name, bound, limit, figures, details) for name, bound, limit in rules.each()),
    ]
    return CheckRecord(
        schema_version=1,
        map=map_,
        against=against,
        passed=all(outcome.passed for outcome in outcomes),
        rules=outcomes,
        figures={name: figures[name] for name in sorted(figures)},
    )


def _of_verdict(
    verdict: Verdict | None, worst: Verdict, details: Mapping[str, str]
) -> OutcomeRecord:
    """A map that nobody judged is as bad as can be."""
    passed = worst == "poor" or (verdict is not None and not _worse(verdict, worst))
    detail = "" if passed else details.get(VERDICT, "") if verdict is not None else _UNKNOWN
    return OutcomeRecord(
        rule=VERDICT, bound="most", limit=worst, value=verdict, passed=passed, detail=detail
    )


def _worse(verdict: Verdict, worst: Verdict) -> bool:
    return verdict != worst and at_least_as_bad(verdict, worst)


def _of_figure(
    name: RuleName, bound: Bound, limit: float, figures: Figures, details: Mapping[str, str]
) -> OutcomeRecord:
    """A figure that is not known keeps no rule; no finding of a code is none of it."""
    value = figures.get(name, 0 if name.startswith(FINDINGS) else None)
    passed = value is not None and (value <= limit if bound == "most" else value >= limit)
    detail = "" if passed else details.get(name, _UNKNOWN if value is None else "")
    return OutcomeRecord(
        rule=name, bound=bound, limit=limit, value=value, passed=passed, detail=detail
    )
