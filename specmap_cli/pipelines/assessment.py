"""The last question to a map: is it right? The verdict on it."""

from __future__ import annotations

from specmap_cli.core.findings import Quality, summary
from specmap_cli.core.progress import Progress
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.trajectory import keyframe_rows
from specmap_cli.pipelines.exploration import Explored
from specmap_cli.pipelines.laying_out import LaidOut
from specmap_cli.quality.evidence import Evidence, holes_of
from specmap_cli.quality.verdict import judged


def assess(
    store: KeyframeStore,
    explored: Explored,
    laid: LaidOut,
    beyond: int,
    warnings: tuple[str, ...],
) -> Quality:
    """What is thought of a map.

    `beyond` keyframes did not fit into the grid; `warnings` are those of reading and registration.
    """
    return judged(evidence_of(store, explored, laid, beyond, warnings))


def evidence_of(
    store: KeyframeStore,
    explored: Explored,
    laid: LaidOut,
    beyond: int,
    warnings: tuple[str, ...],
) -> Evidence:
    """What the verdict on a map of one recording rests on; the arguments are those of `assess`."""
    rows = keyframe_rows(explored.trajectory, store)
    layout, breaks = laid.layout, tuple(explored.breaks)
    return Evidence(
        trajectory=laid.trajectory,
        keyframes_ns=store.stamps_ns,
        breaks=breaks,
        layout=layout,
        audit=laid.audited.audit,
        beyond=beyond,
        warnings=warnings,
        holes=holes_of(store, rows, laid.trajectory, layout, breaks),
    )


def tell(quality: Quality, progress: Progress) -> None:
    """What was found out about a map, a line a kind: what is grave, and what is worth knowing."""
    for warning in summary(quality.warnings):
        progress.warn(warning)
    for note in summary(quality.notes):
        progress.note(note)
