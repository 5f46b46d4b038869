"""A kept map as a finished one again: its grids, its classifiers, its topology."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

from specmap_cli.core.findings import Quality
from specmap_cli.core.progress import Progress
from specmap_cli.core.settings import Config
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.maps.edits_text import written
from specmap_cli.pipelines.edited import drawn, named, tell_unapplied
from specmap_cli.pipelines.finished_map import FinishedMap
from specmap_cli.pipelines.kept_map import KeptMap
from specmap_cli.pipelines.learning import Known, known_of, learn, linked, whole_grid
from specmap_cli.pipelines.map_joining import Joined
from specmap_cli.pipelines.stopwatch import Stopwatch
from specmap_cli.quality.evidence import Evidence
from specmap_cli.quality.verdict import of_layout, quality_of
from specmap_cli.recognition.learning.lessons import NO_LESSONS
from specmap_cli.topology.navigation import with_ways
from specmap_cli.topology.regions import divide
from specmap_cli.topology.topological_map import fences_of

Judge = Callable[[int], Quality]


def remade(
    store: KeyframeStore,
    joined: Joined,
    config: Config,
    progress: Progress,
    clock: Stopwatch,
    counts: Mapping[str, int],
    known: Known | None = None,
) -> FinishedMap:
    """The finished map of keyframes whose layout and submaps are known, with a person's edits.

    `counts` are of the messages and scans that were read for it, `known` is what
    is known by now.
    """
    judge = judge_of(joined)
    finished = divided_anew(store, joined.kept, judge, config, progress, clock, counts, known)
    tell_unapplied(finished.unapplied, progress)
    return finished


def judge_of(joined: Joined) -> Judge:
    """What judges two maps that were joined."""
    kept = joined.kept

    def judge(beyond: int) -> Quality:
        evidence = Evidence(
            trajectory=kept.trajectory,
            keyframes_ns=tuple(kept.labels.stamps_ns.tolist()),
            breaks=tuple(kept.breaks),
            layout=kept.layout,
            audit=joined.audited.audit,
            beyond=beyond,
            warnings=(),
        )
        return quality_of([*kept.findings, *of_layout(evidence)])

    return judge


def divided_anew(
    store: KeyframeStore,
    kept: KeptMap,
    judge: Judge,
    config: Config,
    progress: Progress,
    clock: Stopwatch,
    counts: Mapping[str, int],
    known: Known | None = None,
    drawn_before: tuple[GridMap, int] | None = None,
) -> FinishedMap:
    """The finished map of keyframes, with the borders, names and forbidden links of the edits.

    `judge` tells what is thought of a map that so many keyframes did not fit into. `known` is what
    is known of it, `drawn_before` its whole grid, if that is.
    """
    with clock.stage("grids"):
        whole, beyond = drawn_before or whole_grid(store, kept.layout, config)
    edited = drawn(whole, kept.labels, kept.borders, kept.edits, kept.next_id)
    labels = replace(kept.labels, submaps=edited.submaps)
    known = known or known_of(store, NO_LESSONS, kept.starts, config)
    learned = learn(store, known, edited.submaps, kept.layout.poses, config, progress, clock)
    with clock.stage("ways"):
        regions = divide(whole, labels, fences_of(edited.borders))
        bare = linked(labels, kept.stays, kept.breaks, kept.closures, learned.grids, kept.starts)
        bordered = replace(bare, borders=edited.borders, next_id=edited.next_id)
        linked_up = with_ways(bordered, regions, config.ways, kept.layout.poses)
    topology, skipped = named(linked_up, regions, edited.edits, edited.skipped)
    return FinishedMap(
        topology=topology,
        labels=labels,
        trajectory=kept.trajectory,
        regions=regions,
        classifiers=learned.classifiers,
        lessons=learned.lessons,
        layout=kept.layout,
        counts=counts,
        limits={**kept.layout.limits, "max_extent_m": beyond},
        quality=judge(beyond),
        seconds=dict(clock.seconds),
        wall_s=clock.elapsed_s,
        starts=kept.scan_starts,
        driven_m=tuple(log.path_m for log in kept.logs),
        edits=written(edited.edits, kept.edits_text),
        unapplied=(*skipped, *kept.lost),
    )


def added(before: Mapping[str, int], counts: Mapping[str, int]) -> dict[str, int]:
    """What was counted for a map and for what is added to it, together."""
    return {name: count + before.get(name, 0) for name, count in counts.items()}
