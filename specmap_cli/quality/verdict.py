"""Is the map right? What tracking, layout and audit found out, as findings with a verdict.

Every finding has a code that stays the same from version to version; docs/quality.md lists them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

from specmap_cli.core.findings import INPUT, Finding, Quality, Severity
from specmap_cli.core.settings import QualityConfig
from specmap_cli.quality.evidence import Evidence
from specmap_cli.quality.holes import unwatched
from specmap_cli.quality.measured import odometry_disagrees, unmeasured_way
from specmap_cli.quality.placed import (
    beyond_grid,
    contradictions,
    loose_parts,
    mended,
    moved_parts,
    refused_layout,
    refuted,
    walls,
)
from specmap_cli.quality.rivals import rival_places
from specmap_cli.quality.tracked import breaks, lost_scans

Check = Callable[[Evidence, QualityConfig], Iterator[Finding]]

CHECKS: tuple[Check, ...] = (
    lost_scans,
    breaks,
    unwatched,
    unmeasured_way,
    odometry_disagrees,
    loose_parts,
    moved_parts,
    rival_places,
    refused_layout,
    walls,
    mended,
    contradictions,
    refuted,
    beyond_grid,
)
_ORDER: tuple[Severity, ...] = ("poor", "doubtful", "note")


def judged(evidence: Evidence, config: QualityConfig) -> Quality:
    """The verdict with all findings, the gravest first, in the order of the stages otherwise."""
    findings = [finding for check in CHECKS for finding in check(evidence, config)]
    findings += [Finding(code=INPUT, severity="note", message=text) for text in evidence.warnings]
    return Quality(findings=tuple(sorted(findings, key=lambda one: _ORDER.index(one.severity))))
