"""Is the map right? What tracking, layout and audit found out, as findings with a verdict.

Every finding has a code that stays the same from version to version; docs/quality.md lists them.
"""

from __future__ import annotations

from collections.abc import Sequence

from specmap_cli.core.findings import INPUT, Finding, Quality, Severity
from specmap_cli.quality import laid_out, recording
from specmap_cli.quality.evidence import Evidence

LAYOUT_CODES = laid_out.CODES  # what is said of a layout; the other codes are about recordings
_ORDER: tuple[Severity, ...] = ("poor", "doubtful", "note")


def of_recording(evidence: Evidence) -> list[Finding]:
    """What is to be said of a recording, wherever its map is laid into another one."""
    inputs = [Finding(code=INPUT, severity="note", message=text) for text in evidence.warnings]
    return [finding for check in recording.CHECKS for finding in check(evidence)] + inputs


def of_layout(evidence: Evidence) -> list[Finding]:
    """What is to be said of a layout, of one recording or of several."""
    return [finding for check in laid_out.CHECKS for finding in check(evidence)]


def quality_of(findings: Sequence[Finding]) -> Quality:
    """The findings, the gravest first; what reading had to say comes last of its kind."""
    return Quality.of(
        sorted(findings, key=lambda one: (_ORDER.index(one.severity), one.code == INPUT))
    )
