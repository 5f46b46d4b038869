"""The topology from the regions: which belong together, visits, edges and their transforms.

While the robot drives, `RegionMerger` remembers which regions are one submap; at the end
`build_topology` derives everything else from the submap of each keyframe, as a pure function.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import Closure
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.topology.topological_map import Edge, Submap, TopologicalMap, Traversal, Visit

IntArray = NDArray[np.int64]

_MEETING_M = 0.5


class RegionMerger:
    """Disjoint sets of region numbers; the smallest number of a set is its submap."""

    def __init__(self) -> None:
        self._parent: dict[int, int] = {}

    def add(self, region: int) -> None:
        """A region of its own, until merged."""
        self._parent.setdefault(region, region)

    def merge(self, old: int, new: int) -> int:
        """Make two regions one submap; returns its number."""
        a, b = sorted((self.find(old), self.find(new)))
        self._parent[b] = a
        return a

    def find(self, region: int) -> int:
        """The submap a region belongs to."""
        while self._parent[region] != region:
            self._parent[region] = self._parent[self._parent[region]]
            region = self._parent[region]
        return region

    def members(self, submap: int) -> list[int]:
        """All regions of a submap, ascending."""
        return [region for region in sorted(self._parent) if self.find(region) == submap]


def settle_labels(labels: IntArray, poses: FloatArray, min_path_m: float) -> IntArray:
    """Labels (n,) of successive keyframes without excursions: a stay shorter than `min_path_m` of
    path between two stays in one submap becomes part of that submap.
    """
    settled = labels.copy()
    steps = np.zeros(len(labels))
    steps[1:] = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    path = np.cumsum(steps)
    runs = _runs(settled)
    for before, (start, end), after in zip(runs, runs[1:], runs[2:], strict=False):
        same = settled[before[0]] == settled[after[0]]
        if same and path[end - 1] - path[start] < min_path_m:
            settled[start:end] = settled[before[0]]
    return settled


def _runs(labels: IntArray) -> list[tuple[int, int]]:
    """Half-open ranges of equal successive labels."""
    if not len(labels):
        return []
    cuts = np.flatnonzero(np.diff(labels)) + 1
    bounds = [0, *cuts.tolist(), len(labels)]
    return list(pairwise(bounds))


def first_visit_order(labels: Iterable[int]) -> dict[int, int]:
    """New consecutive numbers for the labels, in order of their first appearance."""
    order: dict[int, int] = {}
    for label in labels:
        order.setdefault(int(label), len(order))
    return order


def build_topology(
    labels: IntArray,
    poses: FloatArray,
    stamps_ns: Sequence[int],
    breaks: Sequence[int],
    closures: Sequence[Closure],
    submap_of_region: dict[int, int],
    grids: dict[int, GridMap],
) -> TopologicalMap:
    """The topological map of keyframes with submap `labels` (n,) and `poses` (n, 3) in the map.

    Submaps are linked where the robot drove across, and where a verified closure shows that its
    tracks meet. `breaks` are keyframes at which tracking restarted: what lies before is linked by a
    loose edge only. `closures` name regions, which `submap_of_region` maps to labels; `grids` are
    in the frames of the submaps, whose origin is the pose of their first keyframe.
    """
    topology = TopologicalMap(closures=list(closures))
    runs = _runs(labels)
    for start, end in runs:
        submap = int(labels[start])
        visit = Visit(stamps_ns[start], stamps_ns[end - 1])
        if submap not in topology.submaps:
            frame = Pose2(*poses[start].tolist())
            topology.submaps[submap] = Submap(submap, frame, [], [], grids[submap])
        topology.submaps[submap].keyframes.extend(range(start, end))
        topology.submaps[submap].visits.append(visit)
    for (start, end), (after, _) in pairwise(runs):
        source, target = int(labels[start]), int(labels[after])
        if after in breaks:
            _edge(topology, source, target, "loose")
            continue
        edge = _edge(topology, source, target, "traversed")
        crossing = Pose2(*((poses[end - 1] + poses[after]) / 2.0).tolist())
        crossing = crossing._replace(theta=float(poses[after, 2]))
        edge.traversals.append(Traversal(stamps_ns[after], source, target, crossing))
    for closure in closures:
        if closure.verified and not closure.merged:
            old, new = submap_of_region[closure.old], submap_of_region[closure.new]
            if old != new and _tracks_meet(poses[labels == old], poses[labels == new]):
                _edge(topology, old, new, "closure")
    return topology


def _tracks_meet(a: FloatArray, b: FloatArray) -> bool:
    """Whether the robot was at one place in both submaps: no wall is thinner than that."""
    return float(cKDTree(a[:, :2]).query(b[:, :2])[0].min()) < _MEETING_M


_STRENGTH = {"loose": 0, "closure": 1, "traversed": 2}


def _edge(topology: TopologicalMap, source: int, target: int, kind: str) -> Edge:
    """The edge between two submaps, made or raised to the stronger kind."""
    low, high = min(source, target), max(source, target)
    edge = topology.edges.get((low, high))
    if edge is None:
        frames = topology.submaps
        transform = frames[low].map_from_submap.inverse() @ frames[high].map_from_submap
        edge = Edge(low, high, "loose", [], transform)
        topology.edges[low, high] = edge
    if _STRENGTH[kind] > _STRENGTH[edge.kind]:
        edge = replace(edge, kind=kind)  # type: ignore[arg-type]
        topology.edges[low, high] = edge
    return edge
