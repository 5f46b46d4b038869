"""The last question to a map: is it right? The audit of its layout, and the verdict."""

from __future__ import annotations

from specmap_cli.core.findings import Quality, summary
from specmap_cli.core.progress import Progress
from specmap_cli.core.records import Trajectory
from specmap_cli.core.settings import Config
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.audit import audit
from specmap_cli.layout.relaxation import Layout
from specmap_cli.pipelines.exploration import Explored
from specmap_cli.quality.evidence import Evidence
from specmap_cli.quality.verdict import judged


def assess(
    store: KeyframeStore,
    explored: Explored,
    layout: Layout,
    trajectory: Trajectory,
    beyond: int,
    warnings: tuple[str, ...],
    config: Config,
) -> Quality:
    """What is thought of a map.

    `trajectory` is that of all scans in the layout; `beyond` keyframes did not fit into the grid;
    `warnings` are those of reading and registration.
    """
    evidence = Evidence(
        trajectory=trajectory,
        keyframes_ns=store.stamps_ns,
        breaks=tuple(explored.breaks),
        layout=layout,
        audit=audit(store, layout.poses, explored.breaks, config.audit),
        beyond=beyond,
        warnings=warnings,
    )
    return judged(evidence, config.quality)


def tell(quality: Quality, progress: Progress) -> None:
    """What was found out about a map, a line a kind: what is grave, and what is worth knowing."""
    for warning in summary(quality.warnings):
        progress.warn(warning)
    for note in summary(quality.notes):
        progress.note(note)
