"""New space of an updated map, divided as a build of all its recordings divides it.

The recording that is added saw some rooms only through their doors, and so did those before it. By
itself its map may give a room that it entered to what lies beyond the next door, and the old map
may have given parts of it to the corridor. The map of all of them shows the room as it is.
"""

from __future__ import annotations

from dataclasses import replace

from specmap_cli.core.settings import Config
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.pipelines.kept_map import KeptMap, Seen
from specmap_cli.pipelines.learning import divides_whole
from specmap_cli.pipelines.map_joining import heritage_of
from specmap_cli.pipelines.thinning import Thinned
from specmap_cli.segmentation.division import regions_of
from specmap_cli.topology.graph import inherited


def redivided(old: Seen, joint: KeptMap, fewer: Thinned, whole: GridMap, config: Config) -> KeptMap:
    """The map that is left of `joint`, its new space divided by `whole`, the grid of what is left.

    The keyframes of `old`, with which those of `joint` begin, stay in their submaps.
    """
    kept = fewer.kept
    if not divides_whole(kept.layout, config):
        return kept
    poses, settings = joint.layout.poses, config.segmentation
    divided = regions_of(whole, poses, settings)
    heritage = heritage_of(old.kept, old.regions)
    submaps = inherited(heritage, poses, divided, settings.region_min_m)
    return replace(
        kept,
        labels=replace(kept.labels, submaps=submaps[fewer.left]),
        next_id=max(old.kept.next_id, 1 + int(submaps.max())),
    )
