"""The topology from the submap of each keyframe: visits, edges and their transforms, stays.

Pure functions. While the robot drives, regions are recognised as one: `submap_of_regions` says
which. At the end `build_topology` derives all else from the submap of each keyframe.

When a log joins a map that is there, `inherited` gives the submap of each keyframe: what is known
keeps its id and its border, only new space is divided afresh. A new keyframe in the territory of an
old submap belongs to it. Beyond it, another division says what hangs together: the rest of a room
that was half seen goes to the submap of that room, anything else becomes a new submap with an id
that no other ever had. So does a room that the robot had only looked into from its door, and what
a new wall cuts off from its submap (`walled_off`).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import pairwise

import cv2
import numpy as np
from scipy.cluster.hierarchy import DisjointSet
from scipy.spatial import cKDTree

from specmap_cli.core.arrays import carried_on, runs, windows_of
from specmap_cli.core.geometry import FloatArray, Pose2, compose, invert, step_lengths
from specmap_cli.core.json_values import runs_of
from specmap_cli.core.records import Closure, IntArray, Labels
from specmap_cli.grids.gridmap import GridMap, clearance_of, nearest_values
from specmap_cli.topology.regions import NOBODY, Pair, Regions
from specmap_cli.topology.topological_map import (
    Break,
    EdgeKind,
    Stay,
    Submap,
    TopologicalMap,
    Traversal,
    Visit,
    edge_between,
)

# A robot keeps its own radius off both sides of a wall: tracks this near are in one room.
_MEETING_M = 0.5
_AROUND = np.ones((3, 3), dtype=np.uint8)
_LEAK = 1.5  # cells: a gap beside a wall that is no wider is a beam's

Span = tuple[int, int]


def submap_of_regions(regions: Iterable[int], merges: Iterable[Pair]) -> dict[int, int]:
    """The submap of each region: the smallest number of the regions merged with it.

    `merges` are pairs of regions that are one submap, in any order and over any others. Raises
    KeyError for a merge of what is no region.
    """
    sets = DisjointSet(regions)
    for a, b in merges:
        sets.merge(a, b)
    return {region: min(together) for together in sets.subsets() for region in together}


def build_topology(
    *,
    labels: Labels,
    breaks: Sequence[Break],
    closures: Sequence[Closure],
    stays: Sequence[Stay],
    grids: Mapping[int, GridMap],
    starts: Collection[int] = (),
) -> TopologicalMap:
    """The topological map of the keyframes.

    Submaps are linked where the robot drove across, and where a verified closure shows that its
    tracks meet. `breaks` are where tracking restarted: what lies before is linked by a loose edge
    only. `closures` name `stays` by their numbers; `grids` are in the frames of the submaps, whose
    origin is the pose of their first keyframe. `starts` are the keyframes with which other
    recordings begin: nobody drove from the one before to these.
    """
    own, places = labels.submaps, labels.poses[:, :2]
    recording = np.isin(np.arange(len(own)), list(starts)).cumsum()
    both = np.unique(np.column_stack([recording, own]), axis=0, return_inverse=True)[1]
    spans = runs(both.reshape(-1))  # in one submap, and of one recording
    submaps = _submaps(labels, spans, grids)
    traversals = _traversals(labels, spans, starts, {each.keyframe for each in breaks})
    submap_of = {stay.number: stay.submap for stay in stays}
    recognised: dict[Pair, None] = {}
    for closure in closures:
        if closure.verified and not closure.merged:
            low, high = sorted((submap_of[closure.old], submap_of[closure.new]))
            if low != high and (low, high) not in recognised:
                away = cKDTree(places[own == low]).query(places[own == high])[0]
                if float(np.min(away, initial=np.inf)) < _MEETING_M:
                    recognised[low, high] = None
    edges = {}
    for pair in {**traversals, **recognised}:
        crossed = tuple(traversals.get(pair, ()))
        kind: EdgeKind = "closure" if pair in recognised else "loose"
        edges[pair] = edge_between(submaps, pair, "traversed" if crossed else kind, crossed)
    return TopologicalMap(
        submaps=submaps,
        edges=edges,
        closures=tuple(closures),
        stays=tuple(stays),
        breaks=tuple(breaks),
        next_id=1 + max(submaps, default=-1),
    )


def stays_of(regions: Mapping[int, Sequence[int]], labels: Labels) -> tuple[Stay, ...]:
    """The regions that the robot left on its way, with the submap that each became part of.

    `regions` are the keyframes of each region, that of its frame first, by its number. Of submaps
    that share a region, that with the most keyframes of it has it, the smallest of equals.
    """
    stamps_ns = labels.stamps_ns.tolist()
    return tuple(
        Stay(
            number=number,
            submap=int(np.bincount(labels.submaps[list(keyframes)]).argmax()),
            runs=runs_of(sorted(keyframes)),
            origin=keyframes[0],
            start_ns=stamps_ns[min(keyframes)],
            end_ns=stamps_ns[max(keyframes)],
        )
        for number, keyframes in sorted(regions.items())
    )


def _submaps(
    labels: Labels, spans: Sequence[Span], grids: Mapping[int, GridMap]
) -> dict[int, Submap]:
    """The submaps in order of first visit; a span is a half-open range of keyframes."""
    visits: dict[int, list[Span]] = {}
    for span in spans:
        visits.setdefault(int(labels.submaps[span[0]]), []).append(span)
    stamps_ns = labels.stamps_ns.tolist()
    return {
        id_: Submap(
            id=id_,
            map_from_submap=Pose2(*labels.poses[own[0][0]].tolist()),
            keyframes=tuple(keyframe for span in own for keyframe in range(*span)),
            visits=tuple(Visit(stamps_ns[start], stamps_ns[end - 1]) for start, end in own),
            grid=grids[id_],
        )
        for id_, own in visits.items()
    }


def _traversals(
    labels: Labels, spans: Sequence[Span], starts: Collection[int], breaks: Collection[int]
) -> dict[Pair, list[Traversal]]:
    """Each crossing from a visit to the next, by pair; none over a restart of tracking."""
    submaps, poses = labels.submaps.tolist(), labels.poses
    found: dict[Pair, list[Traversal]] = {}
    for (start, end), (after, _) in pairwise(spans):
        if after in starts:
            continue
        source, target = submaps[start], submaps[after]
        crossed = found.setdefault((min(source, target), max(source, target)), [])
        if after not in breaks:
            x, y, _ = ((poses[end - 1] + poses[after]) / 2.0).tolist()
            theta = float(poses[after, 2])
            stamp_ns = int(labels.stamps_ns[after])
            crossed.append(Traversal(stamp_ns, source, target, x, y, theta))
    return found


_MOST = 0.5  # share of a submap in one region of the joint map: that region is the same place


def inherited(
    old: Labels,
    regions: Regions,
    next_id: int,
    poses: FloatArray,
    divided: IntArray,
    region_min_m: float,
) -> IntArray:
    """The submap (m,) of each keyframe of a joint map: those of the old map, then the new ones.

    `old` and `regions` are the keyframes of the old map and the division of its cells, `next_id` is
    the first id that no submap of it ever had. `poses` (m, 3) are those in the joint map, `divided`
    (m,) the region of another division that each keyframe lies in, NOBODY outside of it. Old
    keyframes keep their submaps. New space on which the robot drove less than `region_min_m`
    becomes no submap of its own.
    """
    count = len(old.poses)
    # carried back into the old map by the old keyframe nearest to it, a new one has a territory
    nearest = cKDTree(poses[:count, :2]).query(poses[count:, :2])[1]
    back = compose(old.poses[nearest], compose(invert(poses[nearest]), poses[count:]))
    labels = np.concatenate([old.submaps, regions.owners(back)])
    # what the old robot only looked into through a door is not known, whoever got its cells
    driven_m = metres_in(divided[:count], poses[:count])
    known = [region for region, way_m in driven_m.items() if way_m >= region_min_m]
    strange = (labels == NOBODY) | ~np.isin(divided, known)
    strange[:count] = False
    heirs = _heirs(labels, old.submaps, divided, known)
    names: dict[int, int] = {}
    for region in divided[strange].tolist():
        names.setdefault(region, heirs.get(region, next_id + len(names)))
    labels[strange] = [names[region] for region in divided[strange].tolist()]
    # what was hardly driven on goes to where the robot was, unless the recording is nowhere else
    own = labels[count:]
    grazed = [
        label
        for label, way_m in metres_in(own, poses[count:]).items()
        if label >= next_id and way_m < region_min_m
    ]
    stays = ~np.isin(own, grazed)
    if stays.any():
        labels[count:] = carried_on(own, stays)
    new = labels >= next_id
    labels[new] = next_id + by_appearance(labels[new])  # new ids have no gaps
    return labels


def walled_off(
    labels: IntArray, poses: FloatArray, old: Regions, grid: GridMap, next_id: int, least_m: float
) -> IntArray:
    """The submap (m,) of each keyframe at `poses` (m, 3), where walls cut no submap in two.

    `old` are the submaps as they were, `grid` is the map as it is now. What a submap had as one
    piece of floor and has as several, each with `least_m` of way or more, are several submaps: that
    with the most way keeps the id, the others get new ones from `next_id` on. Most of the rim of
    such a piece was so before: else it is where a thing stands now.
    """
    labels = labels.copy()
    was_roomy, roomy = (clearance_of(each.free) > _LEAK for each in (old.grid, grid))
    for id_, window in windows_of(old.owner).items():
        corner = [part.start for part in window]
        before = ((old.owner[window] == id_) & was_roomy[window]).astype(np.uint8)
        now, cells = before.copy(), np.argwhere(before)
        now[tuple(cells.T)] = grid.under(old.grid.centres_of(cells + corner), roomy, False)
        mine = np.flatnonzero(labels == id_)
        at = np.clip(old.grid.cells_of(poses[mine, :2]) - corner, 0, np.array(now.shape) - 1)
        wholes, parts = (cv2.connectedComponents(f, connectivity=4)[1] for f in (before, now))
        whole, piece = (nearest_values(each)[0][tuple(at.T)] for each in (wholes, parts))
        stays = piece[1:] == piece[:-1]
        way_m = np.zeros(1 + int(piece.max(initial=0)))
        np.add.at(way_m, piece[1:][stays], step_lengths(poses[mine])[stays])
        for part in np.unique(whole).tolist():
            pieces = np.unique(piece[whole == part])
            pieces = pieces[np.argsort(-way_m[pieces], kind="stable")]  # the first keeps the id
            for one in pieces[1:][way_m[pieces[1:]] >= least_m].tolist():
                rim = cv2.dilate((parts == one).view(np.uint8), _AROUND) > now
                if before[rim].mean() < _MOST:
                    labels[mine[(whole == part) & (piece == one)]] = next_id
                    next_id += 1
    return labels


def by_appearance(labels: IntArray) -> IntArray:
    """(n,) labels numbered from 0 on as they appear."""
    _, first, which = np.unique(labels, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[which]


def metres_in(labels: IntArray, poses: FloatArray) -> dict[int, float]:
    """How far the robot drove in each submap or region."""
    steps = np.append(step_lengths(poses), 0.0)
    found = np.unique(labels[labels != NOBODY]).tolist()
    return {label: float(steps[labels == label].sum()) for label in found}


def _heirs(
    labels: IntArray, old: IntArray, divided: IntArray, known: Iterable[int]
) -> dict[int, int]:
    """The submap that new space in a region of the division goes to, for some of them.

    An old submap goes on where most of its keyframes, `old` (n,), are; of several in one region
    that with the most. A `known` region without one goes to the submap of most of its keyframes.
    """
    heirs = {}
    for region in known:
        submap, share = _commonest(labels[divided == region])
        if submap != NOBODY and share > _MOST:
            heirs[region] = submap
    most: dict[int, float] = {}
    for submap in np.unique(old[old != NOBODY]).tolist():
        mine = divided[: len(old)][old == submap]
        region, share = _commonest(mine)
        if region != NOBODY and share > _MOST and share * len(mine) > most.get(region, 0.0):
            most[region], heirs[region] = share * len(mine), submap
    return heirs


def _commonest(values: IntArray) -> tuple[int, float]:
    """The commonest of some values (n,), the smaller of equals, and its share."""
    found, counts = np.unique(values, return_counts=True)
    most = int(counts.argmax())
    return int(found[most]), float(counts[most] / counts.sum())
