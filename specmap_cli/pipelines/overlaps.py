"""Where maps of one building lie in one another: what aligns two, which of several overlap.

Along a bare corridor without odometry a map may be wrong by metres, and says so. Two maps of it
then differ in length: no rigid motion lays one on the other. So a new one that fits nowhere as it
is is tried with other lengths of the stretch whose length was guessed, and where one of them is
right, it is given that of the old map.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import networkx as nx
import numpy as np

from specmap_cli.core.findings import Finding
from specmap_cli.core.geometry import BentMotion, FloatArray, LocalMotion, Pose2, travelled
from specmap_cli.core.process import one_blas_thread
from specmap_cli.core.records import IntArray, Labels
from specmap_cli.core.settings import Config, GridConfig
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.grids.keyframes import KeyframeStore, integrate_keyframes
from specmap_cli.maps.filenames import KEYFRAMES
from specmap_cli.maps.store import Map, read_map
from specmap_cli.pipelines.learning import submap_grids
from specmap_cli.pipelines.map_in_making import LaidOut, quality_of_stored
from specmap_cli.pipelines.session import Session
from specmap_cli.quality.findings import UNMEASURED
from specmap_cli.recognition.closure.alignment import Alignment, align
from specmap_cli.recognition.closure.common_ground import MapToAlign
from specmap_cli.recognition.learning.sampling import Track

Overlaps = Mapping[tuple[int, int], Alignment]  # of maps i < j: where j lies in i
# Two map directories, and the settings to align them with: it can be handed to a worker.
PairOfMaps = tuple[Path, Path, Config]
# What a function says of each of many pairs, in their order.
Spread = Callable[[Callable[[PairOfMaps], Alignment], Sequence[PairOfMaps]], Iterable[Alignment]]

_STEP_M = 0.5  # between lengths that are tried: submaps that lie off by half of it still match
_TOLD = 2.0  # times what both maps tell: four standard deviations
_MOST_STEPS = 8  # longer, and shorter: the search takes that many times as long
_ALONG_WAY_M = 0.02  # what the motion on the way may be off by, once a length is chosen
_AROUND_M = 1.0  # way to either side of its middle: its direction, and where it is lengthened


def stored_to_align(stored: Map) -> MapToAlign:
    """A stored map as the alignment takes it. Raises MapError for a damaged map."""
    return MapToAlign(
        whole=stored.map_grid,
        grids=stored.grids,
        frames={i: submap.map_from_submap for i, submap in stored.topology.submaps.items()},
    )


def laid_out_to_align(session: Session, laid: LaidOut) -> MapToAlign:
    """A recording that was laid out by itself as the alignment takes it."""
    with session.clock.stage("grids"):
        return _to_align(session.store, laid.whole, laid.labels, session.config.grid)


def _to_align(
    store: KeyframeStore,
    whole: GridMap,
    labels: Labels,
    config: GridConfig,
    longer_m: float = 0.0,
    heading: float = 0.0,
) -> MapToAlign:
    """What the store holds the keyframes of; with a stretch, `longer_m` towards `heading`."""
    track = Track.of(store, labels)
    return MapToAlign(
        whole=whole,
        grids=submap_grids(track, config),
        frames={id_: Pose2(*track.poses[own[0]].tolist()) for id_, own in track.submaps.items()},
        longer_m=longer_m,
        heading=heading,
    )


@one_blas_thread()
def align_pair(pair: PairOfMaps) -> Alignment:
    """Where the map of one directory lies in that of another. Raises MapError for a damaged map."""
    old, new, config = pair
    one, other = (stored_to_align(read_map(path, config.limits)) for path in (old, new))
    return align(one, other)


def overlaps_of(
    maps: Sequence[Map], to_align: Sequence[MapToAlign], config: Config, spread: Spread | None
) -> Overlaps:
    """The pairs of maps that can be aligned: here, or wherever `spread` has it done."""
    pairs = list(combinations(range(len(maps)), 2))
    found: Iterable[Alignment]
    if spread is None:
        found = (align(to_align[i], to_align[j]) for i, j in pairs)
    else:
        paths = [stored.path.resolve() for stored in maps]
        found = spread(align_pair, [(paths[i], paths[j], config) for i, j in pairs])
    return {
        pair: each for pair, each in zip(pairs, found, strict=True) if each.old_from_new is not None
    }


def parts_of(count: int, overlaps: Overlaps) -> list[set[int]]:
    """The maps that hang together, the part of the first map first."""
    graph = nx.Graph()
    graph.add_nodes_from(range(count))
    graph.add_edges_from(overlaps)
    return sorted(nx.connected_components(graph), key=min)


def steps_of(count: int, overlaps: Overlaps) -> list[tuple[int | None, int]]:
    """The maps in the order of joining, each with the one that it is laid into; None: beside all.

    Along the alignments that most wall speaks for (a maximum spanning tree).
    """
    graph = nx.Graph()
    graph.add_nodes_from(range(count))
    for (i, j), alignment in overlaps.items():
        graph.add_edge(i, j, weight=alignment.evidence_m)
    tree = nx.maximum_spanning_tree(graph)
    steps: list[tuple[int | None, int]] = []
    for part in parts_of(count, overlaps):
        first = min(part)
        steps += [(None, first), *nx.bfs_edges(tree, first, sort_neighbors=sorted)]
    return steps


@dataclass(frozen=True, slots=True)
class GuessedStretch:
    """The stretch of a map that may be off most, two standard deviations `off_m`.

    `keyframe` lies in its middle; those after it lie beyond.
    """

    keyframe: int
    off_m: float

    def heading(self, poses: FloatArray) -> float:
        """The direction of the stretch by the poses (n, 3) of all keyframes, radians."""
        way = travelled(poses)
        ends = way[self.keyframe] + np.array([-_AROUND_M, _AROUND_M])
        first, last = np.searchsorted(way, ends).clip(0, len(way) - 1).tolist()
        x, y = (poses[last, :2] - poses[first, :2]).tolist()
        return float(np.arctan2(y, x))

    def longer(self, poses: FloatArray, longer_m: float) -> FloatArray:
        """The poses (n, 3) of all keyframes with a stretch that is longer."""
        way, heading = travelled(poses), self.heading(poses)
        share = (way - way[self.keyframe] + _AROUND_M) / (2.0 * _AROUND_M)
        along = np.array([np.cos(heading), np.sin(heading), 0.0])
        return np.asarray(poses + longer_m * share.clip(0.0, 1.0)[:, None] * along)

    def motion(self, bent: BentMotion, poses: FloatArray, longer_m: float) -> BentMotion:
        """The motion of a map with that stretch, `bent`, as one of the map as it is.

        `poses` (n, 3) are those of all keyframes of the map as it is.
        """
        there = self.longer(poses, longer_m)
        number = np.unique(np.floor(travelled(poses) / _AROUND_M), return_index=True)[1]
        local = []
        for own, place in zip(poses[number, :2], there[number, :2], strict=True):
            x, y = (place - own).tolist()
            motion = bent.near(place) @ Pose2(x, y, 0.0)
            local.append(LocalMotion(own, motion, _ALONG_WAY_M))
        return BentMotion(bent.rigid, tuple(local))


def stretch_of(findings: Sequence[Finding], stamps_ns: IntArray) -> GuessedStretch | None:
    """The stretch of a recording that its findings say may be off most; None where none is.

    `stamps_ns` (n,) are those of its keyframes.
    """
    found = [
        (one.value, one.where.stamp_ns)
        for one in findings
        if one.code == UNMEASURED and one.value is not None
        if one.where is not None and one.where.stamp_ns is not None
    ]
    if not found:
        return None
    off_m, stamp_ns = max(found)
    return GuessedStretch(int(np.abs(stamps_ns - stamp_ns).argmin()), off_m)


def stretch_of_stored(stored: Map) -> GuessedStretch | None:
    """The same of a stored map of one recording: of several nobody knows what lies beyond.

    None of a map without its scans, too: it cannot be drawn with another length.
    """
    if len(stored.logs) != 1 or not (stored.path / KEYFRAMES).exists():
        return None
    return stretch_of(quality_of_stored(stored).findings, stored.labels.stamps_ns)


def told_m(findings: Sequence[Finding]) -> float:
    """By how much the length of a stretch may be off, the most that findings tell; 0 for none."""
    return max((one.value or 0.0 for one in findings if one.code == UNMEASURED), default=0.0)


def aligned(old: MapToAlign, new: MapToAlign, bent: Iterable[MapToAlign]) -> Alignment:
    """Where one map lies in another: with its other lengths, `bent`, if it fits nowhere as is."""
    found = align(old, new)
    return align(old, new, bent) if found.old_from_new is None and bent else found


def with_other_lengths(
    stretch: GuessedStretch, old_off_m: float, store: KeyframeStore, labels: Labels, config: Config
) -> Iterator[MapToAlign]:
    """A map as the alignment takes it, with its stretch longer and shorter.

    By as much as both maps may be off; `old_off_m` is what the other one tells. `labels` are those
    of the keyframes of the store.
    """
    steps = min(_MOST_STEPS, int(_TOLD * (stretch.off_m + old_off_m) / _STEP_M))
    heading = stretch.heading(labels.poses)
    for step in (*range(-steps, 0), *range(1, steps + 1)):
        longer_m = step * _STEP_M
        bent = replace(labels, poses=stretch.longer(labels.poses, longer_m))
        counts = integrate_keyframes(store, range(len(bent.poses)), bent.poses, config.grid)
        yield _to_align(store, counts.snapshot(), bent, config.grid, longer_m, heading)


def lengthened(laid: LaidOut, stretch: GuessedStretch, longer_m: float) -> LaidOut:
    """A recording that was laid out by itself, with a longer stretch; it is still to be drawn."""
    poses = stretch.longer(laid.layout.poses, longer_m)
    return replace(
        laid,
        layout=replace(laid.layout, poses=poses),
        labels=replace(laid.labels, poses=poses),
        trajectory=replace(laid.trajectory, poses=laid.way_through(poses)),
    )
