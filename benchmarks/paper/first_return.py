"""Figure 4b, c: the first place that the robot comes back to, before and after it is recognised."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.paper import pictures
from benchmarks.paper.blocks import Gallery, Picture, gallery
from benchmarks.paper.cases import Case
from benchmarks.paper.workshop import OURS, WORDS, Workshop
from specmap_cli.core.records import NO_SUBMAP
from specmap_cli.grids.keyframes import integrate_keyframes
from specmap_cli.pipelines.exploration import online_labels


def first_return(case: Case, preset: str, workshop: Workshop) -> Gallery | None:
    """What the robot had seen when it left the first submap that was merged with an earlier one."""
    explored = workshop.built(case, preset).explored
    left = {number: max(keyframes) for number, keyframes in explored.regions.items()}
    merges = [closure for closure in explored.closures if closure.merged]
    if not merges:
        return None
    merge = min(merges, key=lambda closure: max(left[closure.new], left[closure.old]))
    seen = max(left[merge.new], left[merge.old]) + 1
    whole = workshop.built(case, OURS)  # its layout: the paper lays nothing out
    poses = whole.finished.laid.labels.poses[:seen]
    grid = integrate_keyframes(whole.store, range(seen), poses, whole.config.grid).snapshot()
    shown = []
    for merged, words in (
        ((), f"before submap {merge.new} is merged into submap {merge.old}"),
        ((merge,), "after it"),
    ):
        submaps = online_labels(explored.regions, merged, len(whole.store))[:seen]
        count = len(np.unique(submaps[submaps != NO_SUBMAP]))
        labels = replace(whole.finished.laid.labels, poses=poses, submaps=submaps)
        shown.append(
            Picture(
                pictures.topology(grid, labels, pictures.links(submaps)),
                f"{case.name}, {WORDS[preset]}, the first merge: {count} submaps {words}",
            )
        )
    return gallery(shown)
