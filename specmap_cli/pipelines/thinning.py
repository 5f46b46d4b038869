"""Fewer keyframes for a map that was updated: what newer recordings show again is let go.

So a map follows the building, and not the number of updates. What anything names stays: the first
and the last keyframe of a recording, of a visit to a submap and of a stay, the frames of stays, the
keyframes at which tracking started afresh, and those that a person's merges are made of.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from specmap_cli.core.arrays import runs
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.json_values import runs_of
from specmap_cli.core.records import BoolArray, IntArray, Labels
from specmap_cli.grids.gridmap import UNKNOWN
from specmap_cli.grids.keyframes import KeyframeStore, Recorded, repeated, sole_views, views_needed
from specmap_cli.layout.joining import tracked_over_gaps, without_keyframes
from specmap_cli.layout.result import propagated_places
from specmap_cli.pipelines.map_in_making import LaidOut, gaps_in
from specmap_cli.pipelines.session import Session
from specmap_cli.topology.topological_map import Merge, heirs, ways_m


@dataclass(frozen=True, slots=True)
class Thinned:
    """A map with fewer keyframes, of which `old` are of the recordings before the last one.

    `left` (k,) are the numbers that they had among all. `dropped` of the old ones are gone since
    newer ones show the same; `kept_for_walls` would be, too, but show walls that no other one does.
    """

    laid: LaidOut
    left: IntArray
    old: int
    dropped: int = 0
    kept_for_walls: int = 0


def thinned(session: Session, joint: LaidOut, old: LaidOut, new: LaidOut) -> Thinned:
    """The map that `old` and `new` became, without older keyframes that newer ones repeat.

    `new` is one recording, laid out by itself. The store has only the keyframes that are left
    afterwards. Deterministic.
    """
    store, config = session.store, session.config
    if config.update.keep_all:
        return Thinned(joint, np.arange(len(joint)), len(old))
    of = np.searchsorted(joint.starts, np.arange(len(joint)), side="right")
    scans = [store.scan(first) for first in (0, *joint.starts)]  # each recording has one laser
    recorded = Recorded(
        poses=joint.layout.poses,
        of=of,
        enough=np.array([views_needed(scan, config.grid) for scan in scans]),
        all_round=np.array([scan.full_circle for scan in scans]),
    )
    gone = repeated(recorded, _named(joint, of))
    kept_for_walls = sole_views(
        store,
        gone[: len(old)],
        old.labels.poses,
        old.whole,
        _unseen(old, new, joint.layout.poses),
        config.grid.max_range_m,
    )
    gone[kept_for_walls] = False
    dropped = int(gone.sum())
    fewer = _without(store, joint, of, gone) if dropped else joint
    return Thinned(fewer, np.flatnonzero(~gone), len(old) - dropped, dropped, len(kept_for_walls))


def _named(laid: LaidOut, of: IntArray) -> BoolArray:
    """(n,) the keyframes that anything names."""
    named = np.zeros(len(of), dtype=bool)
    submaps = laid.labels.submaps
    for start, end in runs(of * (1 + submaps.max()) + submaps):
        named[[start, end - 1]] = True
    for own in laid.stays.values():
        named[[own[0], min(own), max(own)]] = True
    named[list(laid.breaks)] = True
    for place, border in enumerate(laid.borders):
        if isinstance(border, Merge):
            became = list(heirs(border.kept, laid.borders[place + 1 :]))
            named[: border.known] |= np.isin(submaps[: border.known], became)
    return named


def _unseen(old: LaidOut, new: LaidOut, poses: FloatArray) -> BoolArray:
    """(H, W) the old walls at which the new recording did not look; `poses` of both (n, 3)."""
    whole, count = old.whole, len(old.labels.poses)
    cells = np.argwhere(whole.occupied)
    places = propagated_places(whole.centres_of(cells), old.labels.poses, poses[:count])
    places = propagated_places(places, poses[count:], new.labels.poses)
    known = cv2.dilate((new.whole.cells != UNKNOWN).astype(np.uint8), np.ones((3, 3)))
    there = new.whole.cells_of(places)
    inside = new.whole.inside(there)
    looked = np.zeros(len(cells), dtype=bool)
    looked[inside] = known[there[inside, 0], there[inside, 1]] > 0
    unseen = np.zeros(whole.cells.shape, dtype=bool)
    unseen[cells[~looked, 0], cells[~looked, 1]] = True
    return unseen


def _without(store: KeyframeStore, laid: LaidOut, of: IntArray, gone: BoolArray) -> LaidOut:
    """The map and the store without some keyframes, renumbered; recordings keep their lengths."""
    numbers = np.flatnonzero(~gone)
    row = {number: k for k, number in enumerate(numbers.tolist())}
    breaks = {row[number]: bridge for number, bridge in laid.breaks.items()}
    labels, placed = laid.labels, laid.layout.poses
    logs = []
    for log, way_m in zip(laid.logs, ways_m(laid.logs, laid.labels), strict=True):
        if log.keyframes is not None:
            first, last = (row[one] for one in log.keyframes)
            whole = last - first == log.keyframes[1] - log.keyframes[0]
            path_m = log.path_m if whole else way_m
            log = replace(log, keyframes=(first, last), path_m=path_m)
        logs.append(log)
    gaps = gaps_in(placed[numbers], logs)
    store.keep(numbers, tracked_over_gaps(store.poses, placed, numbers, gaps))
    layout = without_keyframes(store, laid.layout, numbers, of, {**gaps, **breaks})
    return replace(
        laid,
        layout=layout,
        labels=Labels(
            stamps_ns=labels.stamps_ns[numbers], poses=layout.poses, submaps=labels.submaps[numbers]
        ),
        stays={
            number: tuple(row[one] for one in own if one in row)
            for number, own in laid.stays.items()
        },
        breaks=breaks,
        logs=tuple(logs),
        borders=tuple(
            replace(
                border,
                runs=runs_of([row[one] for one in border.keyframes]),
                known=border.known - int(gone[: border.known].sum()),
            )
            if isinstance(border, Merge)
            else border
            for border in laid.borders
        ),
    )
