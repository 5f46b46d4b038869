"""What Algorithm 1 knows while the robot drives: the regions it left, and which it came back to."""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from specmap_cli.core.arrays import Neighbours, evenly, neighbours
from specmap_cli.core.geometry import FloatArray, compose, invert
from specmap_cli.core.records import Closure, IntArray, PosedScan, Trajectory
from specmap_cli.core.settings import Config
from specmap_cli.grids.gridmap import PackedGrid
from specmap_cli.grids.keyframes import KeyframeStore, integrate_keyframes
from specmap_cli.layout.motion_edges import Bridge
from specmap_cli.pipelines.stopwatch import Stopwatch
from specmap_cli.recognition.closure.claims import SAMPLES_PER_SUBMAP
from specmap_cli.recognition.closure.loop_closer import LoopCloser
from specmap_cli.recognition.closure.stay import Stay
from specmap_cli.recognition.features.sets import KeyframeFeatures
from specmap_cli.segmentation.online import Observer, OnlineSegmenter, Region
from specmap_cli.topology.graph import submap_of_regions

Regions = Mapping[int, Sequence[int]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Explored:
    """What Algorithm 1 found.

    `regions` holds the keyframes of each region that was left, that of its frame first. `closures`
    are all pairs of regions that were considered, in order. `breaks` are the keyframes at which
    tracking started afresh, and how well odometry bridges each. `features` are those of the
    keyframes, each computed once.
    """

    trajectory: Trajectory
    regions: Mapping[int, tuple[int, ...]]
    closures: tuple[Closure, ...]
    breaks: Mapping[int, Bridge | None]
    features: KeyframeFeatures


class Exploration:
    """The state of Algorithm 1 between two scans."""

    def __init__(
        self, config: Config, store: KeyframeStore, clock: Stopwatch, observer: Observer | None
    ) -> None:
        self.store, self.clock = store, clock
        self.segmenter = OnlineSegmenter(config.segmentation, config.grid, store, observer)
        self.recogniser = SubmapRecogniser(config, store, clock)
        self.regions: dict[int, list[int]] = {}
        self._closures: dict[tuple[int, int], Closure] = {}
        self._grown = set[int]()
        self.breaks: dict[int, Bridge | None] = {}
        self._way_m = array("d", [0.0])  # driven up to each keyframe

    def add(self, scan: PosedScan) -> list[Region]:
        """Add a scan to the current submap; the regions that the robot has left with it."""
        keyframe = self.store.append(scan)
        if keyframe:
            step = self.store.pose(keyframe - 1).inverse() @ scan.map_from_base
            self._way_m.append(self._way_m[-1] + step.distance)
        with self.clock.stage("segmentation"):
            return self.segmenter.add(keyframe)

    def end_submap(self) -> list[Region]:
        """Close the current submap, where tracking was lost or the log has ended."""
        with self.clock.stage("segmentation"):
            return self.segmenter.flush()

    def break_off(self, bridge: tuple[float, float] | None) -> list[Region]:
        """Tracking was lost and starts afresh with the next keyframe: a new submap begins.

        `bridge` is how far odometry may be off meanwhile, metres and radians, if there was any.
        """
        self.breaks[len(self.store)] = None if bridge is None else Bridge(*bridge)
        return self.end_submap()

    def recognise(self, left: Iterable[Region]) -> None:
        """Is a submap that was left an existing one? If so, merge the two and close the loop."""
        for region in left:
            if region.continues is not None:
                self.regions[region.continues].extend(region.keyframes)
                self._grown.add(region.continues)
                continue
            self.regions[region.number] = list(region.keyframes)
            travelled_m = self._travelled_before(region.number)
            self._accept(self.recogniser.consider(region.number, region.keyframes, travelled_m))

    def recognise_leftovers(self) -> None:
        """Look for duplicates among the submaps until no more are found.

        Regions that the robot came straight back to have grown since they were compared.
        """
        grown, self._grown = sorted(self._grown), set()
        for number in grown:
            travelled_m = self._travelled_before(number)
            self.recogniser.grow(number, self.regions[number], travelled_m)
        for number in grown:
            self._accept(self.recogniser.again(number))
        merging = True
        while merging:
            found = self.recogniser.leftovers(self._neighbours())
            self._accept(found)
            merging = any(closure.merged for closure in found)

    def explored(self, trajectory: Trajectory) -> Explored:
        """What was found, as a value."""
        return Explored(
            trajectory=trajectory,
            regions={number: tuple(keyframes) for number, keyframes in self.regions.items()},
            closures=tuple(self._closures.values()),
            breaks=dict(self.breaks),
            features=self.recogniser.features,
        )

    def _accept(self, closures: Iterable[Closure]) -> None:
        """Remember what was considered; what was recognised becomes one submap.

        Of two regions what was found last is told.
        """
        for closure in closures:
            pair = min(closure.old, closure.new), max(closure.old, closure.new)
            self._closures.pop(pair, None)
            self._closures[pair] = closure
            if closure.merged:
                self.recogniser.closer.merge(closure.old, closure.new)

    def _travelled_before(self, region: int) -> float:
        """Metres driven before a region; infinite once tracking has been lost."""
        first = self.regions[region][0]
        if self.breaks and first >= min(self.breaks):
            return math.inf
        return self._way_m[first]

    def _neighbours(self) -> Neighbours:
        """Which submaps the robot drove between."""
        labels = online_labels(self.regions, self._closures.values(), len(self.store)).tolist()
        return neighbours(labels, pairwise(labels))


class SubmapRecogniser:
    """Section III-C for the regions of a keyframe store: each compared with all before it."""

    def __init__(self, config: Config, store: KeyframeStore, clock: Stopwatch) -> None:
        self.config, self.store, self.clock = config, store, clock
        self.features = KeyframeFeatures(store, config.recognition.feature_set)
        self.closer = LoopCloser(config.recognition, np.random.default_rng(config.seed))

    def consider(self, number: int, keyframes: Sequence[int], travelled_m: float) -> list[Closure]:
        """Use the learned classifiers to determine if a new submap is an existing one."""
        with self.clock.stage("recognition"):
            return self.closer.consider(self._view(number, keyframes, travelled_m))

    def grow(self, number: int, keyframes: Sequence[int], travelled_m: float) -> None:
        """A region has more keyframes than when it was considered."""
        with self.clock.stage("recognition"):
            self.closer.grow(self._view(number, keyframes, travelled_m))

    def again(self, number: int) -> list[Closure]:
        """A region that has grown compared once more."""
        with self.clock.stage("recognition"):
            return self.closer.consider_again(number)

    def leftovers(self, adjacency: Neighbours) -> list[Closure]:
        """Pairs of submaps that are duplicates by the topology."""
        with self.clock.stage("recognition"):
            return self.closer.consider_leftovers(adjacency)

    def _view(self, number: int, region: Sequence[int], travelled_m: float) -> Stay:
        """What recognition sees of a region: features, grid and track in the region's own frame."""
        keyframes = np.array(region)
        track = in_own_frame(self.store, region)
        with self.clock.stage("grids"):
            grid = integrate_keyframes(self.store, region, track, self.config.grid)
        seen = evenly(keyframes, SAMPLES_PER_SUBMAP)
        return Stay(
            number=number,
            features=self.features.of(seen.tolist()),
            packed=PackedGrid.of(grid.snapshot()),
            track=track,
            map_from_stay=self.store.pose(region[0]),
            travelled_m=travelled_m,
        )


def in_own_frame(store: KeyframeStore, keyframes: Sequence[int]) -> FloatArray:
    """Poses (n, 3) of some keyframes in the frame of the first of them, as registered."""
    poses = store.poses_of(keyframes)
    return compose(invert(poses[0]), poses)


def online_labels(regions: Regions, closures: Iterable[Closure], count: int) -> IntArray:
    """The submap (n,) of each of `count` keyframes, by the regions and their merges.

    A submap has the smallest number of its regions; -1 marks a keyframe in no region yet.
    """
    merges = [(closure.old, closure.new) for closure in closures if closure.merged]
    labels = np.full(count, -1, dtype=np.int64)
    for region, submap in submap_of_regions(regions, merges).items():
        labels[list(regions[region])] = submap
    return labels
