"""Is the map right? What tracking, layout and audit found out, as findings with a verdict.

Every finding has a code that stays the same from version to version; docs/quality.md lists them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from specmap_cli.core.findings import INPUT, Finding, Quality, Severity
from specmap_cli.quality.evidence import Evidence
from specmap_cli.quality.holes import unwatched
from specmap_cli.quality.measured import odometry_disagrees, unmeasured_way
from specmap_cli.quality.placed import (
    BEYOND,
    LOOSE,
    MENDED,
    MOVED,
    REFUTED,
    WALLS,
    beyond_grid,
    contradictions,
    loose_parts,
    mended,
    moved_parts,
    refused_layout,
    refuted,
    walls,
)
from specmap_cli.quality.placed import LAYOUT as LAYOUT_REFUSED
from specmap_cli.quality.rivals import RIVAL, rival_places
from specmap_cli.quality.tracked import breaks, lost_scans

Check = Callable[[Evidence], Iterator[Finding]]

RECORDING: tuple[Check, ...] = (
    lost_scans,
    breaks,
    unwatched,
    unmeasured_way,
    odometry_disagrees,
)
LAYOUT: tuple[Check, ...] = (
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
# What is said of a layout; the other codes are about recordings.
LAYOUT_CODES = frozenset({LOOSE, MOVED, RIVAL, LAYOUT_REFUSED, WALLS, MENDED, REFUTED, BEYOND})
_ORDER: tuple[Severity, ...] = ("poor", "doubtful", "note")


def judged(evidence: Evidence) -> Quality:
    """The verdict with all findings, the gravest first, in the order of the stages otherwise."""
    return quality_of([*of_recording(evidence), *of_layout(evidence)])


def of_recording(evidence: Evidence) -> list[Finding]:
    """What is to be said of a recording, wherever its map is laid into another one."""
    told = [Finding(code=INPUT, severity="note", message=text) for text in evidence.warnings]
    return [*_found(RECORDING, evidence), *told]


def of_layout(evidence: Evidence) -> list[Finding]:
    """What is to be said of a layout, of one recording or of several."""
    return _found(LAYOUT, evidence)


def quality_of(findings: Sequence[Finding]) -> Quality:
    """The findings, the gravest first; what reading had to say comes last of its kind."""
    ordered = sorted(findings, key=lambda one: one.code == INPUT)
    return Quality.of(sorted(ordered, key=lambda one: _ORDER.index(one.severity)))


def _found(checks: Sequence[Check], evidence: Evidence) -> list[Finding]:
    return [finding for check in checks for finding in check(evidence)]
