"""Fewer keyframes for a map that was updated: what newer recordings show again is let go.

So a map follows the building, and not the number of updates. What anything names stays: the first
and the last keyframe of a recording, of a visit to a submap and of a stay, the frames of stays, the
keyframes at which tracking started afresh, and those that a person's merges are made of.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np

from specmap_cli.core.arrays import runs
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.json_values import runs_of
from specmap_cli.core.records import BoolArray, IntArray, Labels
from specmap_cli.core.settings import Config
from specmap_cli.grids.gridmap import UNKNOWN
from specmap_cli.grids.keyframes import (
    KeyframeStore,
    Recorded,
    repeated,
    sole_views,
    views_needed,
)
from specmap_cli.layout.carrying import carried_places
from specmap_cli.layout.dropping import gaps_of, tracked_over_gaps, without_keyframes
from specmap_cli.pipelines.finished_map import ways_m
from specmap_cli.pipelines.kept_map import KeptMap, Seen, thinned_of
from specmap_cli.topology.topological_map import BorderEdit, LogInfo, Merge, heirs


@dataclass(frozen=True, slots=True)
class Thinned:
    """A map with fewer keyframes, of which `old` are of the recordings before the last one.

    `left` (k,) are the numbers that they had among all. `dropped` of the old ones are gone since
    newer ones show the same; `witnesses` would be, too, but show walls that no other one does.
    """

    kept: KeptMap
    left: IntArray
    old: int
    dropped: int = 0
    witnesses: int = 0


def thinned(store: KeyframeStore, joint: KeptMap, old: Seen, new: Seen, config: Config) -> Thinned:
    """The map that `old` and `new` became, without older keyframes that newer ones repeat.

    `new` is one recording, laid out by itself. The store has only the keyframes that are left
    afterwards. Deterministic.
    """
    count, everything = len(old.kept.labels.stamps_ns), np.arange(len(joint.labels.stamps_ns))
    if config.update.keep_all:
        return Thinned(joint, everything, count)
    of = joint.recordings
    gone = repeated(_recorded(store, joint, of, config), _named(joint, of))
    unseen = _unseen(old, new, joint.layout.poses)
    stay = sole_views(
        store,
        gone[:count],
        old.kept.labels.poses,
        old.known.whole,
        unseen,
        config.grid.max_range_m,
    )
    gone[stay] = False
    if not gone.any():
        return Thinned(joint, everything, count, 0, len(stay))
    fewer, dropped = _without(store, joint, of, gone), int(gone.sum())
    return Thinned(fewer, np.flatnonzero(~gone), count - dropped, dropped, len(stay))


def _recorded(store: KeyframeStore, kept: KeptMap, of: IntArray, config: Config) -> Recorded:
    """Where the keyframes of all recordings look from; each has one laser."""
    scans = [store.scan(first) for first in (0, *kept.starts)]
    return Recorded(
        poses=kept.layout.poses,
        of=of,
        enough=np.array([views_needed(scan, config.grid) for scan in scans]),
        all_round=np.array([scan.full_circle for scan in scans]),
    )


def _named(kept: KeptMap, of: IntArray) -> BoolArray:
    """(n,) the keyframes that anything names."""
    named = np.zeros(len(of), dtype=bool)
    submaps = kept.labels.submaps
    for start, end in runs(of * (1 + submaps.max()) + submaps):
        named[[start, end - 1]] = True
    for own in kept.stays.values():
        named[[own[0], min(own), max(own)]] = True
    named[list(kept.breaks)] = True
    for place, border in enumerate(kept.borders):
        if isinstance(border, Merge):
            became = list(heirs(border.kept, kept.borders[place + 1 :]))
            named[: border.known] |= np.isin(submaps[: border.known], became)
    return named


def _unseen(old: Seen, new: Seen, poses: FloatArray) -> BoolArray:
    """(H, W) the wall cells of the old map at which the new recording did not look.

    `poses` (n, 3) are those of the keyframes of both in the joint map.
    """
    whole, count = old.known.whole, len(old.kept.labels.poses)
    cells = np.argwhere(whole.occupied)
    places = carried_places(whole.centres_of(cells), old.kept.labels.poses, poses[:count])
    places = carried_places(places, poses[count:], new.kept.labels.poses)
    known = cv2.dilate((new.known.whole.cells != UNKNOWN).astype(np.uint8), np.ones((3, 3)))
    there = new.known.whole.cells_of(places)
    inside = new.known.whole.inside(there)
    looked = np.zeros(len(cells), dtype=bool)
    looked[inside] = known[there[inside, 0], there[inside, 1]] > 0
    unseen = np.zeros(whole.cells.shape, dtype=bool)
    unseen[cells[~looked, 0], cells[~looked, 1]] = True
    return unseen


def _without(store: KeyframeStore, kept: KeptMap, of: IntArray, gone: BoolArray) -> KeptMap:
    """The map without some keyframes, and the store, too."""
    numbers = np.flatnonzero(~gone)
    row = {number: k for k, number in enumerate(numbers.tolist())}
    breaks = {row[number]: bridge for number, bridge in kept.breaks.items()}
    labels, placed = kept.labels, kept.layout.poses
    ways = ways_m(kept.trajectory, labels.stamps_ns, kept.scan_starts)
    logs = tuple(_renumbered(*each, row) for each in zip(kept.logs, ways, strict=True))
    gaps = gaps_of(placed[numbers], thinned_of(logs, of[numbers]))
    store.keep(numbers, tracked_over_gaps(store.poses, placed, numbers, gaps))
    layout = without_keyframes(store, kept.layout, numbers, of, {**gaps, **breaks})
    return replace(
        kept,
        layout=layout,
        labels=Labels(
            stamps_ns=labels.stamps_ns[numbers],
            poses=layout.poses,
            submaps=labels.submaps[numbers],
        ),
        stays={
            number: tuple(row[one] for one in own if one in row)
            for number, own in kept.stays.items()
        },
        breaks=breaks,
        logs=logs,
        borders=tuple(_left(border, row, gone) for border in kept.borders),
    )


def _renumbered(log: LogInfo, way_m: float, row: Mapping[int, int]) -> LogInfo:
    """A recording with the new numbers of its keyframes; if some are gone it was `way_m` long."""
    if log.keyframes is None:
        return log
    first, last = log.keyframes
    keyframes = row[first], row[last]
    whole = keyframes[1] - keyframes[0] == last - first
    return replace(log, keyframes=keyframes, path_m=log.path_m if whole else log.path_m or way_m)


def _left(border: BorderEdit, row: Mapping[int, int], gone: BoolArray) -> BorderEdit:
    """A border with the new numbers of the keyframes that came with it."""
    if not isinstance(border, Merge):
        return border
    return replace(
        border,
        runs=runs_of([row[one] for one in border.keyframes]),
        known=border.known - int(gone[: border.known].sum()),
    )
