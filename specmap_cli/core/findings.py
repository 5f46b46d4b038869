"""What a program found out about its own result: findings, and the verdict that they add up to."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, get_args

from pydantic import Field

from specmap_cli.core.json_values import Number, StampNs, Value

# How much a finding takes from the trust in a map. A `note` takes nothing.
Severity = Literal["note", "doubtful", "poor"]
Verdict = Literal["good", "doubtful", "poor"]
VERDICTS: tuple[Verdict, ...] = get_args(Verdict)  # from the best to the worst

INPUT = "input"  # the code of what reading and registration have to say about the log


@dataclass(frozen=True, slots=True)
class Where(Value):
    """When and where something was found."""

    stamp_ns: Annotated[StampNs | None, Field(alias="stamp")]
    """seconds; null where it has no stamp"""
    x: Number | None
    """metres; null where it has no place"""
    y: Number | None
    """metres; null where it has no place"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding(Value):
    """Something that was found out about the map; docs/quality.md lists the codes."""

    code: str
    """what was found, stable over versions"""
    severity: Severity
    """how grave it is"""
    message: str
    """the same in words"""
    advice: str = ""
    """what to do about it"""
    value: float | None = None
    """what was measured; null where nothing was"""
    limit: float | None = None
    """what the value is compared with; null for nothing"""
    where: Where | None = None
    """null for what holds for the whole map"""

    @property
    def place(self) -> tuple[float, float] | None:
        """Where in the map (x, y), metres; None without a place."""
        where = self.where
        return None if where is None or where.x is None or where.y is None else (where.x, where.y)


@dataclass(frozen=True, slots=True, kw_only=True)
class Quality(Value):
    """What is thought of the map."""

    verdict: Verdict
    """what the gravest of the findings makes of the map"""
    findings: tuple[Finding, ...]
    """all findings"""

    @classmethod
    def of(cls, findings: Iterable[Finding]) -> Quality:
        """The findings, the gravest first, what reading had to say last of its kind.

        The worst of them decides the verdict.
        """
        told = sorted(findings, key=lambda one: (-VERDICTS.index(_verdict(one)), one.code == INPUT))
        return cls(verdict=_verdict(told[0]) if told else VERDICTS[0], findings=tuple(told))

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
        return tuple(finding for finding in self.findings if finding.severity == self.verdict)


def at_least_as_bad(verdict: Verdict, limit: Verdict) -> bool:
    """Whether a verdict is `limit` or worse."""
    return VERDICTS.index(verdict) >= VERDICTS.index(limit)


def summary(findings: Sequence[Finding]) -> list[str]:
    """A line a code, in the order of first appearance: its worst finding and how many more.

    The first finding of the worst severity stands for its code. What reading had to say is told in
    full.
    """
    kinds: dict[str, list[Finding]] = {}
    for finding in findings:
        kind = finding.message if finding.code == INPUT else finding.code
        kinds.setdefault(kind, []).append(finding)
    lines = []
    for alike in kinds.values():
        first = max(alike, key=lambda finding: VERDICTS.index(_verdict(finding)))
        more = f" (and {len(alike) - 1:,} more like it)" if len(alike) > 1 else ""
        advice = f": {first.advice}" if first.advice else ""
        lines.append(f"{first.message}{more}{advice}")
    return lines


def _verdict(finding: Finding) -> Verdict:
    return "good" if finding.severity == "note" else finding.severity


UNDOUBTED = Quality.of(())  # nothing was found
