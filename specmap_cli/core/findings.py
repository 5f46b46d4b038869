"""What a program found out about its own result: findings, and the verdict that they add up to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

from specmap_cli.core.text import seconds

# How much a finding takes from the trust in a map. A `note` takes nothing.
Severity = Literal["note", "doubtful", "poor"]
Verdict = Literal["good", "doubtful", "poor"]
VERDICTS: tuple[Verdict, ...] = get_args(Verdict)  # from the best to the worst

INPUT = "input"  # the code of what reading and registration have to say about the log

Place = tuple[float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One thing that was found out, by a stable `code`.

    `value` is its size and `limit` what it should not exceed, in the unit that the code is
    documented with; `stamp_ns` and `place` (x, y), metres in the map, say where. Each of these is
    None where there is none. `message` says the same in a sentence, `advice` what to try.
    """

    code: str
    severity: Severity
    message: str
    advice: str = ""
    value: float | None = None
    limit: float | None = None
    stamp_ns: int | None = None
    place: Place | None = None

    def as_dict(self) -> dict[str, Any]:
        """The same for a machine."""
        nowhere = self.stamp_ns is None and self.place is None
        x, y = self.place or (None, None)
        stamp = None if self.stamp_ns is None else seconds(self.stamp_ns)
        return {
            "code": self.code,
            "severity": self.severity,
            "message": self.message,
            "advice": self.advice,
            "value": self.value,
            "limit": self.limit,
            "where": None if nowhere else {"stamp": stamp, "x": x, "y": y},
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class Quality:
    """What is thought of a map: the worst of its findings decides the verdict."""

    findings: tuple[Finding, ...] = ()

    @property
    def verdict(self) -> Verdict:
        """`good`, `doubtful` or `poor`."""
        return max((_verdict(finding) for finding in self.findings), key=_rank, default="good")

    @property
    def warnings(self) -> tuple[Finding, ...]:
        """Those that a user should hear of: all but notes about the result."""
        return tuple(one for one in self.findings if one.severity != "note" or one.code == INPUT)

    @property
    def notes(self) -> tuple[Finding, ...]:
        """The others."""
        return tuple(one for one in self.findings if one not in self.warnings)

    @property
    def worst(self) -> tuple[Finding, ...]:
        """The findings that decide the verdict, in their order; none of a good map."""
        verdict = self.verdict
        return tuple(finding for finding in self.findings if finding.severity == verdict)

    def as_dict(self) -> dict[str, Any]:
        """The same for a machine."""
        findings = [finding.as_dict() for finding in self.findings]
        return {"verdict": self.verdict, "findings": findings}


UNDOUBTED = Quality()  # nothing was found


def at_least_as_bad(verdict: Verdict, limit: Verdict) -> bool:
    """Whether a verdict is `limit` or worse."""
    return _rank(verdict) >= _rank(limit)


def summary(findings: Sequence[Finding]) -> list[str]:
    """A line a code, in the order of first appearance: its worst finding and how many more.

    The first finding of the worst severity stands for its code.
    """
    lines = []
    for code in dict.fromkeys(finding.code for finding in findings):
        alike = [finding for finding in findings if finding.code == code]
        first = max(alike, key=lambda finding: _rank(_verdict(finding)))
        more = f" (and {len(alike) - 1:,} more like it)" if len(alike) > 1 else ""
        advice = f": {first.advice}" if first.advice else ""
        lines.append(f"{first.message}{more}{advice}")
    return lines


def _verdict(finding: Finding) -> Verdict:
    return "good" if finding.severity == "note" else finding.severity


def _rank(verdict: Verdict) -> int:
    return VERDICTS.index(verdict)
