"""What Algorithm 1 knows while the robot drives: the regions it left, and which it came back to."""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from specmap_cli.core.arrays import evenly
from specmap_cli.core.geometry import FloatArray, compose, invert
from specmap_cli.core.process import give_memory_back
from specmap_cli.core.records import Closure, IntArray, PosedScan, Trajectory
from specmap_cli.grids.gridmap import PackedGrid
from specmap_cli.grids.keyframes import KeyframeStore, integrate_keyframes
from specmap_cli.layout.passes import PassesOnTheWay
from specmap_cli.layout.path_graph import Bridge
from specmap_cli.pipelines.map_in_making import Explored
from specmap_cli.pipelines.session import Session
from specmap_cli.recognition.closure.claims import SAMPLES_PER_SUBMAP
from specmap_cli.recognition.closure.loop_closer import LoopCloser, Stay
from specmap_cli.recognition.features.sets import KeyframeFeatures
from specmap_cli.segmentation.online import Observer, OnlineSegmenter, Region
from specmap_cli.topology.graph import submap_of_regions

Regions = Mapping[int, Sequence[int]]


class Exploration:
    """The state of Algorithm 1 between two scans: the regions that were left, each recognised."""

    def __init__(self, session: Session, observer: Observer | None = None) -> None:
        config, self.session = session.config, session
        self.segmenter = OnlineSegmenter(config.segmentation, config.grid, session.store, observer)
        self.closer = LoopCloser(config.recognition, np.random.default_rng(config.seed))
        self.features = KeyframeFeatures(session.store, config.recognition.feature_set)
        self.regions: dict[int, list[int]] = {}
        self._closures: dict[tuple[int, int], Closure] = {}
        self._grown = set[int]()
        self.breaks: dict[int, Bridge | None] = {}
        self._way_m = array("d", [0.0])  # driven up to each keyframe
        self.passes = PassesOnTheWay(session.store) if config.relaxation.enabled else None

    def add(self, scan: PosedScan) -> list[Region]:
        """Add a scan to the current submap; the regions that the robot has left with it."""
        store = self.session.store
        keyframe = store.append(scan)
        if keyframe:
            step = store.pose(keyframe - 1).inverse() @ scan.map_from_base
            self._way_m.append(self._way_m[-1] + step.distance)
        if self.passes is not None:  # in the time in which this process would wait for scans
            with self.session.clock.stage("layout"):
                self.passes.go_on(self.breaks)
        with self.session.clock.stage("segmentation"):
            return self.segmenter.add(keyframe)

    def end_submap(self) -> list[Region]:
        """Close the current submap, where tracking was lost or the log has ended."""
        with self.session.clock.stage("segmentation"):
            return self.segmenter.flush()

    def break_off(self, bridge: tuple[float, float] | None) -> list[Region]:
        """Tracking was lost and starts afresh with the next keyframe: a new submap begins.

        `bridge` are the standard deviations of odometry meanwhile, metres and radians, if any.
        """
        self.breaks[len(self.session.store)] = None if bridge is None else Bridge(*bridge)
        return self.end_submap()

    def recognise(self, left: Iterable[Region]) -> None:
        """Is a submap that was left an existing one? If so, merge the two and close the loop.

        "Use learned classifiers": each is compared with all before it (Section III-C).
        """
        for region in left:
            if region.continues is not None:
                self.regions[region.continues].extend(region.keyframes)
                self._grown.add(region.continues)
                continue
            self.regions[region.number] = list(region.keyframes)
            with self.session.clock.stage("recognition"):
                self._accept(self.closer.consider(self._stay(region.number)))
                give_memory_back()

    def recognise_again(self) -> None:
        """Regions that the robot came straight back to have grown since they were compared.

        They are compared once more, whole, at the end of the log.
        """
        grown, self._grown = sorted(self._grown), set()
        with self.session.clock.stage("recognition"):
            for number in grown:
                self.closer.grow(self._stay(number))
            for number in grown:
                self._accept(self.closer.consider_again(number))

    def explored(self, trajectory: Trajectory) -> Explored:
        """What was found, as a value."""
        return Explored(
            trajectory=trajectory,
            regions={number: tuple(keyframes) for number, keyframes in self.regions.items()},
            closures=tuple(self._closures.values()),
            breaks=dict(self.breaks),
            features=self.features,
            passes=self.passes,
        )

    def _accept(self, closures: Iterable[Closure]) -> None:
        """Remember what was considered, of each pair what came last; merge what was recognised."""
        for closure in closures:
            pair = min(closure.old, closure.new), max(closure.old, closure.new)
            self._closures.pop(pair, None)
            self._closures[pair] = closure
            if closure.merged:
                self.closer.merge(closure.old, closure.new)

    def _stay(self, number: int) -> Stay:
        """What recognition sees of a region: features, grid and track in the region's own frame."""
        store, region = self.session.store, self.regions[number]
        track = in_own_frame(store, region)
        with self.session.clock.stage("grids"):
            grid = integrate_keyframes(store, region, track, self.session.config.grid)
        lost = self.breaks and region[0] >= min(self.breaks)
        return Stay(
            number=number,
            features=self.features.of(evenly(np.array(region), SAMPLES_PER_SUBMAP).tolist()),
            packed=PackedGrid.of(grid.snapshot()),
            track=track,
            map_from_stay=store.pose(region[0]),
            travelled_m=math.inf if lost else self._way_m[region[0]],
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
