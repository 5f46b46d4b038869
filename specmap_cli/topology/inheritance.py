"""Submaps that stay: what is known keeps its id and its border, only new space is divided afresh.

A new keyframe in the territory of an old submap belongs to it. Beyond it, another division says
what hangs together: the rest of a room that was half seen goes to the submap of that room, anything
else becomes a new submap with an id that no other ever had. So does a room that the robot had only
looked into from its door.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from specmap_cli.core.geometry import FloatArray, compose, invert, step_lengths
from specmap_cli.core.records import IntArray
from specmap_cli.topology.graph import settle_labels
from specmap_cli.topology.regions import NOBODY, Regions

_MOST = 0.5  # share of a submap in one region of the joint map: that region is the same place


@dataclass(frozen=True, slots=True)
class Heritage:
    """A map that new keyframes are added to.

    `poses` (n, 3) and `submaps` (n,) of its keyframes, `regions` the division of its cells, all as
    they were in that map. `next_id` is the first id that no submap of it ever had.
    """

    poses: FloatArray
    submaps: IntArray
    regions: Regions
    next_id: int


def inherited(old: Heritage, poses: FloatArray, divided: IntArray, region_min_m: float) -> IntArray:
    """The submap (m,) of each keyframe of a joint map: those of the old map, then the new ones.

    `poses` (m, 3) are those in the joint map, `divided` (m,) the region of another division that
    each keyframe lies in, NOBODY outside of it. Old keyframes keep their submaps. New space on
    which the robot drove less than `region_min_m` becomes no submap of its own.
    """
    count = len(old.poses)
    labels = np.concatenate([old.submaps, _territory(old, poses)])
    known = _driven_in(divided[:count], poses[:count], region_min_m)
    strange = (labels == NOBODY) | ~np.isin(divided, known)
    strange[:count] = False
    heirs = {**_mostly_in(labels, divided, known), **_heirs(old.submaps, divided[:count])}
    names = _names(divided[strange].tolist(), heirs, old.next_id)
    labels[strange] = [names[region] for region in divided[strange].tolist()]
    own = _without_grazed(labels[count:], poses[count:], old.next_id, region_min_m)
    labels[count:] = settle_labels(own, poses[count:], region_min_m)
    return _renumbered(labels, old.next_id)


def _territory(old: Heritage, poses: FloatArray) -> IntArray:
    """(m - n,) the old submap in whose region each new keyframe lies, NOBODY outside.

    A place is carried back into the old map by the old keyframe nearest to it.
    """
    count = len(old.poses)
    nearest = cKDTree(poses[:count, :2]).query(poses[count:, :2])[1]
    back = compose(old.poses[nearest], compose(invert(poses[nearest]), poses[count:]))
    return old.regions.owners(back)


def _driven_in(divided: IntArray, poses: FloatArray, way_m: float) -> list[int]:
    """The regions of the division in which old keyframes drove `way_m` or more.

    What the old robot only looked into through a door is not known, whoever got its cells.
    """
    steps = np.append(step_lengths(poses), 0.0)
    regions = np.unique(divided[divided != NOBODY]).tolist()
    return [region for region in regions if steps[divided == region].sum() >= way_m]


def _mostly_in(labels: IntArray, divided: IntArray, known: Sequence[int]) -> dict[int, int]:
    """For regions of the division whose keyframes lie for the most part in one submap: its id."""
    found = {}
    for region in known:
        submap, share = _commonest(labels[divided == region])
        if submap != NOBODY and share > _MOST:
            found[region] = submap
    return found


def _heirs(submaps: IntArray, divided: IntArray) -> dict[int, int]:
    """For regions of the division that are an old submap's place: its id.

    Most of the old keyframes of the submap lie there, and of all such submaps it has the most.
    """
    heirs: dict[int, tuple[float, int]] = {}
    for submap in np.unique(submaps[submaps != NOBODY]).tolist():
        region, share = _commonest(divided[submaps == submap])
        count = share * np.count_nonzero(submaps == submap)
        if region != NOBODY and share > _MOST and count > heirs.get(region, (0.0, 0))[0]:
            heirs[region] = (count, submap)
    return {region: submap for region, (_, submap) in heirs.items()}


def _commonest(values: IntArray) -> tuple[int, float]:
    """The commonest of some values (n,), the smaller of equals, and its share."""
    found, counts = np.unique(values, return_counts=True)
    most = int(counts.argmax())
    return int(found[most]), float(counts[most] / counts.sum())


def _names(regions: list[int], heirs: dict[int, int], next_id: int) -> dict[int, int]:
    """The submap of each region with new space, new ids in the order of appearance."""
    names: dict[int, int] = {}
    for region in regions:
        if region not in names and region in heirs:
            names[region] = heirs[region]
        elif region not in names:
            names[region] = next_id
            next_id += 1
    return names


def _without_grazed(labels: IntArray, poses: FloatArray, next_id: int, way_m: float) -> IntArray:
    """Labels (k,) without new submaps driven less than `way_m`: these go to where the robot was.

    A recording that is nowhere else makes a submap, however little it drove.
    """
    steps = np.append(step_lengths(poses), 0.0)
    grazed = [
        label
        for label in np.unique(labels[labels >= next_id]).tolist()
        if steps[labels == label].sum() < way_m
    ]
    stays = ~np.isin(labels, grazed)
    if not stays.any():
        return labels
    source = np.where(stays, np.arange(len(labels)), int(np.argmax(stays)))
    return np.asarray(labels[np.maximum.accumulate(source)], dtype=np.int64)


def _renumbered(labels: IntArray, next_id: int) -> IntArray:
    """Labels whose new ids have no gaps, in the order of first visit."""
    order: dict[int, int] = {}
    for label in labels[labels >= next_id].tolist():
        order.setdefault(label, next_id + len(order))
    return np.array([order.get(label, label) for label in labels.tolist()], dtype=np.int64)
