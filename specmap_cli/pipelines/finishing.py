"""What follows Algorithm 1: from what was explored to a finished map."""

from __future__ import annotations

import numpy as np

from specmap_cli.core.progress import Progress
from specmap_cli.core.records import Labels
from specmap_cli.core.settings import Config
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.pipelines.assessment import assess
from specmap_cli.pipelines.exploration import Explored
from specmap_cli.pipelines.finished_map import FinishedMap
from specmap_cli.pipelines.laying_out import lay_out
from specmap_cli.pipelines.learning import Known, divide, learn, linked, whole_grid
from specmap_cli.pipelines.stopwatch import Stopwatch
from specmap_cli.pipelines.tracking import Tracking
from specmap_cli.topology.navigation import with_ways
from specmap_cli.topology.regions import divide as divide_cells


def finish(
    explored: Explored,
    tracking: Tracking,
    config: Config,
    store: KeyframeStore,
    progress: Progress,
    clock: Stopwatch,
) -> FinishedMap:
    """Relax the layout, turn it, heal it, refute, divide, assess, learn, find the ways."""
    laid = lay_out(explored, config, store, progress, clock)
    layout, closures = laid.layout, laid.closures
    with clock.stage("grids"):
        whole, beyond = whole_grid(store, layout, config)
    with clock.stage("segmentation"):
        submaps = divide(whole, layout, explored.regions, closures, config)
    with clock.stage("audit"):
        quality = assess(store, explored, laid, beyond, tracking.warnings)
    known = Known(explored.features)
    learned = learn(store, known, submaps, layout.poses, config, progress, clock)
    stamps = np.array(store.stamps_ns, dtype=np.int64)
    labels = Labels(stamps_ns=stamps, poses=layout.poses, submaps=submaps)
    with clock.stage("ways"):
        regions = divide_cells(whole, labels)
        joined = linked(labels, explored.regions, explored.breaks, closures, learned.grids)
        topology = with_ways(joined, regions, config.ways, layout.poses)
    return FinishedMap(
        topology=topology,
        labels=labels,
        trajectory=laid.trajectory,
        regions=regions,
        classifiers=learned.classifiers,
        lessons=learned.lessons,
        layout=layout,
        counts=tracking.counts,
        limits={**layout.limits, "max_extent_m": beyond},
        quality=quality,
        seconds=dict(clock.seconds),
        wall_s=clock.elapsed_s,
    )
