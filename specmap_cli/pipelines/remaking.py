"""A kept map as a finished one again: its grids, its classifiers, its topology."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from specmap_cli.core.progress import Progress
from specmap_cli.core.settings import Config
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.pipelines.finished_map import FinishedMap
from specmap_cli.pipelines.kept_map import KeptMap, Said
from specmap_cli.pipelines.learning import learn, linked, whole_grid
from specmap_cli.pipelines.map_joining import Joined
from specmap_cli.pipelines.stopwatch import Stopwatch
from specmap_cli.quality.evidence import Evidence
from specmap_cli.quality.verdict import of_layout, quality_of
from specmap_cli.recognition.features.sets import KeyframeFeatures
from specmap_cli.topology.navigation import with_ways
from specmap_cli.topology.regions import divide
from specmap_cli.topology.topological_map import TopologicalMap


def remade(
    store: KeyframeStore,
    joined: Joined,
    config: Config,
    progress: Progress,
    clock: Stopwatch,
    counts: Mapping[str, int],
) -> FinishedMap:
    """The finished map of keyframes whose layout and submaps are known.

    `counts` are of the messages and scans that were read for it.
    """
    kept = joined.kept
    with clock.stage("grids"):
        whole, beyond = whole_grid(store, kept.layout, config)
    features = KeyframeFeatures(store, config.recognition.feature_set)
    submaps, poses = kept.labels.submaps, kept.layout.poses
    grids, classifiers = learn(store, features, submaps, poses, config, progress, clock)
    evidence = Evidence(
        trajectory=kept.trajectory,
        keyframes_ns=store.stamps_ns,
        breaks=tuple(kept.breaks),
        layout=kept.layout,
        audit=joined.audited.audit,
        beyond=beyond,
        warnings=(),
    )
    with clock.stage("ways"):
        regions = divide(whole, kept.labels)
        linked_up = linked(kept.labels, kept.stays, kept.breaks, kept.closures, grids, kept.starts)
        topology = with_ways(linked_up, regions, config.ways, poses)
    return FinishedMap(
        topology=_named(topology, kept),
        labels=kept.labels,
        trajectory=kept.trajectory,
        regions=regions,
        classifiers=classifiers,
        layout=kept.layout,
        counts=counts,
        limits={**kept.layout.limits, "max_extent_m": beyond},
        quality=quality_of([*kept.findings, *of_layout(evidence, config.quality)]),
        seconds=dict(clock.seconds),
        starts=tuple(np.cumsum([log.scans for log in kept.logs])[:-1].tolist()),
    )


def added(before: Mapping[str, Any], counts: Mapping[str, int]) -> dict[str, int]:
    """What was counted for a map and for what is added to it, together."""
    return {name: count + int(before.get(name, 0)) for name, count in counts.items()}


def _named(topology: TopologicalMap, kept: KeptMap) -> TopologicalMap:
    """The submaps with what a person said of them."""
    submaps = {}
    for id_, submap in topology.submaps.items():
        said = kept.said.get(id_, Said())
        submaps[id_] = replace(submap, name=said.name, kind=said.kind, properties=said.properties)
    return replace(topology, submaps=submaps, next_id=kept.next_id)
