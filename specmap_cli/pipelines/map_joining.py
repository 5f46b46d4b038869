"""Two maps in one: the new one laid into the old one, whose submaps keep their ids."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.findings import Finding
from specmap_cli.core.geometry import FloatArray, Pose2, compose, nearest_motion
from specmap_cli.core.records import Closure, IntArray, Labels, Trajectory
from specmap_cli.core.settings import Config
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.carrying import carried, rows_of
from specmap_cli.layout.dropping import gaps_of
from specmap_cli.layout.healing import Audited, healed
from specmap_cli.layout.joining import join_layouts, placed, without_guesses
from specmap_cli.layout.motion_edges import Bridge
from specmap_cli.layout.relaxation import Layout
from specmap_cli.pipelines.joint_edits import edits_of_both, without_borders
from specmap_cli.pipelines.kept_map import KeptMap, Seen, thinned_of
from specmap_cli.pipelines.refutation import constraints_of, refute
from specmap_cli.recognition.closure.joints import Joint
from specmap_cli.topology.graph import Heritage, inherited
from specmap_cli.topology.regions import Regions
from specmap_cli.topology.topological_map import LogInfo, starts_of

_JOINED = "the maps were joined here"
_APART_M = 20.0  # between maps that have nothing in common: walls within it are never matched


@dataclass(frozen=True, slots=True)
class Joined:
    """Two maps in one: the map that was `kept`, and the audit of its layout."""

    kept: KeptMap
    audited: Audited


def join(
    store: KeyframeStore,
    old: KeptMap,
    regions: Regions,
    new: Seen,
    old_from_new: Pose2,
    found: Sequence[Closure],
    config: Config,
) -> Joined:
    """The old map with the new one laid into it; `store` holds the keyframes of both, in order.

    `regions` divide the cells of the old map. `found` are closures between the two: `old` is the
    number of a stay of the old map, `new` that of one of the new map. Every submap of the old map
    keeps its keyframes and its id. The borders that a person moved in the new map are edits of the
    joint one, which are still to be made.
    """
    first, stay = len(old.labels.stamps_ns), 1 + max(old.stays, default=-1)
    later = _renumbered(new.kept, old_from_new, first, stay)
    stays = {**old.stays, **later.stays}
    found = tuple(replace(closure, new=closure.new + stay) for closure in found)
    breaks = {**old.breaks, first: None, **later.breaks}
    constraints = constraints_of(found, stays, store)
    ties = tuple(constraints.values())
    cuts = {**_gaps(store, old, later), **breaks}
    layout = join_layouts(store, old.layout, later.layout, ties, cuts)
    layout = _in_frame_of(old.layout, layout)
    audited = healed(store, layout, cuts)
    layout = without_guesses(audited.layout, (*old.starts, first, *later.starts))
    plain = without_borders(new)
    submaps = inherit(old, regions, plain, layout.poses, old_from_new, config)
    free = max(old.next_id, 1 + int(submaps.max(initial=-1)))
    said = edits_of_both(old, plain.kept, submaps[first:], old_from_new, free)
    stamps = np.array(store.stamps_ns, dtype=np.int64)
    kept = KeptMap(
        layout=layout,
        labels=Labels(stamps_ns=stamps, poses=layout.poses, submaps=submaps),
        trajectory=_trajectory(old, new.kept, layout),
        stays=stays,
        closures=(*old.closures, *later.closures, *refute(found, constraints, layout)),
        breaks=breaks,
        logs=(*old.logs, *later.logs),
        findings=(*old.findings, *later.findings),
        edits=said.edits,
        edits_text=old.edits_text,
        lost=(*old.lost, *said.lost),
        borders=old.borders,
        next_id=said.next_id,
    )
    return Joined(kept, replace(audited, layout=layout))


def _in_frame_of(old: Layout, joint: Layout) -> Layout:
    """The joint layout where its old keyframes lie nearest to their places in the old map."""
    count = len(old.poses)
    return placed(joint, nearest_motion(joint.poses[:count, :2], old.poses[:, :2]))


def _gaps(store: KeyframeStore, old: KeptMap, later: KeptMap) -> dict[int, Bridge]:
    """Where keyframes of either were let go."""
    logs = (*old.logs, *later.logs)
    number = np.arange(len(store))
    recordings = np.searchsorted(np.array(starts_of(logs)), number, side="right")
    return gaps_of(store.poses, thinned_of(logs, recordings))


def beside(old: GridMap, new: GridMap) -> Pose2:
    """A place for a map that fits nowhere: to the right of the old map, with a gap between them."""
    (left, low), (x, y) = old.origin, new.origin
    right = left + old.cells.shape[1] * old.resolution
    return Pose2(right + _APART_M - x, low - y, 0.0)


def _renumbered(kept: KeptMap, old_from_new: Pose2, first: int, first_stay: int) -> KeptMap:
    """The map in another one's frame, its keyframes and stays numbered behind those of that."""
    return replace(
        kept,
        layout=placed(kept.layout, old_from_new, first),
        stays={
            number + first_stay: tuple(keyframe + first for keyframe in own)
            for number, own in kept.stays.items()
        },
        closures=tuple(
            replace(closure, new=closure.new + first_stay, old=closure.old + first_stay)
            for closure in kept.closures
        ),
        breaks={number + first: bridge for number, bridge in kept.breaks.items() if number},
        findings=tuple(moved_finding(finding, old_from_new) for finding in kept.findings),
        logs=tuple(_later(log, first) for log in kept.logs),
    )


def _later(log: LogInfo, first: int) -> LogInfo:
    """A recording whose keyframes are numbered from `first` on."""
    if log.keyframes is None:
        return log
    start, end = log.keyframes
    return replace(log, keyframes=(start + first, end + first))


def moved_finding(finding: Finding, old_from_new: Pose2) -> Finding:
    """A finding at its place in another map."""
    if finding.where is None or finding.place is None:
        return finding
    x, y = old_from_new.apply(np.array([finding.place]))[0].tolist()
    return replace(finding, where=replace(finding.where, x=x, y=y))


def closures_between(old: KeptMap, new: KeptMap, joints: Sequence[Joint]) -> tuple[Closure, ...]:
    """What the joints of an alignment say, as closures between the longest stays in the submaps.

    Each names the stays by the numbers that they have in their own maps.
    """
    found = []
    for joint in joints:
        one, other = _longest_stay(old, joint.old), _longest_stay(new, joint.new)
        if one is None or other is None:
            continue
        frames = [
            Pose2(*kept.layout.poses[kept.stays[number][0]].tolist())
            for kept, number in ((old, one), (new, other))
        ]
        found.append(
            Closure(
                new=other,
                old=one,
                xi=np.nan,
                claims_new_by_old=np.nan,
                claims_old_by_new=np.nan,
                verified=True,
                merged=True,
                score=joint.check.score,
                reason=_JOINED,
                old_from_new=frames[0].inverse() @ joint.map_from_map @ frames[1],
            )
        )
    return tuple(found)


def _longest_stay(kept: KeptMap, submap: int) -> int | None:
    """The stay with the most keyframes of a submap, the first of equals; None without any."""
    counts = {
        number: int(np.count_nonzero(kept.labels.submaps[list(keyframes)] == submap))
        for number, keyframes in kept.stays.items()
    }
    best = max(counts, key=lambda number: (counts[number], -number), default=None)
    return best if best is not None and counts[best] else None


def inherit(
    old: KeptMap,
    regions: Regions,
    new: Seen,
    poses: FloatArray,
    old_from_new: Pose2,
    config: Config,
) -> IntArray:
    """The submap (m,) of each keyframe of both maps, which lie at `poses` (m, 3).

    Old ones stay in their submaps, new ones get into these; `regions` divide the old map.
    """
    there = compose(np.array(old_from_new.inverse()), old.labels.poses)
    divided = np.concatenate([new.regions.owners(there), new.kept.labels.submaps])
    heritage = heritage_of(old, regions)
    return inherited(heritage, poses, divided, config.segmentation.region_min_m)


def heritage_of(old: KeptMap, regions: Regions) -> Heritage:
    """What a map hands down; `regions` divide it."""
    return Heritage(old.labels.poses, old.labels.submaps, regions, old.next_id)


def _trajectory(old: KeptMap, new: KeptMap, layout: Layout) -> Trajectory:
    """All scans of both maps, moved with the keyframes of the joint layout."""
    count = len(old.labels.stamps_ns)
    parts = (old, layout.poses[:count]), (new, layout.poses[count:])
    poses = [_carried(kept, now) for kept, now in parts]
    ways = old.trajectory, new.trajectory
    return Trajectory(
        stamps_ns=np.concatenate([way.stamps_ns for way in ways]),
        poses=np.concatenate(poses),
        tilt=_both([way.tilt for way in ways], [(len(way.poses), 3) for way in ways]),
        lost=_both([way.lost for way in ways], [(len(way.poses),) for way in ways], np.bool_),
    )


def _carried(kept: KeptMap, now: FloatArray) -> FloatArray:
    """The trajectory of a map whose keyframes lie at poses `now` (n, 3)."""
    labels = kept.labels
    rows = rows_of(kept.trajectory, labels.stamps_ns.tolist(), labels.poses)
    return carried(kept.trajectory.poses, rows, now[: len(rows)])


def _both(
    parts: Sequence[NDArray[Any] | None], shapes: Sequence[tuple[int, ...]], kind: Any = np.float64
) -> NDArray[Any] | None:
    """Columns of both trajectories, zero where one has none; None where neither has any."""
    if all(part is None for part in parts):
        return None
    filled = [
        np.zeros(shape, dtype=kind) if part is None else part
        for part, shape in zip(parts, shapes, strict=True)
    ]
    return np.concatenate(filled)
